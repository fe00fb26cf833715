"""The reference integrator: DOP853 from breakpoint to breakpoint.

It depends neither on the analytic equations nor on MuJoCo: both pass their own right-hand side, so
that their results differ by the right-hand side alone. The compiled method (`dop853`) integrates a
compiled right-hand side; SciPy integrates any other right-hand side, and by any other method.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from afl_mujoco.errors import InvalidValueError, UnknownNameError
from afl_mujoco.scenario.parameter_change import ParameterChange
from afl_mujoco.scenario.parameters import require_positive
from afl_mujoco.scenario.scenario import Scenario, Segment
from afl_mujoco.simulation import dop853
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
"""(time, state, segment) -> its rate of change; NaN where the controller has no value."""

Transition = Callable[[NDArray[np.float64], Segment | None, Segment], NDArray[np.float64]]
"""(state, segment before or None at the start, segment after) -> the state after the breakpoint."""

Solver = Callable[
    [Segment, NDArray[np.float64], NDArray[np.float64]],
    tuple[NDArray[np.float64], Outcome | None],
]
"""(segment, state at its start, times in it up to its end) -> states at the times reached, and how
the run ended if it did before the segment's end."""

RTOL = 1e-12
ATOL = 1e-14
MAX_STEP = 0.02
"""Longest step [s]: bounds the error of the dense output, which the error control does not see."""

MIN_RTOL = 100 * np.finfo(float).eps
"""Least relative tolerance: below it, the integrator would silently use this value."""

MOST_EVALUATIONS = 20_000
"""Most evaluations of a right-hand side in Python within `MAX_STEP` of simulated time.

A step takes 12; the paper's controllers, whose force has kinks, need fewer than 1000. One
that is not a smooth function of the state needs more than any number.
"""

NONE = np.empty(0)

SHORTEST = 1e-9
"""Least length of a part [s]: M and l may pass nodes at one time, but for round-off."""

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
    solver: Solver,
    transition: Transition,
    times: NDArray[np.float64],
    *,
    nodes: tuple[NDArray[np.float64], NDArray[np.float64]] = (NONE, NONE),
    quadratures: int = 0,
) -> tuple[NDArray[np.float64], Outcome]:
    """Integrate a scenario from breakpoint to breakpoint, and from node to node of the gains.

    Error control does not see all of the error of a step across a kink: none steps across one.

    times: Times at which to report the state [s], increasing, from 0 to the horizon, shape (N,).
    nodes: `Controller.nodes`: the M [kg] and l [m] at which the right-hand side is not smooth.
    Returns ndarray: The state at the times that the run reached, shape (K, 4 + quadratures).
    """
    state = np.array([*scenario.initial_state, *[0.0] * quadratures])
    reached: list[NDArray[np.float64]] = []
    before: Segment | None = None
    for segment, arrives in _smooth_parts(scenario, nodes):
        if arrives:
            state = transition(state, before, segment)
        before = segment
        last = segment.end == scenario.duration
        inside = times[(times >= segment.start) & ((times < segment.end) | last)]
        if abs(state[1]) >= FALL_ANGLE:
            reached.append(np.atleast_2d(state)[: len(inside)])
            return np.concatenate(reached), Outcome(FELL, segment.start)
        wanted = np.union1d(inside, [segment.end])
        samples, outcome = solver(segment, state, wanted)
        reached.append(samples[np.isin(wanted[: len(samples)], inside)])
        if outcome is not None:
            return np.concatenate(reached), outcome
        state = samples[-1]
    return np.concatenate(reached), Outcome(COMPLETED, scenario.duration)


def _smooth_parts(
    scenario: Scenario, nodes: tuple[NDArray[np.float64], NDArray[np.float64]]
) -> Iterator[tuple[Segment, bool]]:
    """Yield the segments, cut where M or l passes a node; True for what begins at a breakpoint."""
    for segment in scenario.segments:
        passed: list[float] = []
        for (value, rate), at in zip((segment.cart_mass, segment.half_length), nodes, strict=True):
            if rate:
                passed += (segment.start + (at - value) / rate).tolist()
        cuts = [segment.start]
        for time in sorted(passed):
            if cuts[-1] + SHORTEST < time < segment.end - SHORTEST:
                cuts.append(time)
        for part in segment.cut_at(cuts[1:]):
            yield part, part.start == segment.start


def require_tolerances(method: str, rtol: float, atol: float) -> None:
    """Raise if there is no such method, or a tolerance is out of bounds."""
    if method not in METHODS:
        raise UnknownNameError.among("method", method, METHODS)
    if not rtol >= MIN_RTOL:
        raise InvalidValueError("rtol", f"must be at least {MIN_RTOL:.1e}", rtol)
    require_positive("atol", atol)


def scipy_solver(
    derivative: Derivative,
    method: str = "DOP853",
    rtol: float = RTOL,
    atol: float = ATOL,
    *,
    controller: str,
) -> Solver:
    """Return SciPy's integrator of a right-hand side in Python."""
    require_tolerances(method, rtol, atol)

    def solve(
        segment: Segment, state: NDArray[np.float64], times: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], Outcome | None]:
        right_hand_side = _Counted(derivative, segment, controller)
        if not np.isfinite(right_hand_side(segment.start, state)).all():
            return np.atleast_2d(state), Outcome(_ending(state), segment.start)
        solution = solve_ivp(  # type: ignore[call-overload]
            right_hand_side,
            (segment.start, segment.end),
            state,
            method=method,
            t_eval=times,
            rtol=rtol,
            atol=atol,
            max_step=MAX_STEP,
            events=(_fall_margin, _divergence_margin),
        )
        samples = np.reshape(solution.y, (len(state), -1)).T
        return samples, None if solution.status == 0 else _premature_end(solution, segment)

    return solve


def compiled_solver(
    solve: Callable[..., tuple[int, float, int]],
    rtol: float = RTOL,
    atol: float = ATOL,
    longest: float = MAX_STEP,
) -> Solver:
    """Return the compiled integrator as `integrate` takes it.

    longest: Longest step [s].
    """
    options = (rtol, atol, longest)
    work = np.empty(dop853.WORK)

    def integrate_segment(
        segment: Segment, state: NDArray[np.float64], times: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], Outcome | None]:
        state, found = state.copy(), np.empty((len(times), 4))
        count, time, status = solve(segment, state, times, options, work, found)
        samples = found[:count]
        if status == dop853.REACHED:
            return samples, None
        fell = status == dop853.STOPPED and abs(state[1]) > FALL_ANGLE - 1e-9
        return samples, Outcome(FELL if fell else _ending(state), float(time))

    return integrate_segment


def segment_numbers(
    scenario: Scenario, segment: Segment, change: ParameterChange
) -> tuple[float, ...]:
    """Return the numbers of a segment for a compiled right-hand side.

    Its start [s]; M and its rate [kg, kg/s]; l and its rate [m, m/s]; m [kg]; g [m/s^2]; the push
    [N]; and the rate of l that acts on the rod [m/s].
    """
    return (
        segment.start,
        *segment.cart_mass,
        *segment.half_length,
        scenario.pole_mass,
        scenario.gravity,
        segment.push,
        segment.half_length[1] if change.stretching else 0.0,
    )


class _Counted:
    """The right-hand side in a segment, which raises if it is evaluated too often."""

    def __init__(self, derivative: Derivative, segment: Segment, controller: str) -> None:
        self.derivative, self.segment, self.controller = derivative, segment, controller
        self.count, self.until = 0, segment.start + MAX_STEP

    def __call__(self, time: float, state: NDArray[np.float64]) -> Sequence[float]:
        """Return the rate of change of the state."""
        if time >= self.until:
            self.count, self.until = 0, time + MAX_STEP
        self.count += 1
        if self.count > MOST_EVALUATIONS:
            rule = (
                "must give a force that is a smooth function of time and state where it is "
                "evaluated continuously, not one that is rounded (float32), switches, or remembers "
                f"earlier calls: at t = {time:g} s its run needs more than {MOST_EVALUATIONS} "
                f"evaluations for {MAX_STEP:g} s; only sampled mode runs it"
            )
            raise InvalidValueError(f"controller {self.controller!r}", rule)
        return self.derivative(time, state, self.segment)


@register_jitable
def limit_margin(state):
    """Return how far the state is from the end of a run: `FALL_ANGLE` or `STATE_LIMIT`."""
    largest = max(max(abs(state[0]), abs(state[1])), max(abs(state[2]), abs(state[3])))
    return min(FALL_ANGLE - abs(state[1]), STATE_LIMIT - largest)


def _premature_end(solution: Any, segment: Segment) -> Outcome:
    """Return how a run ended in a segment that did not reach its end."""
    fell, diverged = solution.t_events
    if len(fell):
        return Outcome(FELL, float(fell[0]))
    if len(diverged):
        return Outcome(DIVERGED, float(diverged[0]))
    if not len(solution.t):
        return Outcome(DIVERGED, segment.start)
    return Outcome(_ending(solution.y[:, -1]), float(solution.t[-1]))


def _ending(state: NDArray[np.float64]) -> str:
    """Return how a run that cannot continue from `state` has ended."""
    return OUTCOMES[ending_of(state)]
