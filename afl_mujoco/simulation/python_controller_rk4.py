"""RK4 with a Python controller: the algorithm of the compiled loops, one call at a time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from afl_mujoco.control.controller import Controller
from afl_mujoco.simulation.trajectory import (
    COMPLETED,
    FALL_ANGLE,
    FELL,
    OUTCOMES,
    STATE_LIMIT,
    ending_of,
    within_limits,
)

Array = NDArray[np.float64]
Arrival = Callable[[int, Array], Array]
"""(number of the step, state) -> the state after what happens at the step's start."""
Slope = Callable[[int, int, Array, float], ArrayLike]
"""(number of the step; 0, 1, 2 for its start, middle, end; state; force) -> rate of the state."""

_COMPLETED, _FELL = OUTCOMES.index(COMPLETED), OUTCOMES.index(FELL)
_STAGES = ((0, 0.0), (1, 0.5), (1, 0.5), (2, 1.0))


def integrate_python_controller(
    controller: Controller,
    initial_state: Array,
    times: Array,
    assumed: Array,
    arrive: Arrival,
    slope: Slope,
) -> tuple[Array, Array, int]:
    """Integrate by textbook RK4, the controller evaluated in every stage, until the run ends.

    times: Ends of the steps [s], shape (N + 1,).
    assumed: Assumed (M, m, l, g) at the start, the middle and the end of each step, shape (N, 3,
        4).
    Returns tuple: States reached, shape (K, 4), the force from each of these instants on [N], shape
        (K,), and the index of the outcome.
    """
    count, force = len(times) - 1, 0.0
    states, forces = np.empty((count + 1, 4)), np.empty(count + 1)
    states[0] = initial_state
    for k in range(count + 1):
        x = states[k]
        forces[k] = force
        if abs(x[1]) >= FALL_ANGLE:
            return states[: k + 1], forces[: k + 1], _FELL
        if k == count:
            break
        x[:] = arrive(k, x)
        force = forces[k] = controller.command(times[k], x, assumed[k, 0])
        dt, slopes = times[k + 1] - times[k], np.full((4, 4), np.nan)
        for i, (stage, share) in enumerate(_STAGES):
            state, acting = x + (share * dt) * slopes[i - 1] if i else x, force
            if i:
                acting = controller.command(times[k] + share * dt, state, assumed[k, stage])
            if not abs(acting) < STATE_LIMIT:
                return states[: k + 1], forces[: k + 1], ending_of(x)
            slopes[i] = slope(k, stage, state, acting)
        after = x + (dt / 6.0) * (slopes[0] + 2.0 * slopes[1] + 2.0 * slopes[2] + slopes[3])
        if not within_limits(after):
            return states[: k + 1], forces[: k + 1], ending_of(x)
        states[k + 1] = after
    return states, forces, _COMPLETED
