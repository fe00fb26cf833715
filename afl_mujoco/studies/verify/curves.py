"""Some instants of the runs of a case over time, for the figures and the replays of the page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.parameters import SCHEDULES
from afl_mujoco.scenario.sampling import step_times
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.trajectory import Trajectory
from afl_mujoco.studies.arrays import Array

REFERENCE = "ode"
"""The run from which the differences of the others are measured."""

DENSE = 0.1
"""Time after the start and after each breakpoint in which every instant is kept [s]."""

SPARSE = 0.02
"""Spacing of the instants elsewhere [s]."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Curves:
    """A case over time, in every simulator of the report.

    A run that fell has the first K of the N instants.
    """

    scenario: str
    controller: str
    time: Array  # [s], shape (N,), increasing: multiples of the timestep
    # what changes of the plant, by name, and the disturbances of each channel; at a jump, after it
    parameters: Mapping[str, Array]
    push: Array  # shape (N, channels)
    states: Mapping[str, Array]  # by simulator, shape (K, 2 n)
    forces: Mapping[str, Array]  # of the controller by simulator, shape (K,), of k inputs (K, k)

    def __post_init__(self) -> None:
        """Check the shapes."""
        count = len(self.time)
        for name, values in self.parameters.items():
            _require_shape(name, values, (count,))
        _require_shape("push", self.push, (count, *self.push.shape[1:]))
        for name, state in self.states.items():
            reached, force = min(len(state), count), self.forces.get(name)
            _require_shape(f"states/{name}", state, (reached, *state.shape[1:]))
            several = () if force is None else force.shape[1:]
            _require_shape(f"forces/{name}", force, (reached, *several))
        if not len(self.states.get(REFERENCE, ())):
            raise InvalidValueError("curve states", f"must hold a run of {REFERENCE!r}")


def _require_shape(name: str, array: NDArray[Any] | None, shape: tuple[int, ...]) -> None:
    """Raise if a curve is missing or has another shape."""
    if array is None or array.shape != shape:
        raise InvalidValueError(f"curve {name}", f"must have shape {shape}")


def select_curves(
    scenario: Scenario,
    controller: str,
    runs: Mapping[str, Trajectory],
    timestep: float,
) -> Curves:
    """Select the instants that are drawn from the runs of one scenario and controller.

    All multiples of the timestep [s] shortly after the start and each breakpoint are kept, a few
    elsewhere, and those at which a curve, or a difference from the ODE, is largest.
    """
    grid = step_times(scenario.duration, timestep)
    rows = {name: _rows(run, grid) for name, run in runs.items()}
    states = {name: run.state[rows[name]] for name, run in runs.items()}
    forces = {name: run.input[rows[name]] for name, run in runs.items()}
    kept = _regular(scenario, grid, timestep)
    for name, state in states.items():
        kept[len(state) - 1] = True
        both = min(len(state), len(states[REFERENCE]))
        for curve in (state, forces[name], state[:both] - states[REFERENCE][:both]):
            kept[np.abs(curve).argmax(axis=0)] = True
    time = grid[kept]
    return Curves(
        scenario=scenario.name,
        controller=controller,
        time=time,
        parameters={name: scenario.schedule[name](time) for name in drawn_parameters(scenario)},
        push=scenario.pushes(time),
        states={name: state[kept[: len(state)]] for name, state in states.items()},
        forces={name: force[kept[: len(force)]] for name, force in forces.items()},
    )


def drawn_parameters(scenario: Scenario) -> list[str]:
    """Return the parameters that change; of the cart-pole those that may."""
    if scenario.is_cart_pole:
        return list(SCHEDULES)
    return [name for name, one in scenario.schedule.items() if one.breakpoints]


def _rows(run: Trajectory, grid: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the rows of a run at the instants of the grid that it reached."""
    rows = np.searchsorted(run.time, grid - 1e-9)
    return rows[rows < len(run.time)]


def _regular(scenario: Scenario, grid: NDArray[np.float64], timestep: float) -> NDArray[np.bool_]:
    """Return which instants are always kept."""
    kept = np.zeros(len(grid), dtype=np.bool_)
    kept[:: max(1, round(SPARSE / timestep))] = True
    kept[-2:] = True
    for start in (0.0, *scenario.breakpoints):
        # The last instant before a breakpoint is kept as well: a jump is drawn as one.
        kept[(grid > start - 1.5 * timestep) & (grid <= start + DENSE)] = True
    return kept
