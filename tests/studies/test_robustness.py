"""Sweeps, samples, searches and maps of starts against single runs."""

from dataclasses import replace

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.control.catalogue import as_controller
from afl_mujoco.pool import open_executor
from afl_mujoco.scenario import sample_space
from afl_mujoco.scenario.catalogue import LABORATORY
from afl_mujoco.scenario.imperfections import IDEAL
from afl_mujoco.scenario.sample_space import SampleSpace, draws_of, sample_point, sample_scenario
from afl_mujoco.scenario.time_steps import DEFAULT, Deployed
from afl_mujoco.studies.shared import robustness
from afl_mujoco.studies.shared.run import Run, run_all
from afl_mujoco.studies.shared.search import Budget, minimise

LQR, ADAPTIVE = afl.CONTROLLERS["lqr"], afl.CONTROLLERS["adaptive"]
LEANING = afl.Scenario(name="leaning", duration=2.0, initial_state=(0.0, 0.2, 0.0, 0.0))
VARIED = {"phi": (-1.3, 1.3), "delay": (0.0, 0.2)}
SPACE = SampleSpace(replace(LEANING, ranges=VARIED))
SAMPLES = 16
SMALL = Budget(generations=3, population=6)
TIMELESS = replace(LABORATORY.imperfections, control_period=None)
SHORT = SampleSpace(replace(LABORATORY, duration=2.0, imperfections=TIMELESS))
EULER = Deployed("Euler")


def drawn(count=SAMPLES, space=SPACE, deployed=DEFAULT, workers=1, controllers=(LQR,), seed=1):
    return robustness.sample(controllers, space, count, seed, deployed, workers=workers)


@pytest.fixture(scope="module")
def runs() -> list[Run]:
    return drawn()["lqr"]


def searched(runs, space=SPACE, budget=SMALL, deployed=DEFAULT, workers=1, **how):
    with open_executor(workers) as executor:
        return robustness.search_worst(LQR, space, runs, 1, budget, deployed, executor, **how)


ARM = afl.Plant(
    name="arm", coordinates=("turn", "reach"), inputs=("torque", "thrust"),
    model="""<mujoco><worldbody><body><joint name="turn" axis="0 1 0"/><geom size=".1"/>
      <body pos="0 0 .3"><joint name="reach" type="slide"/><geom size=".1" contype="0"/></body>
      </body></worldbody><actuator><motor name="torque" joint="turn"/>
      <motor name="thrust" joint="reach"/></actuator></mujoco>""",
)  # fmt: skip


@pytest.mark.parametrize(("name", "own", "level", "acting", "reference"), [
    ("delay", {"torque": 0.003, "thrust": 0.0065}, 0.005, [0.005, 0.0065], 0.0065),
    ("lag", 0.003, 0.05, [0.05, 0.05], 0.003),
    ("input_limit", {"torque": 25.0}, 10.0, [10.0, 10.0], 25.0),
    ("input_limit", {"torque": 25.0, "thrust": 12.0}, 15.0, [15.0, 12.0], 25.0),
])  # fmt: skip
def test_a_level_is_of_every_input_and_the_reference_no_milder_than_the_file(
    name, own, level, acting, reference
) -> None:
    """Also of an input that the file leaves ideal; limits in N and N m have no one number."""
    scenario = afl.Scenario(name="s", plant=ARM, imperfections=afl.Imperfections(**{name: own}))
    one = robustness.find_imperfection(name, ARM)
    there = robustness.on_hardware(scenario, robustness.hardware_at(one, level, ARM))
    assert [there.imperfections.of_input(name, x) for x in ARM.inputs] == acting
    assert robustness.referred(one, (scenario,)).reference == reference


@pytest.mark.parametrize("name", ["delay", "end_stops.z"])
def test_a_threshold_is_where_single_runs_begin_to_fail(name: str) -> None:
    settings = robustness.Settings(seeds=1, scan=5, tolerance=0.1)
    found = robustness.sweep(robustness.SweepUnit(name, LQR, (LEANING,), settings)).survives
    for level, survives in ((found.holds_at, True), (found.fails_at, False)):
        there = replace(LEANING, imperfections=IDEAL.changed({name: level}))
        alone = afl.simulate_mujoco(there, LQR)
        reached = name == "end_stops.z" and np.abs(alone.state[:, 0]).max() >= level
        assert (alone.outcome.kind == "completed" and not reached) == survives


def test_samples_are_single_runs_and_depend_on_neither_number_nor_company(runs) -> None:
    for index, run in enumerate(runs):
        alone = afl.simulate_mujoco(sample_scenario(SPACE, index, 1), LQR)
        assert (alone.outcome.kind, alone.outcome.time) == (run.outcome, run.time)
        assert run.metrics["peak_phi"] == np.abs(alone.state[:, 1]).max()
        assert bool(run.failure) == (alone.outcome.kind != "completed") and run.draw == index
    assert 0 < sum(bool(run.failure) for run in runs) < SAMPLES
    assert drawn(5, controllers=(ADAPTIVE, LQR))["lqr"] == runs[:5]
    assert drawn(5, seed=2)["lqr"] != runs[:5]


def test_a_search_finds_worse_than_the_samples_and_nearer(runs) -> None:
    reported: list[int] = []
    hardest, nearest = searched(runs, progress=reported.append)
    assert (hardest.question, nearest.question) == (robustness.HARDEST, robustness.NEAREST)
    assert hardest.run[0].severity(SPACE.scenario) >= max(r.severity(SPACE.scenario) for r in runs)
    fell = [sample_point(SPACE, r.draw, 1) for r in runs if r.failure]
    failures = [robustness.distance_of(SPACE, point) for point in fell]
    assert nearest.distance <= min(failures) and nearest.run[0].failure
    assert reported[-1] == hardest.tried + nearest.tried <= 2 * SMALL.points
    for found in (hardest, nearest):
        (alone,) = run_all(LQR, [robustness.worst_scenario(SPACE, found, 1)])
        assert replace(alone, scenario="", draw=0) == replace(found.run[0], scenario="", draw=0)
        changes = np.abs(list(robustness.changes_of(SPACE, found.point).values()))
        assert (np.diff(changes) <= 0.0).all()
        assert np.linalg.norm(changes) / np.sqrt(SPACE.dimension) == pytest.approx(found.distance)


def test_the_nearest_failure_is_searched_from_the_nearest_known(runs, monkeypatch):
    monkeypatch.setattr(robustness, "minimise", lambda cost, start, *rest: (start, 1))
    points = {run.draw: sample_point(SPACE, run.draw, 1) for run in runs if run.failure}
    distances = {i: robustness.distance_of(SPACE, point) for i, point in points.items()}
    best = min(distances, key=lambda i: distances[i])
    assert best != min(distances), "the first failure must not be the nearest one too"
    _, nearest = searched(runs)
    assert (nearest.run[0].draw, nearest.distance) == (best, distances[best])
    home = SHORT.scenario_of(SHORT.reference, 0, 1)
    for axis, name in enumerate(SHORT.coordinates):
        point = SHORT.reference.copy()
        point[axis] += 0.3 if point[axis] < 0.5 else -0.3
        same = SHORT.scenario_of(point, 0, 1) == home
        assert same == (robustness.distance_of(SHORT, point) == 0.0), name


@pytest.mark.slow
def test_on_random_hardware_two_processes_give_the_same_bits() -> None:
    found = drawn(10, SHORT, EULER)["lqr"]
    assert not any(run.failure for run in found)  # a failure that only the search finds
    budget = Budget(generations=4, population=8)
    one, two = (searched(found, SHORT, budget, EULER, workers) for workers in (1, 2))
    assert one == two
    hardest, nearest = one
    assert hardest.run[0].failure and nearest.run[0].failure
    assert nearest.distance <= hardest.distance


def test_a_search_finds_a_corner_of_thirty_dimensions_and_stays_in_the_cube(capfd) -> None:
    planted = np.tile([0.9, 0.1], 15)

    def cost(points):
        return [float(np.linalg.norm(point - planted)) for point in points]

    middle, budget = np.full(30, 0.5), Budget(generations=60, population=16)
    best, tried = minimise(cost, middle, 0.3, sample_space.search_generator(1), budget)
    assert cost([best])[0] < 0.2 * cost([middle])[0] and tried == budget.points == 961
    few = Budget(generations=3, population=6)
    seeded = (sample_space.search_generator(seed) for seed in (1, 1, 2))
    one, same, other = (minimise(cost, middle, 0.3, rng, few)[0] for rng in seeded)
    assert one.tobytes() == same.tobytes() != other.tobytes()
    seen = []

    def cost(points):
        seen.extend(points)
        return [-float(np.sum(point)) for point in points]

    before = np.random.get_state()[1].tobytes()  # noqa: NPY002
    rng, budget = sample_space.search_generator(0), Budget(generations=40)
    best, _ = minimise(cost, np.full(5, 0.9), 0.3, rng, budget)
    assert np.random.get_state()[1].tobytes() == before  # noqa: NPY002
    assert (np.min(seen) >= 0.0) and (np.max(seen) <= 1.0)
    assert best.min() > 0.99 and capfd.readouterr() == ("", "")


def test_a_seed_is_the_draw_that_compare_has_where_only_encoders_act() -> None:
    rough = afl.Imperfections(differentiated=True, encoder_step={"phi": 0.01, "z": 0.005})
    start = (0.0, 0.1, 0.0, 0.0)
    own = afl.Scenario(name="s", imperfections=rough, initial_state=start, duration=0.5)
    unit = robustness.SweepUnit("", afl.CONTROLLERS["lqr"], [own], robustness.Settings(seeds=3))
    bare = [run.metrics["peak_phi"] for run in robustness.run_on(unit, {})]
    expected = [afl.simulate_mujoco(x, "lqr").metrics["peak_phi"] for x in draws_of(own, 3)]
    assert bare == expected and len(set(bare)) == 3


NOISY = replace(LEANING, duration=0.5, imperfections=afl.Imperfections(noise={"phi": 1e-4}))
FEW, AXES = robustness.Settings(scan=2, tolerance=1.0), (np.array([0.1]), np.array([0.0, 0.1]))


@pytest.mark.parametrize("study", [
    lambda own: afl.compare(NOISY, own, draws=2), lambda own: drawn(2, controllers=(own,)),
    lambda own: robustness.sweep(robustness.SweepUnit("delay", own, (LEANING,), FEW)),
    lambda own: robustness.map_starts((own,), LEANING, ("phi", "z"), AXES, DEFAULT),
], ids=["compare", "sample", "sweep", "map_starts"])  # fmt: skip
def test_a_controller_that_keeps_something_from_run_to_run_is_refused(study) -> None:
    calls: list[float] = []

    def counts(t, x, belief):
        calls.append(t)
        return 20.0 * x[1] + 3.0 * x[3] + 1e-9 * len(calls)

    study(as_controller(lambda t, x, belief: 20.0 * x[1] + 3.0 * x[3]))
    with pytest.raises(afl.AflMujocoError, match="'counts' must make the same run each time"):
        study(as_controller(counts))
