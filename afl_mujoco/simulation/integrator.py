"""The reference integrator: DOP853 from breakpoint to breakpoint.

It knows neither the analytic equations nor MuJoCo: both hand it their own right-hand side, so that
what differs between two of its results is the right-hand side alone.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from afl_mujoco.scenario.scenario import Scenario, Segment
from afl_mujoco.simulation.trajectory import (
    COMPLETED,
    DIVERGED,
    FALL_ANGLE,
    FELL,
    STATE_LIMIT,
    Outcome,
)

Derivative = Callable[[NDArray[np.float64], float, float, float], tuple[float, ...]]
"""(state, M, l, push) -> (z_dot, phi_dot, z'', phi''); NaN where the law has no value."""

Strike = Callable[[NDArray[np.float64], float, float, float], NDArray[np.float64]]
"""(state, M, l, impulse) -> jump of (z_dot, phi_dot)."""

RTOL = 1e-12
ATOL = 1e-14
MAX_STEP = 0.02
"""Longest step [s]: bounds the error of the dense output, which the error control does not see."""

METHODS = ("DOP853", "Radau", "RK45", "LSODA")


def _fall_margin(time: float, state: NDArray[np.float64]) -> float:
    """Return how far the pole is from `FALL_ANGLE` [rad]."""
    return FALL_ANGLE - abs(float(state[1]))


def _divergence_margin(time: float, state: NDArray[np.float64]) -> float:
    """Return how far the state is from `STATE_LIMIT`."""
    return STATE_LIMIT - float(np.abs(state).max())


_fall_margin.terminal = True  # type: ignore[attr-defined]
_divergence_margin.terminal = True  # type: ignore[attr-defined]


def integrate(
    scenario: Scenario,
    derivative: Derivative,
    strike: Strike,
    times: NDArray[np.float64],
    *,
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
    strike
        The jump of the velocities under an ideal impulse.
    times
        Where to report the state [s], increasing, from 0 to the horizon, shape (N,).
    method, rtol, atol
        As of `scipy.integrate.solve_ivp`.

    Returns
    -------
    ndarray
        The state at those times that the run reached, shape (K, 4).
    Outcome
        How it ended.
    """
    state = np.array(scenario.initial_state)
    reached: list[NDArray[np.float64]] = []
    for segment in scenario.segments:
        if abs(state[1]) >= FALL_ANGLE:
            return _stack(reached), Outcome(FELL, segment.start)
        if segment.impulse != 0.0:
            mass, length = segment.parameters_at(segment.start)
            state = state.copy()
            state[2:] += strike(state, mass, length, segment.impulse)
        last = segment.end == scenario.duration
        inside = (times >= segment.start) & ((times < segment.end) | last)
        solution = solve_ivp(  # type: ignore[call-overload]
            _right_hand_side(derivative, segment),
            (segment.start, segment.end),
            state,
            method=method,
            t_eval=np.union1d(times[inside], [segment.end]),
            rtol=rtol,
            atol=atol,
            max_step=MAX_STEP,
            events=(_fall_margin, _divergence_margin),
        )
        samples = solution.y.T
        kept = np.isin(solution.t, times[inside])
        reached.append(samples[kept])
        if solution.status != 0:
            return _stack(reached), _premature_end(solution, state, segment)
        state = samples[-1]
    return _stack(reached), Outcome(COMPLETED, scenario.duration)


def _right_hand_side(
    derivative: Derivative, segment: Segment
) -> Callable[[float, NDArray[np.float64]], tuple[float, ...]]:
    """Return `derivative` with the segment's parameters as a function of (t, y)."""

    def right_hand_side(time: float, state: NDArray[np.float64]) -> tuple[float, ...]:
        mass, length = segment.parameters_at(time)
        return derivative(state, mass, length, segment.push)

    return right_hand_side


def _premature_end(solution: Any, state: NDArray[np.float64], segment: Segment) -> Outcome:
    """Say how a segment that did not reach its end ended."""
    fell, diverged = solution.t_events
    if len(fell):
        return Outcome(FELL, float(fell[0]))
    if len(diverged):
        return Outcome(DIVERGED, float(diverged[0]))
    return Outcome(DIVERGED, float(solution.t[-1]) if len(solution.t) else segment.start)


def _stack(reached: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Join the samples of the segments, shape (K, 4)."""
    return np.concatenate(reached) if reached else np.empty((0, 4))
