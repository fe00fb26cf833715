"""The curves for figures: what is selected of a run, and that files give it back."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.simulation.trajectory import Trajectory
from afl_mujoco.studies.arrays import packed, unpacked
from afl_mujoco.studies.cases import REPORTED, Settings, closed_loop_runs
from afl_mujoco.studies.verification.checks.error_budget import SOURCES, budget_curves, error_budget
from afl_mujoco.studies.verification.curves import Curves, select_curves

SHORT = dataclasses.replace(
    afl.SCENARIOS["step-trapezoid"],
    name="short",
    duration=1.2,
    cart_mass=afl.staircase((0.6,), (0.5, 1.0)),
    disturbances=(afl.ForcePulse(force=-10.0, start=0.8, duration=0.1),),
)
ADAPTIVE = afl.CONTROLLERS["adaptive"]
ENERGY = {name: np.linspace(0.0, 1.0, 3) for name in ("time", "gained", "residual")}
H = 1e-3


@pytest.fixture(scope="module")
def runs() -> dict[str, Trajectory]:
    return closed_loop_runs(SHORT, ADAPTIVE, Settings())


@pytest.fixture(scope="module")
def parts(runs: dict[str, Trajectory]) -> dict[str, np.ndarray]:
    return budget_curves(SHORT, ADAPTIVE, runs)


def selected(runs: dict[str, Trajectory], parts: dict[str, np.ndarray]) -> Curves:
    reported = {name: runs[name] for name in REPORTED}
    return select_curves(SHORT, ADAPTIVE, reported, timestep=H, parts=parts, energy=ENERGY)


@pytest.fixture(scope="module")
def curves(runs: dict[str, Trajectory], parts: dict[str, np.ndarray]) -> Curves:
    return selected(runs, parts)


def test_the_drawn_maximum_of_every_difference_and_part_is_the_reported_one(
    curves: Curves, runs: dict[str, Trajectory], parts: dict[str, np.ndarray]
) -> None:
    ode = runs["ode"]
    for name in REPORTED[1:]:
        drawn = np.abs(curves.states[name] - curves.states["ode"]).max(axis=0)
        on_grid = np.searchsorted(runs[name].time, ode.time - 1e-9)
        reported = np.abs(runs[name].state[on_grid] - ode.state).max(axis=0)
        np.testing.assert_array_equal(drawn, reported)
    budget = error_budget(SHORT, ADAPTIVE, runs["mujoco sampled"].time, parts)
    for name in ("total", *SOURCES, "residual"):
        assert curves.parts[name].max() == getattr(budget, name)


def test_a_peak_between_the_regular_instants_is_kept(
    runs: dict[str, Trajectory], parts: dict[str, np.ndarray]
) -> None:
    state = runs["mujoco exact"].state.copy()
    state[507, 2] += 1.0  # 20 ms apart there, from 500 ms on
    peaked = dataclasses.replace(runs["mujoco exact"], state=state)
    curves = selected({**runs, "mujoco exact": peaked}, parts)
    difference = np.abs(curves.states["mujoco exact"] - curves.states["ode"])
    assert difference.max() == pytest.approx(1.0, abs=1e-6)
    assert 0.507 in curves.time.round(9)


def test_every_instant_is_kept_after_the_start_and_each_breakpoint_and_few_elsewhere(
    curves: Curves,
) -> None:
    kept = set(np.round(curves.time / H).astype(int).tolist())
    for start in (0, 600, 800, 900):
        assert set(range(start, start + 101)) <= kept
    assert {599, 799, 899, 1200} <= kept  # a jump is drawn as a jump; the end
    assert len(kept & set(range(102, 598))) < 50
    assert curves.time[-1] == pytest.approx(1.2)


def test_inputs_are_those_of_the_scenario_after_a_jump(curves: Curves) -> None:
    at = np.searchsorted(curves.time, 0.6 - 1e-9)
    assert curves.cart_mass[at - 1 : at + 1].tolist() == [0.5, 1.0]
    at = np.searchsorted(curves.time, 0.8 - 1e-9)
    assert curves.push[at - 1 : at + 1].tolist() == [0.0, -10.0]
    np.testing.assert_array_equal(curves.half_length, SHORT.half_length(curves.time))


def test_a_run_that_fell_has_the_instants_that_it_reached(runs: dict[str, Trajectory]) -> None:
    whole = runs["mujoco continuous"]
    cut = {name: getattr(whole, name)[:552] for name in ("time", "state", "force", "command")}
    cut |= {name: getattr(whole, name)[:552] for name in ("cart_mass", "half_length")}
    fallen = dataclasses.replace(whole, **cut, outcome=afl.Outcome("fell", 0.551))
    curves = selected({**runs, "mujoco continuous": fallen}, {})
    reached = len(curves.states["mujoco continuous"])
    assert curves.time[reached - 1] == pytest.approx(0.551)
    assert len(curves.forces["mujoco continuous"]) == reached < len(curves.time)
    assert len(curves.states["ode"]) == len(curves.time)
    assert dict(curves.parts) == {}


def test_files_give_back_every_number(curves: Curves) -> None:
    data, arrays = packed(curves)
    assert {"time", "states/mujoco exact", "energy/residual"} <= set(arrays)
    assert unpacked(Curves, json.loads(json.dumps(data)), arrays) == curves


def test_curves_differ_if_one_number_does(curves: Curves) -> None:
    states = {name: array.copy() for name, array in curves.states.items()}
    states["mujoco exact"][7, 1] = np.nextafter(states["mujoco exact"][7, 1], 1.0)
    assert dataclasses.replace(curves, states=states) != curves
    assert dataclasses.replace(curves, parts={}) != curves
    assert dataclasses.replace(curves, scenario="other") != curves
    assert curves != "curves"


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"cart_mass": np.ones(3)}, "cart_mass"),
        ({"forces": {}}, "forces/"),
        ({"parts": {"total": np.ones(3)}}, "parts/total"),
        ({"energy": {"time": np.ones(3), "work": np.ones(2)}}, "energy/work"),
    ],
    ids=["input", "forces", "part", "energy"],
)
def test_arrays_that_do_not_belong_together_are_refused(
    curves: Curves, change: dict[str, object], named: str
) -> None:
    with pytest.raises(InvalidValueError, match=f"curve {named}.* must have shape"):
        dataclasses.replace(curves, **change)
