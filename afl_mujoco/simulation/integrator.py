"""The reference integrator: DOP853 from breakpoint to breakpoint.

It knows neither the analytic equations nor MuJoCo: both hand it their own right-hand side, so that
what differs between two of its results is the right-hand side alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.parameters import require_positive
from afl_mujoco.scenario.scenario import Scenario, Segment
from afl_mujoco.simulation.trajectory import (
    COMPLETED,
    DIVERGED,
    FALL_ANGLE,
    FELL,
    OUTCOMES,
    STATE_LIMIT,
    Outcome,
    ending_of,
)

Derivative = Callable[[float, NDArray[np.float64], Segment], Sequence[float]]
"""(time, state, segment) -> its rate of change; NaN where the law has no value."""

Transition = Callable[[NDArray[np.float64], Segment | None, Segment], NDArray[np.float64]]
"""(state, segment before or None at the start, segment after) -> the state after the breakpoint."""

RTOL = 1e-12
ATOL = 1e-14
MAX_STEP = 0.02
"""Longest step [s]: bounds the error of the dense output, which the error control does not see."""

MIN_RTOL = 100 * np.finfo(float).eps
"""Below this, the integrator would silently use this."""

METHODS = ("DOP853", "Radau", "RK45", "LSODA")


def _fall_margin(time: float, state: NDArray[np.float64]) -> float:
    """Return how far the pole is from `FALL_ANGLE` [rad]."""
    return FALL_ANGLE - abs(float(state[1]))


def _divergence_margin(time: float, state: NDArray[np.float64]) -> float:
    """Return how far the state is from `STATE_LIMIT`."""
    return STATE_LIMIT - float(np.abs(state[:4]).max())


_fall_margin.terminal = True  # type: ignore[attr-defined]
_divergence_margin.terminal = True  # type: ignore[attr-defined]


def integrate(
    scenario: Scenario,
    derivative: Derivative,
    transition: Transition,
    times: NDArray[np.float64],
    *,
    quadratures: int = 0,
    method: str = "DOP853",
    rtol: float = RTOL,
    atol: float = ATOL,
) -> tuple[NDArray[np.float64], Outcome]:
    """Integrate a scenario with a given right-hand side.

    Parameters
    ----------
    scenario
        Gives initial state, breakpoints and parameters.
    derivative
        The right-hand side.
    transition
        What a breakpoint does to the state.
    times
        Where to report the state [s], increasing, from 0 to the horizon, shape (N,).
    quadratures
        How many integrals are carried along behind the four states, from zero.
    method, rtol, atol
        As of `scipy.integrate.solve_ivp`.

    Returns
    -------
    ndarray
        The state at those times that the run reached, shape (K, 4 + quadratures).
    Outcome
        How it ended.
    """
    if not rtol >= MIN_RTOL:
        raise InvalidValueError("rtol", f"must be at least {MIN_RTOL:.1e}", rtol)
    require_positive("atol", atol)
    state = np.array([*scenario.initial_state, *[0.0] * quadratures])
    reached: list[NDArray[np.float64]] = []
    before: Segment | None = None
    for segment in scenario.segments:
        state = transition(state, before, segment)
        before = segment
        last = segment.end == scenario.duration
        inside = times[(times >= segment.start) & ((times < segment.end) | last)]
        right_hand_side = partial(_rate, derivative, segment)
        if (
            abs(state[1]) >= FALL_ANGLE
            or not np.isfinite(right_hand_side(segment.start, state)).all()
        ):
            reached.append(np.atleast_2d(state)[: len(inside)])
            return np.concatenate(reached), Outcome(_ending(state), segment.start)
        solution = solve_ivp(  # type: ignore[call-overload]
            right_hand_side,
            (segment.start, segment.end),
            state,
            method=method,
            t_eval=np.union1d(inside, [segment.end]),
            rtol=rtol,
            atol=atol,
            max_step=MAX_STEP,
            events=(_fall_margin, _divergence_margin),
        )
        samples = np.reshape(solution.y, (len(state), -1)).T
        reached.append(samples[np.isin(solution.t, inside)])
        if solution.status != 0:
            return np.concatenate(reached), _premature_end(solution, segment)
        state = samples[-1]
    return np.concatenate(reached), Outcome(COMPLETED, scenario.duration)


def _rate(
    derivative: Derivative, segment: Segment, time: float, state: NDArray[np.float64]
) -> Sequence[float]:
    """Return the right-hand side as the integrator calls it."""
    return derivative(time, state, segment)


def _premature_end(solution: Any, segment: Segment) -> Outcome:
    """Say how a segment that did not reach its end ended."""
    fell, diverged = solution.t_events
    if len(fell):
        return Outcome(FELL, float(fell[0]))
    if len(diverged):
        return Outcome(DIVERGED, float(diverged[0]))
    if not len(solution.t):
        return Outcome(DIVERGED, segment.start)
    return Outcome(_ending(solution.y[:, -1]), float(solution.t[-1]))


def _ending(state: NDArray[np.float64]) -> str:
    """Return how a run has ended that cannot go on from `state`."""
    return OUTCOMES[ending_of(state)]
