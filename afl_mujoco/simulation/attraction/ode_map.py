"""The map of attraction by the paper's equations (P3), (P4), the force continuous in time.

Each rollout is integrated by the steps of the reference (`dop853`), to a looser tolerance, until
it has settled or fallen; tests compare the maps with `simulate_ode`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba.extending import register_jitable

from afl_mujoco.compiled import kernel
from afl_mujoco.control.compiled_controller import force_from_inputs
from afl_mujoco.control.controller import Controller
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.execution.threads import Task, require_threads, share
from afl_mujoco.plant.dynamics import cart_acceleration, pole_acceleration
from afl_mujoco.simulation import dop853
from afl_mujoco.simulation.attraction.grid import (
    FALLEN,
    FOUND,
    SETTLED,
    UNDECIDED,
    AttractionMap,
    Grid,
    Settling,
    within,
)
from afl_mujoco.simulation.trajectory import FALL_ANGLE, STATE_LIMIT, within_limits

TOLERANCE = 1e-7
"""Local error of a step, for every state relative to 1 plus its size. A hundred times less or more
changes no outcome of the maps, except at an occasional grid point on a border."""

MAX_STEP = 0.02
"""Longest step [s]: the bands and the peaks are evaluated where steps end."""

FIRST_STEP, SMALLEST_STEP = 1e-3, 1e-12
"""The first step tried, and the step below which a rollout counts as fallen [s]."""

FALL_RESOLUTION = 1e-6
"""Resolution of the time of a fall [s]."""


def map_by_ode(
    grid: Grid,
    controller: Controller,
    *,
    settling: Settling | None = None,
    tolerance: float = TOLERANCE,
    threads: int = 1,
    progress: Callable[[int], None] = lambda points: None,
) -> AttractionMap:
    """Return how the ideal loop ends when started from every grid point.

    Parameters
    ----------
    tolerance
        Local error of a step, 1e-12 to 1e-2.
    threads
        Threads to share the grid points among; the result does not depend on their number.
    """
    settling = Settling() if settling is None else settling
    if not 1e-12 <= tolerance <= 1e-2:
        raise InvalidValueError("tolerance", "must lie within 1e-12 and 1e-2", tolerance)
    kind = controller.kind  # raises if the controller is not compiled
    masses, lengths = grid.plants.T
    inputs = controller.inputs_along_run(masses, lengths, grid.pole_mass, grid.gravity)
    rules = (settling.dwell, settling.horizon, tolerance, grid.pole_mass, grid.gravity)
    bands = np.array(settling.bands)
    found = np.empty((len(grid.starts), len(FOUND)))

    def run_part(part: slice) -> None:
        integrate_points(
            kind, grid.starts[part], inputs[part], grid.plants[part], bands, rules, found[part]
        )

    tasks: list[Task] = [run_part] * require_threads(threads)
    share(len(found), tasks, progress)
    settings = settling.describe() | {
        "method": "DOP853",
        "tolerance": tolerance,
        "max_step": MAX_STEP,
    }
    return AttractionMap.of(grid, controller.name, "ode", settings, found)


@register_jitable
def _force(arguments, state):
    """Return the force of the controller [N], NaN beyond `STATE_LIMIT`."""
    kind, inputs, _ = arguments
    force = force_from_inputs(kind, state, inputs)
    return force if abs(force) < STATE_LIMIT else np.nan


@register_jitable
def _rates(arguments, time, state, slopes):
    """Write (z_dot, phi_dot, z'', phi'') under the controller, as `dop853` needs them."""
    plant = arguments[2]
    phi, phi_dot, force = state[1], state[3], _force(arguments, state)
    slopes[0], slopes[1] = state[2], phi_dot
    slopes[2] = cart_acceleration(phi, phi_dot, force, *plant)
    slopes[3] = pole_acceleration(phi, phi_dot, force, *plant)


@kernel
def _rollout(kind, start, inputs, plant, bands, rules, found):
    """Integrate one rollout to its end and write its results."""
    dwell, horizon, tolerance = rules
    arguments = (kind, inputs, plant)
    state, after, slopes = start.copy(), np.empty(4), np.empty((dop853.ROWS, 4))
    time, step, since, outcome = 0.0, FIRST_STEP, -1.0, UNDECIDED
    _rates(arguments, time, state, slopes[0])
    force = _force(arguments, state)
    peak_z, peak_force = abs(state[0]), abs(force)
    if abs(state[1]) >= FALL_ANGLE or not within_limits(state) or np.isnan(force):
        outcome, peak_force, horizon = FALLEN, 0.0, 0.0
    while outcome == UNDECIDED:
        if not within(state, bands):
            since = -1.0
        elif since < 0.0:
            since = time
        if since >= 0.0 and time - since >= dwell:
            outcome = SETTLED
        if outcome == SETTLED or time >= horizon:
            break
        step = min(step, MAX_STEP, horizon - time)
        dop853.try_step(_rates, arguments, time, state, step, slopes, after)
        error = dop853.error_of(step, slopes, state, after, tolerance, tolerance)
        gone = abs(after[1]) >= FALL_ANGLE or not within_limits(after)
        if not error < 1.0 or (gone and step > FALL_RESOLUTION):
            step *= 0.5 if error < 1.0 else dop853.step_factor(error, True)
            if step < SMALLEST_STEP:
                outcome = FALLEN
            continue
        time = horizon if step == horizon - time else time + step
        state[:], slopes[0] = after, slopes[dop853.STAGES]
        peak_z, peak_force = (
            max(peak_z, abs(state[0])),
            max(peak_force, abs(_force(arguments, state))),
        )
        step *= dop853.step_factor(error, False)
        if gone:
            outcome = FALLEN
    found[0], found[1], found[2], found[3] = outcome, time, peak_z, peak_force


@kernel
def integrate_points(kind, starts, inputs, plants, bands, rules, found):
    """Integrate rollouts one after the other.

    Parameters
    ----------
    starts
        Initial states, shape (N, 4).
    inputs
        Inputs of the controller on each plant, shape (N, 7) or (N, 8).
    plants
        (M, l), shape (N, 2).
    bands
        Bands of the four states, shape (4,).
    rules
        Dwell and horizon [s], tolerance, m [kg], g [m/s^2].
    found
        Takes the results that `FOUND` names, shape (N, 4).
    """
    dwell, horizon, tolerance, pole_mass, gravity = rules
    for i in range(len(starts)):
        plant = (plants[i, 0], pole_mass, plants[i, 1], gravity)
        _rollout(kind, starts[i], inputs[i], plant, bands, (dwell, horizon, tolerance), found[i])
