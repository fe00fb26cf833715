"""The curves for figures: what is selected of a run, and that files give it back."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.simulation.trajectory import Trajectory
from afl_mujoco.studies.cases import REPORTED, Settings, closed_loop_runs
from afl_mujoco.studies.verify.curves import Curves, select_curves

SHORT = dataclasses.replace(
    afl.SCENARIOS["step-trapezoid"],
    name="short",
    duration=1.2,
    schedule={
        **afl.SCENARIOS["step-trapezoid"].schedule,
        "cart_mass": afl.staircase((0.6,), (0.5, 1.0)),
    },
    disturbances=(afl.ForcePulse(force=-10.0, start=0.8, duration=0.1),),
)
ADAPTIVE = afl.CONTROLLERS["adaptive"]
H = 1e-3


@pytest.fixture(scope="module")
def runs() -> dict[str, Trajectory]:
    return closed_loop_runs(SHORT, ADAPTIVE, Settings())


def selected(runs: dict[str, Trajectory]) -> Curves:
    return select_curves(SHORT, "adaptive", {name: runs[name] for name in REPORTED}, H)


@pytest.fixture(scope="module")
def curves(runs: dict[str, Trajectory]) -> Curves:
    return selected(runs)


def test_the_drawn_maximum_of_every_difference_is_the_reported_one(
    curves: Curves, runs: dict[str, Trajectory]
) -> None:
    ode = runs["ode"]
    for name in REPORTED[1:]:
        drawn = np.abs(curves.states[name] - curves.states["ode"]).max(axis=0)
        on_grid = np.searchsorted(runs[name].time, ode.time - 1e-9)
        reported = np.abs(runs[name].state[on_grid] - ode.state).max(axis=0)
        np.testing.assert_array_equal(drawn, reported)


def test_a_peak_between_the_regular_instants_is_kept(runs: dict[str, Trajectory]) -> None:
    state = runs["mujoco exact"].state.copy()
    state[507, 2] += 1.0  # 20 ms apart there, from 500 ms on
    peaked = dataclasses.replace(runs["mujoco exact"], state=state)
    curves = selected({**runs, "mujoco exact": peaked})
    difference = np.abs(curves.states["mujoco exact"] - curves.states["ode"])
    assert difference.max() == pytest.approx(1.0, abs=1e-6)
    assert 0.507 in curves.time.round(9)


def test_a_run_that_fell_has_the_instants_that_it_reached(runs: dict[str, Trajectory]) -> None:
    whole = runs["mujoco continuous"]
    cut = {name: getattr(whole, name)[:552] for name in ("time", "state", "input", "command")}
    kept = {name: values[:552] for name, values in whole.parameters.items()}
    fallen = dataclasses.replace(whole, **cut, parameters=kept, outcome=afl.Outcome("fell", 0.551))
    curves = selected({**runs, "mujoco continuous": fallen})
    reached = len(curves.states["mujoco continuous"])
    assert curves.time[reached - 1] == pytest.approx(0.551)
    assert len(curves.forces["mujoco continuous"]) == reached < len(curves.time)
    assert len(curves.states["ode"]) == len(curves.time)


@pytest.mark.parametrize(
    ("change", "named"),
    [({"parameters": {"cart_mass": np.ones(3)}}, "cart_mass"), ({"forces": {}}, "forces/")],
    ids=["input", "forces"],
)
def test_arrays_that_do_not_belong_together_are_refused(
    curves: Curves, change: dict[str, object], named: str
) -> None:
    with pytest.raises(InvalidValueError, match=f"curve {named}.* must have shape"):
        dataclasses.replace(curves, **change)
