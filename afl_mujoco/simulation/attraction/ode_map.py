"""The map of attraction by the paper's equations (P3), (P4), the law followed in time.

Each rollout is marched by the Runge-Kutta pair of Dormand and Prince of order 5(4) with a step size
of its own. `simulate_ode`, a hundred times slower, is what the tests hold it to.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.integrate import RK45

from afl_mujoco.compiled import borrowing_kernel, kernel
from afl_mujoco.control.compiled_law import given_force
from afl_mujoco.control.law import Law
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.execution.threads import Task, require_threads, share
from afl_mujoco.plant.dynamics import cart_acceleration, pole_acceleration
from afl_mujoco.simulation.attraction.cells import (
    FALLEN,
    FOUND,
    SETTLED,
    UNDECIDED,
    AttractionMap,
    Cells,
    Settling,
    within,
)
from afl_mujoco.simulation.trajectory import FALL_ANGLE, STATE_LIMIT, within_limits

TOLERANCE = 1e-7
"""Local error of a step, of every state relative to 1 plus its size. A hundred times less or more
leaves every outcome of the maps as it is, but for a cell now and then that is on a border."""

MAX_STEP = 0.02
"""Longest step [s]: states are looked at where steps end, for the bands and for the peaks."""

FIRST_STEP, SMALLEST_STEP = 1e-3, 1e-12
"""The first step tried, and one with which a rollout cannot go on: it has fallen [s]."""

FALL_RESOLUTION = 1e-6
"""How exactly the time of a fall is found [s]."""

# The tableau of Dormand and Prince: stages, the solution of order 5, its difference to order 4.
_STAGES, _SOLUTION, _ERROR = RK45.A.copy(), RK45.B.copy(), RK45.E.copy()


def map_by_ode(
    cells: Cells,
    controller: Law,
    *,
    settling: Settling | None = None,
    tolerance: float = TOLERANCE,
    threads: int = 1,
    progress: Callable[[int], None] = lambda cells: None,
) -> AttractionMap:
    """Return how the ideal loop ends from every cell.

    Parameters
    ----------
    cells
        Where the rollouts start, and on which plants.
    controller
        What is commanded, continuously in time.
    settling
        When a rollout has settled.
    tolerance
        Local error of a step, 1e-12 to 1e-2.
    threads
        Threads to share the cells among; the result does not depend on it.
    progress
        Called with how many more cells are done.

    Raises
    ------
    InvalidValueError
        If a setting breaks its rule, or a gain is not positive somewhere.
    """
    settling = Settling() if settling is None else settling
    if not 1e-12 <= tolerance <= 1e-2:
        raise InvalidValueError("tolerance", "must lie within 1e-12 and 1e-2", tolerance)
    kind = controller.compiled.kind  # raises if the law is no compiled one
    masses, lengths = cells.plants.T
    law = controller.law_inputs(masses, lengths, cells.pole_mass, cells.gravity)
    rules = (settling.dwell, settling.horizon, tolerance, cells.pole_mass, cells.gravity)
    bands = np.array(settling.bands)
    found = np.empty((len(cells.starts), len(FOUND)))

    def march(part: slice) -> None:
        march_cells(
            kind, cells.starts[part], law[part], cells.plants[part], bands, rules, found[part]
        )

    marches: list[Task] = [march] * require_threads(threads)
    share(len(found), marches, progress)
    settings = settling.describe() | {
        "method": "Dormand-Prince 5(4)",
        "tolerance": tolerance,
        "max_step": MAX_STEP,
    }
    return AttractionMap.of(cells, controller.name, "ode", settings, found)


@borrowing_kernel
def _rates(kind, state, law, plant, rates):
    """Write (z_dot, phi_dot, z'', phi'') under the law and return the force, or NaN."""
    cart_mass, half_length, pole_mass, gravity = plant
    phi, phi_dot = state[1], state[3]
    force = given_force(kind, state, law)
    if not abs(force) < STATE_LIMIT:
        force = np.nan
    rates[0], rates[1] = state[2], phi_dot
    rates[2] = cart_acceleration(phi, phi_dot, force, cart_mass, pole_mass, half_length, gravity)
    rates[3] = pole_acceleration(phi, phi_dot, force, cart_mass, pole_mass, half_length, gravity)
    return force


@borrowing_kernel
def _step(kind, law, plant, state, step, rates, after):
    """Try a step: write its stages' rates and the state after it, return the force there."""
    for stage in range(1, 6):
        for i in range(4):
            slope = 0.0
            for j in range(stage):
                slope += _STAGES[stage, j] * rates[j, i]
            after[i] = state[i] + step * slope
        _rates(kind, after, law, plant, rates[stage])
    for i in range(4):
        slope = 0.0
        for j in range(6):
            slope += _SOLUTION[j] * rates[j, i]
        after[i] = state[i] + step * slope
    return _rates(kind, after, law, plant, rates[6])


@borrowing_kernel
def _error(step, rates, after, tolerance):
    """Return the error of a step, 1 being allowed; infinite where something is not a number."""
    worst = 0.0
    for i in range(4):
        slope = 0.0
        for j in range(7):
            slope += _ERROR[j] * rates[j, i]
        error = step * abs(slope) / (tolerance * (1.0 + abs(after[i])))
        if not error < np.inf:
            return np.inf
        worst = max(worst, error)
    return worst


@kernel
def _march(kind, start, law, plant, bands, rules, found):
    """March one rollout to its end and write what is found."""
    dwell, horizon, tolerance = rules
    state, after, rates = start.copy(), np.empty(4), np.empty((7, 4))
    time, step, since, outcome = 0.0, FIRST_STEP, -1.0, UNDECIDED
    force = _rates(kind, state, law, plant, rates[0])
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
        force = _step(kind, law, plant, state, step, rates, after)
        error = _error(step, rates, after, tolerance)
        gone = abs(after[1]) >= FALL_ANGLE or not within_limits(after)
        if not error <= 1.0 or (gone and step > FALL_RESOLUTION):
            step *= max(0.2, 0.9 * error**-0.2) if error > 1.0 else 0.5
            if step < SMALLEST_STEP:
                outcome = FALLEN
            continue
        time = horizon if step == horizon - time else time + step
        state[:], rates[0] = after, rates[6]
        peak_z, peak_force = max(peak_z, abs(state[0])), max(peak_force, abs(force))
        step *= 0.9 * max(error, 1e-4) ** -0.2
        if gone:
            outcome = FALLEN
    found[0], found[1], found[2], found[3] = outcome, time, peak_z, peak_force


@kernel
def march_cells(kind, starts, laws, plants, bands, rules, found):
    """March rollouts one after the other.

    Parameters
    ----------
    kind
        Of law, as of `compiled_law`.
    starts
        Initial states, shape (N, 4).
    laws
        What the law is given on each plant, shape (N, 7) or (N, 8).
    plants
        (M, l), shape (N, 2).
    bands
        Of the four states, shape (4,).
    rules
        Dwell and horizon [s], tolerance, m [kg], g [m/s^2].
    found
        Takes what `FOUND` names, shape (N, 4).
    """
    dwell, horizon, tolerance, pole_mass, gravity = rules
    for i in range(len(starts)):
        plant = (plants[i, 0], plants[i, 1], pole_mass, gravity)
        _march(kind, starts[i], laws[i], plant, bands, (dwell, horizon, tolerance), found[i])
