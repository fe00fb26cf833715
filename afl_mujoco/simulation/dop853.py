"""The method of Dormand and Prince of order 8(5,3), compiled: the coefficients are SciPy's.

`scipy.integrate.solve_ivp` calls Python for every stage, which costs a hundred times what the
stages of a cart-pole do. This module has the same algorithm, including the step-size control, as
compiled functions that take the right-hand side as an argument; tests compare the two.

A right-hand side is ``rates(arguments, time, state, slopes)``, which writes the four slopes, NaN
where there are none. It is a `register_jitable` function and not a compiled one: code that takes a
compiled function as an argument cannot be cached on disk.
"""

from __future__ import annotations

import math

import numpy as np
from numba.extending import register_jitable
from scipy.integrate import DOP853

STAGES, ROWS = 12, 16
"""Stages of a step; rows with the stage at its end and three more for the dense output."""

WORK = (ROWS + 9, 4)
"""Shape of the work space of `solve`: compiled code that makes no arrays counts no references."""

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


@register_jitable
def _copy(source, target):
    """Copy four numbers; an assignment of arrays would count references."""
    for i in range(4):
        target[i] = source[i]


@register_jitable
def _stage(rates, arguments, time, state, step, slopes, row, point):
    """Write the slopes of one stage, and into `point` the state at which they are taken."""
    for i in range(4):
        sum_ = 0.0
        for j in range(row):
            sum_ += _COUPLING[row, j] * slopes[j, i]
        point[i] = state[i] + step * sum_
    rates(arguments, time + _NODES[row] * step, point, slopes[row])


@register_jitable
def try_step(rates, arguments, time, state, step, slopes, after):
    """Write the stages of a step and the state after it.

    time, state, step: Start of the step [s], state there, and length of the step [s].
    after: Takes the state, shape (4,).
    """
    for row in range(1, STAGES + 1):
        _stage(rates, arguments, time, state, step, slopes, row, after)


@register_jitable
def error_of(step, slopes, state, after, rtol, atol):
    """Return the error of a step, accepted below 1; NaN if a slope has no value."""
    fifth, third = 0.0, 0.0
    for i in range(4):
        sum_5, sum_3 = 0.0, 0.0
        for j in range(STAGES + 1):
            sum_5 += _ERROR_5[j] * slopes[j, i]
            sum_3 += _ERROR_3[j] * slopes[j, i]
        scale = atol + rtol * max(abs(state[i]), abs(after[i]))
        fifth += (sum_5 / scale) ** 2
        third += (sum_3 / scale) ** 2
    if fifth == 0.0 and third == 0.0:
        return 0.0
    return abs(step) * fifth / math.sqrt((fifth + 0.01 * third) * 4.0)


@register_jitable
def step_factor(error, rejected):
    """Return the factor from a step with this error to the next step."""
    if not error < 1.0:
        factor = _SAFETY * error**_EXPONENT
        return factor if factor > _LEAST_FACTOR else _LEAST_FACTOR  # for NaN too
    factor = _LARGEST_FACTOR
    if error > 0.0:
        factor = min(factor, _SAFETY * error**_EXPONENT)
    return min(factor, 1.0) if rejected else factor


@register_jitable
def first_step(rates, arguments, time, state, longest, slopes, point, rtol, atol):
    """Return the first step [s] that `solve_ivp` chooses; row 0 of `slopes` holds the slopes."""
    size, speed, bend = 0.0, 0.0, 0.0
    for i in range(4):
        scale = atol + abs(state[i]) * rtol
        size += (state[i] / scale) ** 2
        speed += (slopes[0, i] / scale) ** 2
    size, speed = math.sqrt(size / 4.0), math.sqrt(speed / 4.0)
    guess = min(1e-6 if size < 1e-5 or speed < 1e-5 else 0.01 * size / speed, longest)
    for i in range(4):
        point[i] = state[i] + guess * slopes[0, i]
    rates(arguments, time + guess, point, slopes[1])
    for i in range(4):
        scale = atol + abs(state[i]) * rtol
        bend += ((slopes[1, i] - slopes[0, i]) / scale) ** 2
    bend = math.sqrt(bend / 4.0) / guess
    if speed <= 1e-15 and bend <= 1e-15:
        second = max(1e-6, guess * 1e-3)
    else:
        second = (0.01 / max(speed, bend)) ** (1.0 / 8.0)
    return min(100.0 * guess, second, longest)


@register_jitable
def _fit(rates, arguments, time, state, after, step, slopes, fitted, point):
    """Write the polynomials of the dense output over a step, shape (7, 4)."""
    for row in range(STAGES + 1, ROWS):
        _stage(rates, arguments, time, state, step, slopes, row, point)
    for i in range(4):
        delta = after[i] - state[i]
        fitted[0, i] = delta
        fitted[1, i] = step * slopes[0, i] - delta
        fitted[2, i] = 2.0 * delta - step * (slopes[STAGES, i] + slopes[0, i])
        for k in range(4):
            sum_ = 0.0
            for j in range(ROWS):
                sum_ += _DENSE[k, j] * slopes[j, i]
            fitted[3 + k, i] = step * sum_


@register_jitable
def _evaluate(fitted, state, share, found):
    """Write the dense output at a share of its step."""
    for i in range(4):
        value = 0.0
        for k in range(7):
            value += fitted[6 - k, i]
            value *= share if k % 2 == 0 else 1.0 - share
        found[i] = state[i] + value


@register_jitable
def _crossing(margin, fitted, state, point):
    """Return the share of a step at which the margin is zero; write the state into `point`."""
    low, high = 0.0, 1.0
    _evaluate(fitted, state, low, point)
    sign = margin(point) >= 0.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        _evaluate(fitted, state, middle, point)
        if (margin(point) >= 0.0) == sign:
            low = middle
        else:
            high = middle
    _evaluate(fitted, state, high, point)
    return high


@register_jitable
def _take_step(rates, arguments, time, end, state, step, options, slopes, after):
    """Take a step that is short enough; return its end [s] and the factor for the next step.

    If no step is short enough, the end returned is the start.
    """
    rtol, atol, longest = options
    least = 10.0 * abs(np.nextafter(time, np.inf) - time)
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


@register_jitable
def _report(fitted, time, state, reached, after, last, times, count, found):
    """Write the states at the times of a step up to `last`; return how many are written so far."""
    while count < len(times) and times[count] <= last:
        if times[count] == reached:
            _copy(after, found[count])
        else:
            _evaluate(fitted, state, (times[count] - time) / (reached - time), found[count])
        count += 1
    return count


@register_jitable
def solve(rates, arguments, margin, start, end, state, times, options, work, found):
    """Integrate over a segment; return the number of times reached, and when and how it ended.

    start, end: The segment [s].
    state: State at the start, shape (4,); overwritten by the state at the end.
    times: Times at which to report the state [s], increasing, within the segment, shape (N,).
    options: ``(rtol, atol, longest step [s])``.
    found: Takes the states at the times, shape (N, 4).
    Returns tuple: How many of the times were reached, the time of the end [s], and `REACHED`,
        `STOPPED` or `STUCK`.
    """
    rtol, atol, longest = options
    slopes, fitted, after, point = work[:ROWS], work[ROWS : ROWS + 7], work[ROWS + 7], work[-1]
    count, time, total = 0, start, len(times)
    rates(arguments, time, state, slopes[0])
    while count < total and times[count] <= start:
        _copy(state, found[count])
        count += 1
    for i in range(4):
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
        last, crossed = reached, (margin(state) >= 0.0) != (margin(after) >= 0.0)
        if crossed or (count < total and times[count] < reached):
            _fit(rates, arguments, time, state, after, step, slopes, fitted, point)
        if crossed:
            last = time + _crossing(margin, fitted, state, point) * step
        count = _report(fitted, time, state, reached, after, last, times, count, found)
        if crossed:
            _copy(point, state)
            return count, last, STOPPED
        _copy(after, state)
        _copy(slopes[STAGES], slopes[0])
        time, step = reached, step * factor
    return count, time, REACHED
