"""From which starts a controller copes with a scenario as deployed, imperfections included."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.controller import Controller
from afl_mujoco.control.own.python_controller import ControllerError
from afl_mujoco.scenario.requirements import NONE
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.attraction.grid import FALLEN, SETTLED, UNDECIDED
from afl_mujoco.simulation.sampled.rollouts import Rollouts, run_rollouts
from afl_mujoco.simulation.trajectory import COMPLETED, DIVERGED, FELL
from afl_mujoco.studies.arrays import Array

WORDS = {
    True: ("meets all", "falls", "misses a requirement", "controller fails"),
    False: ("settles", "falls", "does not settle or hits a stop", "controller fails"),
}
"""How a run ends, by its code; with requirements, and without."""

FAILED = 3
"""Code of a run whose controller raises or returns no force, besides those of `grid.OUTCOMES`."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StartMap:
    """How the runs of one controller on a scenario end, by where they start.

    Attributes
    ----------
    scenario, controller
        Their names.
    judged
        Whether requirements decide.
    own
        (phi, phi_dot) at which the scenario itself starts [rad, rad/s].
    own_outcome
        How the run from there ends, as in `outcome`.
    timestep, integrator
        MuJoCo's step [s], None for the default, and integrator.
    shares
        Shares of the grid points by how they end, as in `WORDS` [1].
    angles, rates
        phi(0) [rad], shape (columns,), and phi_dot(0) [rad/s], shape (rows,).
    outcome
        `SETTLED`, `FALLEN`, `UNDECIDED` or `FAILED`, shape (rows, columns).
    """

    scenario: str
    controller: str
    judged: bool
    own: tuple[float, float]
    own_outcome: int
    timestep: float | None
    integrator: str
    shares: dict[str, float]
    angles: Array
    rates: Array
    outcome: Array


def map_starts(
    scenario: Scenario,
    controller: Controller,
    angles: NDArray[np.float64],
    rates: NDArray[np.float64],
    *,
    timestep: float | None,
    integrator: str,
    threads: int,
    progress: Callable[[int], None],
) -> StartMap:
    """Run a controller from every start; the results do not depend on the threads.

    Parameters
    ----------
    angles, rates
        phi(0) [rad] and phi_dot(0) [rad/s].
    """
    judged = scenario.requirements != NONE and bool(scenario.required)
    settings: Any = {"timestep": timestep, "integrator": integrator, "threads": threads}
    rows = []
    for rate in rates.tolist():
        starts = [_started(scenario, angle, rate) for angle in angles.tolist()]
        rows.append(_outcomes(starts, controller, judged, settings))
        progress(len(starts))
    outcome = np.array(rows, dtype=np.uint8)
    counts = np.bincount(outcome.ravel(), minlength=len(WORDS[judged])) / outcome.size
    return StartMap(
        scenario=scenario.name,
        controller=controller.name,
        judged=judged,
        own=(scenario.initial_state[1], scenario.initial_state[3]),
        own_outcome=_outcomes([scenario], controller, judged, settings)[0],
        timestep=timestep,
        integrator=integrator,
        shares=dict(zip(WORDS[judged], counts.tolist(), strict=True)),
        angles=angles,
        rates=rates,
        outcome=outcome,
    )


def _started(scenario: Scenario, angle: float, rate: float) -> Scenario:
    """Return a scenario with another start."""
    z, _, z_dot, _ = scenario.initial_state
    return replace(scenario, initial_state=(z, angle, z_dot, rate))


def _outcomes(
    starts: Sequence[Scenario], controller: Controller, judged: bool, settings: Any
) -> list[int]:
    """Return how the runs of a controller end."""
    if controller.interpreted:
        return [_alone(start, controller, judged, settings) for start in starts]
    runs = run_rollouts(starts, controller, **settings)
    return [_outcome(runs, i, judged) for i in range(len(runs))]


def _alone(start: Scenario, controller: Controller, judged: bool, settings: Any) -> int:
    """Return how a run of a Python controller ends; the controller may fail."""
    try:
        return _outcome(run_rollouts([start], controller, **settings), 0, judged)
    except ControllerError:
        return FAILED


def _outcome(runs: Rollouts, index: int, judged: bool) -> int:
    """Return how a run ended."""
    failure, ended = runs.failure(index), runs.outcome(index).kind
    if failure in (FELL, DIVERGED) or not (judged or ended == COMPLETED):
        return FALLEN
    return UNDECIDED if failure or not (judged or runs.settled(index)) else SETTLED
