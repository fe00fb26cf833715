"""Integrators that know neither the equations nor MuJoCo: DOP853, and RK4 from time to time.

Both sides pass their own right-hand side, so that their results differ by that alone. DOP853 takes
a compiled one; SciPy integrates any other, and by any other method. RK4 takes either.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.integrate import DOP853, solve_ivp

from afl_mujoco.compiled import jitable
from afl_mujoco.errors import AflMujocoError, InvalidValueError, UnknownNameError
from afl_mujoco.plants.plant import Floats
from afl_mujoco.scenario.scenario import Scenario, Segment
from afl_mujoco.simulation.trajectory import (
    COMPLETED,
    FELL,
    OUTCOMES,
    STATE_LIMIT,
    Criterion,
    Outcome,
    criterion_of,
    deviation,
    ending_of,
    has_ended,
    within_limits,
)
from afl_mujoco.values import require_positive

STAGES, ROWS = 12, 16
"""Stages of a step; rows with the stage at its end and three more for the dense output."""


def work_space(states: int) -> Floats:
    """Return the work space of `solve`: compiled code that makes no arrays counts no references."""
    return np.empty((ROWS + 9, states))


# Copies: compiled code needs contiguous constants.
_NODES = np.concatenate([DOP853.C[:STAGES], [1.0], DOP853.C_EXTRA])
_COUPLING = np.zeros((ROWS, ROWS))
_COUPLING[:STAGES, :STAGES] = DOP853.A[:STAGES, :STAGES]
_COUPLING[STAGES, :STAGES] = DOP853.B
_COUPLING[STAGES + 1 :] = DOP853.A_EXTRA
_ERROR_5, _ERROR_3 = DOP853.E5.copy(), DOP853.E3.copy()
_DENSE = DOP853.D.copy()

_SAFETY, _LEAST_FACTOR, _LARGEST_FACTOR, _EXPONENT = 0.9, 0.2, 10.0, -1.0 / 8.0

REACHED, STOPPED, STUCK = range(3)
"""How the integration of a segment ends: at its end, at a zero of the margin, for want of a step
that is short enough."""


@jitable
def _copy(source, target):
    """Copy numbers; an assignment of arrays would count references."""
    for i in range(len(target)):
        target[i] = source[i]


@jitable
def _stage(rates, arguments, time, state, step, slopes, row, point):
    """Write the slopes of one stage, and into `point` the state at which they are taken."""
    for i in range(len(state)):
        sum_ = 0.0
        for j in range(row):
            sum_ += _COUPLING[row, j] * slopes[j, i]
        point[i] = state[i] + step * sum_
    rates(arguments, time + _NODES[row] * step, point, slopes[row])


@jitable
def try_step(rates, arguments, time, state, step, slopes, after):
    """Write the stages of a step, and into `after` the state after it."""
    for row in range(1, STAGES + 1):
        _stage(rates, arguments, time, state, step, slopes, row, after)


@jitable
def error_of(step, slopes, state, after, rtol, atol):
    """Return the error of a step, accepted below 1; NaN if a slope has no value."""
    fifth, third = 0.0, 0.0
    for i in range(len(state)):
        sum_5, sum_3 = 0.0, 0.0
        for j in range(STAGES + 1):
            sum_5 += _ERROR_5[j] * slopes[j, i]
            sum_3 += _ERROR_3[j] * slopes[j, i]
        scale = atol + rtol * max(abs(state[i]), abs(after[i]))
        fifth += (sum_5 / scale) ** 2
        third += (sum_3 / scale) ** 2
    if fifth == 0.0 and third == 0.0:
        return 0.0
    return abs(step) * fifth / math.sqrt((fifth + 0.01 * third) * len(state))


@jitable
def step_factor(error, rejected):
    """Return the factor from a step with this error to the next step."""
    if not error < 1.0:
        factor = _SAFETY * error**_EXPONENT
        return factor if factor > _LEAST_FACTOR else _LEAST_FACTOR  # for NaN too
    factor = _LARGEST_FACTOR
    if error > 0.0:
        factor = min(factor, _SAFETY * error**_EXPONENT)
    return min(factor, 1.0) if rejected else factor


@jitable
def first_step(rates, arguments, time, state, longest, slopes, point, rtol, atol):
    """Return the first step [s] that `solve_ivp` chooses; row 0 of `slopes` holds the slopes."""
    size, speed, bend = 0.0, 0.0, 0.0
    for i in range(len(state)):
        scale = atol + abs(state[i]) * rtol
        size += (state[i] / scale) ** 2
        speed += (slopes[0, i] / scale) ** 2
    size, speed = math.sqrt(size / len(state)), math.sqrt(speed / len(state))
    guess = min(1e-6 if size < 1e-5 or speed < 1e-5 else 0.01 * size / speed, longest)
    for i in range(len(state)):
        point[i] = state[i] + guess * slopes[0, i]
    rates(arguments, time + guess, point, slopes[1])
    for i in range(len(state)):
        scale = atol + abs(state[i]) * rtol
        bend += ((slopes[1, i] - slopes[0, i]) / scale) ** 2
    bend = math.sqrt(bend / len(state)) / guess
    if speed <= 1e-15 and bend <= 1e-15:
        second = max(1e-6, guess * 1e-3)
    else:
        second = (0.01 / max(speed, bend)) ** (1.0 / 8.0)
    return min(100.0 * guess, second, longest)


@jitable
def _fit(rates, arguments, time, state, after, step, slopes, fitted, point):
    """Write the polynomials of the dense output over a step, shape (7, states)."""
    for row in range(STAGES + 1, ROWS):
        _stage(rates, arguments, time, state, step, slopes, row, point)
    for i in range(len(state)):
        delta = after[i] - state[i]
        fitted[0, i] = delta
        fitted[1, i] = step * slopes[0, i] - delta
        fitted[2, i] = 2.0 * delta - step * (slopes[STAGES, i] + slopes[0, i])
        for k in range(4):
            sum_ = 0.0
            for j in range(ROWS):
                sum_ += _DENSE[k, j] * slopes[j, i]
            fitted[3 + k, i] = step * sum_


@jitable
def _evaluate(fitted, state, share, found):
    """Write the dense output at a share of its step."""
    for i in range(len(state)):
        value = 0.0
        for k in range(7):
            value += fitted[6 - k, i]
            value *= share if k % 2 == 0 else 1.0 - share
        found[i] = state[i] + value


@jitable
def _crossing(limits, fitted, state, point):
    """Return the share of a step at which the margin is zero; write the state into `point`."""
    low, high = 0.0, 1.0
    _evaluate(fitted, state, low, point)
    sign = limit_margin(limits, point) >= 0.0
    for _ in range(60):  # bisection: a bit of the share each
        middle = 0.5 * (low + high)
        _evaluate(fitted, state, middle, point)
        if (limit_margin(limits, point) >= 0.0) == sign:
            low = middle
        else:
            high = middle
    _evaluate(fitted, state, high, point)
    return high


@jitable
def _take_step(rates, arguments, time, end, state, step, options, slopes, after):
    """Take a step that is short enough; return its end, the start if none is, and a factor."""
    rtol, atol, longest = options
    least = 10.0 * abs(np.nextafter(time, np.inf) - time)  # as SciPy's: shorter is round-off
    step, rejected = max(min(step, longest), least), False  # a segment may be shorter
    while step >= least:
        reached = min(time + step, end)
        step = reached - time
        try_step(rates, arguments, time, state, step, slopes, after)
        error = error_of(step, slopes, state, after, rtol, atol)
        factor = step_factor(error, rejected)
        if error < 1.0:
            return reached, factor
        step, rejected = step * factor, True
    return time, 1.0


@jitable
def _report(fitted, time, state, reached, after, last, times, count, found):
    """Write the states at the times of a step up to `last`; return how many are written so far."""
    while count < len(times) and times[count] <= last:
        if times[count] == reached:
            _copy(after, found[count])
        else:
            _evaluate(fitted, state, (times[count] - time) / (reached - time), found[count])
        count += 1
    return count


@jitable
def solve(rates, arguments, limits, start, end, state, times, options, work, found):
    """Integrate over a segment, overwriting `state`, with states at `times` into `found`.

    Options are ``(rtol, atol, longest step [s])``. Return how many of the times were reached, the
    time of the end [s], and `REACHED`, `STOPPED` or `STUCK`.
    """
    rtol, atol, longest = options
    slopes, fitted, after, point = work[:ROWS], work[ROWS : ROWS + 7], work[ROWS + 7], work[-1]
    count, time, total = 0, start, len(times)
    rates(arguments, time, state, slopes[0])
    while count < total and times[count] <= start:
        _copy(state, found[count])
        count += 1
    for i in range(len(state)):
        if not abs(slopes[0, i]) < np.inf:
            return count, time, STUCK
    longest = min(longest, end - start)
    step = first_step(rates, arguments, time, state, longest, slopes, point, rtol, atol)
    while time < end:
        reached, factor = _take_step(
            rates, arguments, time, end, state, step, (rtol, atol, longest), slopes, after
        )
        if reached == time:
            return count, time, STUCK
        step = reached - time
        last = reached
        crossed = (limit_margin(limits, state) >= 0.0) != (limit_margin(limits, after) >= 0.0)
        # three more stages, only where a state between the ends of the step is asked for
        if crossed or (count < total and times[count] < reached):
            _fit(rates, arguments, time, state, after, step, slopes, fitted, point)
        if crossed:
            last = time + _crossing(limits, fitted, state, point) * step
        count = _report(fitted, time, state, reached, after, last, times, count, found)
        if crossed:
            _copy(point, state)
            return count, last, STOPPED
        _copy(after, state)
        _copy(slopes[STAGES], slopes[0])  # first same as last
        time, step = reached, step * factor
    return count, time, REACHED


@jitable
def rk4_step(rates, arguments, time, step, state, work, after):
    """Write the state after a textbook RK4 step; `work` has five rows or more."""
    point = work[4]
    rates(arguments, time, state, work[0])
    for row in range(1, 4):
        share = (0.5 if row < 3 else 1.0) * step
        for i in range(len(state)):
            point[i] = state[i] + share * work[row - 1, i]
        rates(arguments, time + share, point, work[row])
    sixth = step / 6.0
    for i in range(len(state)):
        slopes = work[0, i] + 2.0 * work[1, i] + 2.0 * work[2, i] + work[3, i]
        after[i] = state[i] + sixth * slopes


@jitable
def solve_rk4(rates, arguments, limits, start, end, state, times, options, work, found):
    """Integrate over a segment as `solve` does, by a step of RK4 from each time to the next."""
    after, time = work[5], start
    for count in range(len(times)):
        if times[count] > time:
            rk4_step(rates, arguments, time, times[count] - time, state, work, after)
            if not within_limits(after):
                return count, time, STUCK
            _copy(after, state)
            time = times[count]
        _copy(state, found[count])
        if limit_margin(limits, state) <= 0.0:
            return count + 1, time, STOPPED
    return len(times), time, REACHED


Derivative = Callable[[float, Floats, Segment], Sequence[float]]
"""(time, state, segment) -> its rate of change; NaN where the controller has no value."""

Transition = Callable[[Floats, Segment | None, Segment], Floats]
"""(state, segment before or None at the start, segment after) -> the state after the breakpoint."""

Solver = Callable[[Segment, Floats, Floats], tuple[Floats, Outcome | None]]
"""(segment, state at its start, times in it up to its end) -> states at the times reached, and how
the run ended if it did before the segment's end."""

RTOL = 1e-12
ATOL = 1e-14
SHORTER = 5e-3
"""Longest step of the loops of any plant [s]: the dense output of longer ones is off by up to 1e-9
where a loop has a pole near -300/s."""

MAX_STEP = 0.02
"""Longest step [s]: bounds the error of the dense output, which the error control does not see."""

MIN_RTOL = 100 * np.finfo(float).eps
"""Least relative tolerance: below it, the integrator would silently use this value."""

NO_NODES: Mapping[str, Floats] = {}

METHODS = ("DOP853", "Radau", "RK45", "LSODA")


def integrate(
    scenario: Scenario,
    solver: Solver,
    transition: Transition,
    times: Floats,
    *,
    nodes: Mapping[str, Floats] = NO_NODES,
    quadratures: int = 0,
) -> tuple[Floats, Outcome]:
    """Return states at `times` [s] that a run reached, and its end, from breakpoint to breakpoint.

    Error control does not see all of the error of a step across a kink: none steps across one, or
    across `nodes`, values of parameters at which the right-hand side is not smooth.
    """
    state = np.array([*scenario.initial_state, *[0.0] * quadratures])
    criterion, starts = criterion_of(scenario), {one.start for one in scenario.segments}
    reached: list[Floats] = []
    before: Segment | None = None
    cuts = (one.cut_at(one.passes(scenario.schedule, nodes)) for one in scenario.segments)
    for segment in itertools.chain.from_iterable(cuts):  # smooth parts of segments
        if segment.start in starts:
            state = transition(state, before, segment)
        before = segment
        last = segment.end == scenario.duration
        inside = times[(times >= segment.start) & ((times < segment.end) | last)]
        if has_ended(criterion, state):
            reached.append(np.atleast_2d(state)[: len(inside)])
            return np.concatenate(reached), Outcome(FELL, segment.start)
        wanted = np.union1d(inside, [segment.end])
        samples, outcome = solver(segment, state, wanted)
        reached.append(samples[np.isin(wanted[: len(samples)], inside)])
        if outcome is not None:
            return np.concatenate(reached), outcome
        state = samples[-1]
    return np.concatenate(reached), Outcome(COMPLETED, scenario.duration)


def require_tolerances(method: str, rtol: float, atol: float) -> None:
    """Raise if there is no such method, or a tolerance is out of bounds."""
    if method not in METHODS:
        raise UnknownNameError.among("method", method, METHODS)
    if not rtol >= MIN_RTOL:
        raise InvalidValueError("rtol", f"must be at least {MIN_RTOL:.1e}", rtol)
    require_positive("atol", atol)


def longest_step_of(scenario: Scenario) -> float:
    """Return the longest step of the loop of a scenario [s]."""
    return MAX_STEP if scenario.is_cart_pole else SHORTER


def scipy_solver(
    derivative: Derivative,
    criterion: Criterion,
    method: str = "DOP853",
    rtol: float = RTOL,
    atol: float = ATOL,
    longest: float = MAX_STEP,
) -> Solver:
    """Return SciPy's integrator of a right-hand side in Python, with steps up to a longest [s]."""
    settings: Any = {"method": method, "rtol": rtol, "atol": atol, "max_step": longest}

    def margin(time: float, state: Floats) -> float:
        return float(limit_margin(criterion, state))

    margin.terminal = True  # type: ignore[attr-defined]

    def solve(segment: Segment, state: Floats, times: Floats) -> tuple[Floats, Outcome | None]:
        def right_hand_side(time: float, state: Floats) -> Sequence[float]:
            return derivative(time, state, segment)

        span = (segment.start, segment.end)
        if not np.isfinite(right_hand_side(segment.start, state)).all():
            return np.atleast_2d(state), _stuck(criterion, state, segment.start)
        try:
            found: Any = solve_ivp(
                right_hand_side, span, state, t_eval=times, events=margin, **settings
            )
        except AflMujocoError:
            raise
        except ValueError:  # an implicit method cannot go on with NaN
            rule = "must be DOP853, RK45 or LSODA where the rates diverge or have no number"
            raise InvalidValueError("method", rule, method) from None
        samples = np.reshape(found.y, (len(state), -1)).T
        if (broken := ~np.isfinite(samples).all(axis=1)).any():  # LSODA goes on with NaN
            kept = int(broken.argmax())
            last, when = (samples[kept - 1], times[kept - 1]) if kept else (state, segment.start)
            return samples[:kept], _stuck(criterion, last, when)
        if found.status == 0:
            return samples, None
        ends = [(samples[-1:], found.t[-1:]), (found.y_events[0], found.t_events[0])]
        known = [(state, segment.start), *(pair for one in ends for pair in zip(*one, strict=True))]
        return samples, _stuck(criterion, *known[-1])

    return solve


def _stuck(criterion: Criterion, state: Floats, time: float) -> Outcome:
    """Return how a run has ended that cannot continue from a state, or must not."""
    return Outcome(OUTCOMES[ending_of(criterion, state)], float(time))


def compiled_solver(
    solve: Callable[..., tuple[int, float, int]],
    criterion: Criterion,
    rtol: float = RTOL,
    atol: float = ATOL,
    longest: float = MAX_STEP,
) -> Solver:
    """Return the compiled integrator, its steps up to a longest [s], for `integrate`."""
    options = (rtol, atol, longest)
    work = work_space(2 * len(criterion.target))

    def integrate_segment(
        segment: Segment, state: Floats, times: Floats
    ) -> tuple[Floats, Outcome | None]:
        state, found = state.copy(), np.empty((len(times), len(state)))
        count, time, status = solve(segment, state, times, options, work, found)
        ended = None if status == REACHED else _stuck(criterion, state, time)
        return found[:count], ended

    return integrate_segment


def along_z(channels: Sequence[float]) -> float:
    """Return what acts along z of a cart-pole, on its input or on the coordinate, or raise."""
    on_input, on_z, on_phi = channels
    if on_phi:
        rule = "must act along z: the paper's equations have no torque on the pole"
        raise InvalidValueError("disturbance", rule, "phi")
    return on_input + on_z


@jitable
def limit_margin(limits, state):
    """Return how far the state is from the end of a run: one of `limits`, or `STATE_LIMIT`."""
    margin, n = STATE_LIMIT, len(limits.ends)
    for i in range(2 * n):
        margin = min(margin, STATE_LIMIT - abs(state[i]))
    for i in range(n):
        away = abs(deviation(state[i], limits.target[i], limits.wraps[i]))
        margin = min(margin, limits.ends[i] - away)
    return margin
