"""The maps of attraction against the readable simulators, one run of 20 s at a time."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

import afl_mujoco as afl
from afl_mujoco.control.compiled_controller import compiled_force
from afl_mujoco.errors import InvalidValueError, UnknownNameError
from afl_mujoco.execution.threads import PART, share
from afl_mujoco.scenario.parameters import NOMINAL, PlantRange
from afl_mujoco.simulation.attraction.grid import (
    FALLEN,
    LENGTHS,
    MASSES,
    PLANTS,
    SETTLED,
    UNDECIDED,
    AttractionMap,
    Grid,
    Settling,
    axis,
    plant_grid,
    state_grid,
)
from afl_mujoco.simulation.attraction.mujoco_map import TIMESTEP, map_in_mujoco
from afl_mujoco.simulation.attraction.ode_map import MAX_STEP, map_by_ode

SETTLING = Settling()
FOUND = ("outcome", "time", "peak_z", "peak_force")
MAPS = {"equations": map_by_ode, "MuJoCo": map_in_mujoco}


def states(count: int, *, plant: tuple[float, float] = (1.0, 0.5)) -> Grid:
    """The default map over states, coarser."""
    angles, rates = axis("angle", -1.55, 1.55, count), axis("rate", -10.0, 10.0, count)
    return state_grid(angles, rates, cart_mass=plant[0], half_length=plant[1])


def plants(count: int) -> Grid:
    """The default map over plants, coarser."""
    return plant_grid(axis("mass", *MASSES, count), axis("length", *LENGTHS, count))


def scenario_of(grid: Grid, k: int) -> afl.Scenario:
    """Grid point k as a scenario."""
    mass, length = grid.plants[k].tolist()
    return afl.Scenario(
        name="point",
        cart_mass=afl.constant(mass),
        half_length=afl.constant(length),
        pole_mass=grid.pole_mass,
        gravity=grid.gravity,
        initial_state=tuple(grid.starts[k].tolist()),
        duration=SETTLING.horizon,
    )


def settled_at(
    time: NDArray[np.float64], state: NDArray[np.float64], bands: Sequence[float] = SETTLING.bands
) -> float:
    """When a sampled run has been within the bands for the whole dwell [s], or never."""
    inside = (np.abs(state) <= bands).all(axis=1)
    entered = math.inf
    for t, within in zip(time.tolist(), inside.tolist(), strict=True):
        if not within:
            entered = math.inf
        elif entered == math.inf:
            entered = t
        if t - entered >= SETTLING.dwell - 1e-9:
            return t
    return math.inf


def some_of(grid: Grid, found: AttractionMap, seed: int) -> list[int]:
    """Five grid points that settled, three that fell, two undecided: as far as there are.

    An undecided pole of the map over states stays so near the horizontal, where the controller is
    stiff, that the reference integrator takes a minute for it.
    """
    rng, chosen = np.random.default_rng(seed), []
    undecided = 2 if grid.plane == PLANTS else 0
    for outcome, count in ((SETTLED, 5), (FALLEN, 3), (UNDECIDED, undecided)):
        there = np.flatnonzero(found.outcome.ravel() == outcome)
        chosen += rng.permutation(there)[:count].tolist()
    return chosen


HEAVY = dataclasses.replace(states(15, plant=(8.0, 1.5)), pole_mass=0.3, gravity=3.7)

CASES = [
    pytest.param("lqr", HEAVY, id="lqr-heavy"),
    pytest.param("fixed", states(15), id="fixed-states"),
    pytest.param("lqr", states(15, plant=(0.3, 0.2)), id="lqr-states"),
    pytest.param("partial-linearization", states(15), id="partial-states"),
    pytest.param("adaptive", plants(15), id="adaptive-plants"),
    pytest.param("adaptive-nominal", plants(15), id="nominal-plants"),
]


@pytest.mark.parametrize(("name", "grid"), CASES)
def test_the_map_by_the_equations_is_that_of_the_reference_integrator(name, grid) -> None:
    controller = afl.CONTROLLERS[name]
    found = map_by_ode(grid, controller)
    for k in some_of(grid, found, seed=1):
        outcome, time, peak_z, peak_force = (getattr(found, key).ravel()[k] for key in FOUND)
        run = afl.simulate_ode(scenario_of(grid, k), controller)
        reference = settled_at(run.time, run.state)
        if outcome == SETTLED:
            assert run.outcome.kind == "completed"
            assert (np.abs(run.state[-1]) <= SETTLING.bands).all()  # it stayed to the horizon
            assert abs(time - reference) <= 2.0 * MAX_STEP  # enters, leaves between two steps
            until = run.time <= time
            assert peak_z == pytest.approx(np.abs(run.state[until, 0]).max(), rel=2e-3)
            assert peak_force == pytest.approx(np.abs(run.force[until]).max(), rel=2e-2)
        elif outcome == FALLEN:
            assert run.outcome.kind == "fell"
            assert reference == math.inf
            assert time == pytest.approx(run.outcome.time, abs=1e-4)
        else:
            assert run.outcome.kind == "completed"
            assert (time, reference) == (SETTLING.horizon, math.inf)


@pytest.mark.parametrize(("name", "grid"), CASES)
def test_the_map_in_mujoco_has_the_bits_of_the_sampled_run(name, grid) -> None:
    controller = afl.CONTROLLERS[name]
    chosen = some_of(grid, map_by_ode(grid, controller), seed=2)
    few = dataclasses.replace(
        grid,
        columns=np.arange(len(chosen), dtype=float),
        rows=np.zeros(1),
        starts=grid.starts[chosen],
        plants=grid.plants[chosen],
    )
    found = map_in_mujoco(few, controller)
    for k in range(len(chosen)):
        run = afl.simulate_mujoco(scenario_of(few, k), controller, "sampled", timestep=TIMESTEP)
        end = min(settled_at(run.time, run.state), run.outcome.time)
        fell = run.outcome.kind != "completed"
        settled = end < run.outcome.time
        outcome = SETTLED if settled else FALLEN if fell else UNDECIDED
        last = np.flatnonzero(run.time <= end)[-1]
        expected = (
            outcome,
            last * TIMESTEP,
            np.abs(run.state[: last + 1, 0]).max(),
            np.abs(run.force[:last]).max(),
        )
        assert tuple(getattr(found, key)[0, k] for key in FOUND) == expected
        if settled:  # it stayed to the horizon
            assert not fell
            assert (np.abs(run.state[-1]) <= SETTLING.bands).all()


@pytest.mark.parametrize("narrow", range(4))
@pytest.mark.parametrize("side", MAPS)
def test_each_of_the_four_bands_must_be_kept(side: str, narrow: int) -> None:
    bands = tuple(1e-3 if i == narrow else 1e3 for i in range(4))
    grid, controller = state_grid([0.3], [0.0]), afl.CONTROLLERS["lqr"]
    found = MAPS[side](grid, controller, settling=dataclasses.replace(SETTLING, bands=bands))
    run = afl.simulate_ode(scenario_of(grid, 0), controller)
    expected = settled_at(run.time, run.state, bands)
    assert SETTLING.dwell + 0.1 < expected < SETTLING.horizon
    assert found.time[0, 0] == pytest.approx(expected, abs=0.05)  # the control is held in MuJoCo


def same(a: AttractionMap, b: AttractionMap) -> None:
    """Check that two maps are equal bit for bit."""
    for key in FOUND:
        np.testing.assert_array_equal(getattr(a, key), getattr(b, key))


@pytest.mark.parametrize("name", ["adaptive", "lqr"])
@pytest.mark.parametrize("side", MAPS)
def test_a_mirrored_start_ends_as_the_mirror_image_bit_for_bit(side: str, name: str) -> None:
    grid = states(7 if side == "MuJoCo" else 31)
    np.testing.assert_array_equal(grid.starts, -grid.starts[::-1])
    found = MAPS[side](grid, afl.CONTROLLERS[name])
    mirrored = {key: getattr(found, key)[::-1, ::-1] for key in FOUND}
    same(found, dataclasses.replace(found, **mirrored))


@pytest.mark.parametrize("side", MAPS)
def test_two_threads_give_the_same_bits_and_every_grid_point_is_counted(side: str) -> None:
    grid, done = states(7), []
    assert len(grid.starts) % PART != 0
    one, two = (
        MAPS[side](grid, afl.CONTROLLERS["lqr"], threads=n, progress=done.append) for n in (1, 2)
    )
    same(one, two)
    assert sum(done) == 2 * len(grid.starts)


@pytest.mark.parametrize("side", MAPS)
def test_to_end_early_changes_no_outcome(side: str) -> None:
    grid, controller = states(7 if side == "MuJoCo" else 31), afl.CONTROLLERS["adaptive"]
    early = MAPS[side](grid, controller, threads=2)
    whole = MAPS[side](grid, controller, settling=Settling(dwell=SETTLING.horizon), threads=2)
    fell = whole.outcome == FALLEN
    assert 0 < fell.sum() < fell.size / 2
    np.testing.assert_array_equal(early.outcome == FALLEN, fell)
    np.testing.assert_array_equal(early.time[fell], whole.time[fell])
    assert (whole.time[~fell] == SETTLING.horizon).all()
    settled = early.outcome == SETTLED
    assert early.time[settled].mean() < 0.6 * SETTLING.horizon
    # and nothing happens after it: no peak beyond the band
    np.testing.assert_array_equal(
        np.maximum(early.peak_z, SETTLING.bands[0])[settled],
        np.maximum(whole.peak_z, SETTLING.bands[0])[settled],
    )
    np.testing.assert_array_equal(early.peak_force[settled], whole.peak_force[settled])


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [n for n, c in afl.CONTROLLERS.items() if not (c.stateful or c.interpreted)]
)
def test_from_every_corner_of_the_bands_every_controller_converges_on_every_plant(
    name: str,
) -> None:
    signs = [s for s in itertools.product((1.0, -1.0), repeat=4) if s[0] > 0.0]  # the rest mirror
    for corner in signs:
        start = tuple(s * band for s, band in zip(corner, SETTLING.bands, strict=True))
        masses, lengths = axis("mass", *MASSES, 5), axis("length", *LENGTHS, 5)
        grid = plant_grid(masses, lengths, start=start)
        tight = Settling(bands=tuple(0.05 * band for band in SETTLING.bands), horizon=40.0)
        found = map_by_ode(grid, afl.CONTROLLERS[name], settling=tight)
        assert (found.outcome == SETTLED).all()


@pytest.mark.parametrize("name", ["adaptive", "lqr"])
def test_a_thousandth_of_the_tolerance_changes_no_outcome(name: str) -> None:
    found, finer = (
        map_by_ode(states(31), afl.CONTROLLERS[name], tolerance=t, threads=2) for t in (1e-7, 1e-10)
    )
    np.testing.assert_array_equal(found.outcome, finer.outcome)
    settled = found.outcome == SETTLED
    assert np.abs(found.time - finer.time)[settled].max() <= 2.0 * MAX_STEP


def test_a_force_of_the_wrong_sign_lets_every_pole_fall() -> None:
    grid = states(9, plant=(1.0, 0.5))
    controller = afl.CONTROLLERS["lqr"]
    plants = PlantRange.of(NOMINAL)
    gains = afl.GainGrid.constant(-controller.gains.over(plants).gains(1.0, 0.5))
    wrong = afl.StateFeedback(name="wrong", kind=controller.kind, gains=gains)
    start = (0.0, 0.1, 0.0, 0.0)
    force = [
        compiled_force(*x.compiled_for(plants), *start, (1.0, 0.05, 0.5, 9.81))
        for x in (controller, wrong)
    ]
    assert force[0] == pytest.approx(-force[1])
    for simulate in MAPS.values():
        outcome = simulate(grid, wrong).outcome
        assert outcome[4, 4] == SETTLED  # that which is at rest upright
        assert (np.delete(outcome.ravel(), 40) == FALLEN).all()


def test_a_start_beyond_the_fall_has_fallen_at_once() -> None:
    grid = state_grid([-1.57, 1.6], [0.0])
    for simulate in MAPS.values():
        found = simulate(grid, afl.CONTROLLERS["fixed"])
        assert found.outcome.tolist() == [[FALLEN, FALLEN]]
        assert found.time.tolist() == [[0.0, 0.0]]


def test_the_hold_makes_the_smallest_plant_fall_that_is_assumed_nominal() -> None:
    grid, controller = plant_grid([0.1], [0.05]), afl.CONTROLLERS["adaptive-nominal"]
    assert map_by_ode(grid, controller).outcome[0, 0] == SETTLED
    found = map_in_mujoco(grid, controller)
    assert found.outcome[0, 0] != SETTLED
    held = afl.simulate_ode_held(scenario_of(grid, 0), controller, timestep=TIMESTEP)
    assert settled_at(held.time, held.state) == math.inf
    finer = map_in_mujoco(grid, controller, timestep=5e-4)
    assert finer.outcome[0, 0] == SETTLED


def test_what_a_task_raises_ends_the_others_and_is_raised() -> None:
    marched = []

    def simulate(part: slice) -> None:
        marched.append(part)
        if part.start == 0:
            raise InvalidValueError("cell", "must not fail")

    with pytest.raises(InvalidValueError, match=r"^cell must not fail"):
        share(100 * PART, [simulate], lambda points: None)
    assert len(marched) < 100


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: axis("masses", 1.0, 1.0, 3), "masses must exceed its low end 1, got 1"),
        (lambda: axis("masses", 1.0, 2.0, 1), "grid must be at least 2, got 1"),
        (lambda: axis("masses", 1.0, math.inf, 3), "masses must be finite, got inf"),
        (lambda: plant_grid([0.0, 1.0], [1.0]), "cart_mass must be positive, got 0"),
        (lambda: plant_grid([1.0], [[1.0]]), r"half_length must be a row of finite numbers"),
        (
            lambda: state_grid([0.1], [0.0], half_length=-1.0),
            "half_length must be positive, got -1",
        ),
        (lambda: Settling(dwell=30.0), "dwell must be within 20 s, got 30"),
        (lambda: Settling(bands=(0.1, 0.1, 0.0, 0.1)), "bands must be positive, got 0"),
        (lambda: map_by_ode(states(2), afl.CONTROLLERS["lqr"], threads=0), "threads must be at "),
        (lambda: map_in_mujoco(states(2), afl.CONTROLLERS["lqr"], threads=0), "threads must be"),
        (lambda: map_by_ode(states(2), afl.CONTROLLERS["lqr"], tolerance=1.0), "tolerance must"),
        (
            lambda: map_in_mujoco(states(2), afl.CONTROLLERS["lqr"], timestep=0.03),
            "timestep 0.03 s must divide",
        ),
        (
            lambda: map_in_mujoco(states(2), afl.CONTROLLERS["lqr"], integrator="RK5"),
            "integrator must be one of RK4",
        ),
    ],
)
def test_a_setting_that_breaks_its_rule_is_named_in_one_line(call, message: str) -> None:
    with pytest.raises((InvalidValueError, UnknownNameError), match=f"^{message}") as caught:
        call()
    assert "\n" not in str(caught.value)


def test_a_dwell_of_one_step_ends_a_run_after_it() -> None:
    settling = Settling(dwell=2e-3)
    found = MAPS["MuJoCo"](states(3), afl.CONTROLLERS["lqr"], settling=settling)
    assert found.outcome[1, 1] == SETTLED
    assert found.time[1, 1] == 2e-3
