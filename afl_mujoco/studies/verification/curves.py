"""Curves over time for figures: some instants of the runs of a case."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.controller import Controller
from afl_mujoco.errors import InvalidValueError
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

_PLAIN = ("cart_mass", "half_length", "push")
_GROUPS = ("states", "forces", "parts", "energy")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Curves:
    """Scenario and controller over time, in every simulator of the report.

    Two are equal if all their numbers are. A run that fell has the first K of the N instants.

    Attributes
    ----------
    scenario, controller
        What was simulated.
    time
        Instants [s], shape (N,), increasing: multiples of the timestep.
    cart_mass, half_length, push
        M [kg], l [m] and the disturbing force [N], shape (N,); at a jump, the values after it.
    states
        (z, phi, z_dot, phi_dot) [m, rad, m/s, rad/s] by simulator, shape (K, 4).
    forces
        Force of the controller [N] by simulator, shape (K,).
    parts
        The error budget over time, the largest of any state, shape (N,): ``total``, each source,
        ``residual``; empty if there is no budget.
    energy
        The ledger of energy [J] and its ``time`` [s], shape (E,), as from `ledger.ledger`; empty
        if there is no ledger.
    """

    scenario: str
    controller: str
    time: Array
    cart_mass: Array
    half_length: Array
    push: Array
    states: Mapping[str, Array]
    forces: Mapping[str, Array]
    parts: Mapping[str, Array] = field(default_factory=dict)
    energy: Mapping[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the shapes."""
        count, instants = len(self.time), len(self.energy.get("time", ()))
        reached = {name: len(states) for name, states in self.states.items()}
        wanted: dict[str, tuple[int, ...]] = {name: (count,) for name in ("time", *_PLAIN)}
        wanted |= {f"states/{name}": (min(k, count), 4) for name, k in reached.items()}
        wanted |= {f"forces/{name}": (k,) for name, k in reached.items()}
        wanted |= {f"parts/{name}": (count,) for name in self.parts}
        wanted |= {f"energy/{name}": (instants,) for name in self.energy}
        found = {key: array.shape for key, array in self.arrays().items()}
        if found != wanted:
            odd = sorted(k for k in wanted | found if wanted.get(k) != found.get(k))
            raise InvalidValueError(f"curve {odd[0]}", f"must have shape {wanted.get(odd[0])}")
        if not len(self.states.get(REFERENCE, ())):
            raise InvalidValueError("curve states", f"must hold a run of {REFERENCE!r}")

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Curves):
            return NotImplemented
        mine, theirs = self.arrays(), other.arrays()
        return (
            (self.scenario, self.controller) == (other.scenario, other.controller)
            and mine.keys() == theirs.keys()
            and all(np.array_equal(mine[key], theirs[key], equal_nan=True) for key in mine)
        )

    def arrays(self) -> dict[str, NDArray[np.float64]]:
        """Return every array by its name."""
        found = {name: getattr(self, name) for name in ("time", *_PLAIN)}
        for group in _GROUPS:
            found |= {f"{group}/{key}": array for key, array in getattr(self, group).items()}
        return found


def select_curves(
    scenario: Scenario,
    controller: Controller,
    runs: Mapping[str, Trajectory],
    *,
    timestep: float,
    parts: Mapping[str, NDArray[np.float64]],
    energy: Mapping[str, NDArray[np.float64]],
) -> Curves:
    """Select the instants that figures need from the runs of one scenario and controller.

    All multiples of the timestep shortly after the start and each breakpoint are kept, a few
    elsewhere, and those at which a curve, or a difference from the ODE, is largest.

    Parameters
    ----------
    timestep
        Spacing of the instants of which some are kept [s].
    """
    grid = step_times(scenario.duration, timestep)
    rows = {name: _rows(run, grid) for name, run in runs.items()}
    states = {name: run.state[rows[name]] for name, run in runs.items()}
    forces = {name: run.force[rows[name]] for name, run in runs.items()}
    kept = _regular(scenario, grid, timestep)
    for name, state in states.items():
        kept[len(state) - 1] = True
        both = min(len(state), len(states[REFERENCE]))
        difference = state[:both] - states[REFERENCE][:both]
        for curve in (state, forces[name], difference):
            kept[_extremes(curve)] = True
    for curve in parts.values():
        kept[_extremes(curve)] = True
    time = grid[kept]
    return Curves(
        scenario=scenario.name,
        controller=controller.name,
        time=time,
        cart_mass=scenario.cart_mass(time),
        half_length=scenario.half_length(time),
        push=scenario.pushes(time),
        states={name: state[kept[: len(state)]] for name, state in states.items()},
        forces={name: force[kept[: len(force)]] for name, force in forces.items()},
        parts={name: np.abs(part).max(axis=1)[kept] for name, part in parts.items()},
        energy=energy,
    )


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


def _extremes(curve: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return where each column of a curve is largest."""
    columns = np.abs(curve.reshape(len(curve), -1))
    return np.atleast_1d(np.argmax(columns, axis=0)) if len(curve) else np.empty(0, dtype=np.intp)
