"""The search finds what is planted, and what it says is what a run says."""

from __future__ import annotations

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.execution.executors import open_executor
from afl_mujoco.scenario.laboratory import HARDWARE_RANGES
from afl_mujoco.scenario.sample_space import (
    SampleSpace,
    acting,
    sample_point,
    search_generator,
)
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.studies.cube_search import Budget, minimise
from afl_mujoco.studies.monte_carlo import worst_case
from afl_mujoco.studies.monte_carlo.campaign import Campaign, run_campaign
from afl_mujoco.studies.monte_carlo.trial import Settings, run_trials
from afl_mujoco.studies.monte_carlo.worst_case import (
    HARDEST,
    NEAREST,
    Found,
    distance_of,
    most_runs,
    search_worst,
    worst_scenario,
)
from tests.sample_spaces import near_laboratory

pytestmark = pytest.mark.slow

LQR = afl.CONTROLLERS["lqr"]
SHORT = near_laboratory(duration=2.0, last_change=1.0)
BUDGET = Budget(generations=4, population=8)


def campaign(space: SampleSpace = SHORT, samples: int = 20) -> Campaign:
    with open_executor(1) as executor:
        return run_campaign(
            [LQR], space, samples=samples, seed=1, settings=Settings("Euler"), executor=executor
        )


@pytest.fixture(scope="module")
def twenty() -> Campaign:
    found = campaign()
    assert found.failures("lqr")
    return found


def search(found: Campaign, workers: int = 1, progress=lambda runs: None):
    with open_executor(workers) as executor:
        return search_worst(LQR, found, budget=BUDGET, executor=executor, progress=progress)


def test_it_finds_a_failure_region_planted_in_a_corner_of_thirty_dimensions() -> None:
    planted = np.tile([0.9, 0.1], 15)

    def cost(points):
        return [float(np.linalg.norm(point - planted)) for point in points]

    middle = np.full(30, 0.5)
    budget = Budget(generations=60, population=16)
    best, tried = minimise(cost, middle, 0.3, search_generator(1), budget)
    assert cost([best])[0] < 0.2 * cost([middle])[0]
    assert tried == budget.points == 961
    again, _ = minimise(cost, middle, 0.3, search_generator(1), budget)
    assert best.tobytes() == again.tobytes()
    other, _ = minimise(cost, middle, 0.3, search_generator(2), budget)
    assert best.tobytes() != other.tobytes()


def test_it_stays_in_the_cube_and_leaves_numpys_global_numbers_alone(capfd) -> None:
    seen = []

    def cost(points):
        seen.extend(points)
        return [-float(np.sum(point)) for point in points]

    before = np.random.get_state()[1].tobytes()  # noqa: NPY002
    best, _ = minimise(cost, np.full(5, 0.9), 0.3, search_generator(0), Budget(generations=40))
    assert np.random.get_state()[1].tobytes() == before  # noqa: NPY002
    assert (np.min(seen) >= 0.0) and (np.max(seen) <= 1.0)
    assert best.min() > 0.99
    assert capfd.readouterr() == ("", "")


def test_a_start_that_nothing_beats_is_the_answer() -> None:
    start = np.full(4, 0.5)
    best, _ = minimise(
        lambda points: [float(np.linalg.norm(p - start)) for p in points],
        start, 0.2, search_generator(0), Budget(generations=3),
    )  # fmt: skip
    assert best.tobytes() == start.tobytes()


def scenario_of(found: Found) -> Scenario:
    return worst_scenario(SHORT, found.point, found.noise, 1, found.question)


def test_what_it_finds_is_at_least_as_bad_and_as_near_as_the_samples(twenty: Campaign) -> None:
    hardest, nearest = search(twenty)
    assert (hardest.question, nearest.question) == (HARDEST, NEAREST)
    severities = [trial.severity(2.0) for trial in twenty.trials["lqr"]]
    assert hardest.trial.severity(2.0) > max(severities)
    failures = [distance_of(SHORT, sample_point(SHORT, i, 1)) for i in twenty.failures("lqr")]
    assert nearest.distance < min(failures)
    assert not nearest.trial.passed
    for found in (hardest, nearest):
        (alone,) = run_trials([scenario_of(found)], LQR, Settings("Euler"))
        assert repr(alone) == repr(found.trial)
        changes = np.array(list(found.changes.values()))
        assert (np.diff(np.abs(changes)) <= 0.0).all()
        used = list(acting(found.changes).values())
        assert np.linalg.norm(used) / np.sqrt(len(changes)) == pytest.approx(found.distance)
    assert scenario_of(hardest).name != scenario_of(nearest).name


def test_a_failure_that_only_the_search_found_is_what_the_nearest_is_looked_for_from() -> None:
    found = campaign(samples=10)
    assert not found.failures("lqr")
    hardest, nearest = search(found)
    assert not hardest.trial.passed
    assert not nearest.trial.passed
    assert nearest.distance <= hardest.distance


def test_what_changes_no_scenario_is_no_distance() -> None:
    home = SHORT.scenario_of(SHORT.reference, 0, 1)
    for axis, name in enumerate(SHORT.coordinates):
        point = SHORT.reference.copy()
        point[axis] += 0.3 if point[axis] < 0.5 else -0.3
        assert (distance_of(SHORT, point) > 0.0) == (SHORT.scenario_of(point, 0, 1) != home), name


def test_nearest_means_failures_by_distance_then_survivors_from_the_hardest(monkeypatch) -> None:
    silent = dict.fromkeys(("noise_z", "noise_phi", "noise_z_dot", "noise_phi_dot"), (0.0, 0.0))
    space = near_laboratory(
        duration=2.0, last_change=1.0, imperfections={**HARDWARE_RANGES, **silent}
    )
    found = campaign(space)
    points = [sample_point(space, i, 1) for i in range(20)]
    costs = []

    def ask(cost, start, *rest):
        costs.append(cost(points))
        return start, 1

    monkeypatch.setattr(worst_case, "minimise", ask)
    search(found)
    trials = found.trials["lqr"]
    fallen = sorted(found.failures("lqr"), key=lambda i: distance_of(space, points[i]))
    upright = [i for i in range(20) if trials[i].passed]
    upright.sort(key=lambda i: trials[i].severity(2.0), reverse=True)
    assert fallen and upright
    assert np.argsort(costs[1]).tolist() == fallen + upright


def test_two_processes_give_the_same_bits(twenty: Campaign) -> None:
    one, two = (search(twenty, workers) for workers in (1, 2))
    assert repr(one) == repr(two)
    assert [scenario_of(found) for found in one] == [scenario_of(found) for found in two]


def test_progress_ends_at_the_runs_that_it_took(twenty: Campaign) -> None:
    reported: list[int] = []
    found = search(twenty, progress=reported.append)
    assert reported == sorted(reported)
    assert reported[-1] == sum(one.runs for one in found) <= most_runs(BUDGET)


def test_there_is_no_nearest_failure_where_nothing_fails() -> None:
    gentle = near_laboratory(
        phi=(-0.1, 0.1), cart_mass=(0.9, 1.1), half_length=(0.45, 0.55),
        duration=2.0, last_change=1.0,
    )  # fmt: skip
    (hardest,) = search(campaign(gentle, 4))
    assert hardest.question == HARDEST
    assert hardest.trial.passed


def test_a_controller_that_survives_nothing_needs_no_search(twenty: Campaign) -> None:
    lost = Campaign(
        space=SHORT,
        seed=1,
        settings=twenty.settings,
        trials={"lqr": [t for t in twenty.trials["lqr"] if not t.passed]},
    )
    assert search(lost) == []


@pytest.mark.parametrize("changes", [{"generations": 0}, {"population": 3}], ids=str)
def test_a_budget_of_nothing_is_refused(changes) -> None:
    with pytest.raises(InvalidValueError, match=r"must be at least \d, got \d$"):
        Budget(**changes)


@pytest.mark.parametrize("seed", range(6))
def test_one_number_alone_can_be_searched(seed: int) -> None:
    """CMA-ES of the library needs two."""
    best, tried = minimise(
        lambda points: [float(point[0]) for point in points],
        np.array([0.8]), 0.3, search_generator(seed), Budget(generations=20),
    )  # fmt: skip
    assert best.shape == (1,)
    assert best[0] < 0.01 and tried > 20
