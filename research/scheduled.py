"""Many closed loops on schedules of M and l, gains by (G1): the terms of (O1), ideal ODE.

The loops run one after the other: schedules have their kinks at different times, so that lanes
side by side, as on constant plants, would wait for each other.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from afl_mujoco.compiled import jitable, kernel
from afl_mujoco.control.gains import scheduled_gain
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.parameters import NOMINAL
from afl_mujoco.simulation.trajectory import STATE_LIMIT
from afl_mujoco.values import require_positive
from research.batch import (
    FALL_TANGENT,
    SMALLEST_STEP,
    absolute_area,
    reduced_force,
    reduced_slopes,
)

TOLERANCE = 1e-5
"""Local error of a step, for every state relative to 1 plus its size."""

AT_REST = 1e-8
"""Largest state of a loop that is not followed any further."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScheduledTerms:
    """The terms of (O1) of many closed loops on schedules, each of shape (N,)."""

    iae_z: NDArray[np.float64]  # integrals of abs(z) [m s] and abs(phi) [rad s]
    iae_phi: NDArray[np.float64]
    peak_force: NDArray[np.float64]  # largest abs(F), and largest F with its sign [N]
    max_force: NDArray[np.float64]
    lost: NDArray[np.bool_]  # whether the loop fell or diverged


def scheduled_terms(
    cart_mass: ArrayLike,
    half_length: ArrayLike,
    coefficients: ArrayLike,
    durations: ArrayLike,
    *,
    held: bool = False,
    start_angle: float = -math.pi / 3.0,
    pole_mass: float = NOMINAL.pole_mass,
    gravity: float = NOMINAL.gravity,
    tolerance: float = TOLERANCE,
    threads: int = 1,
) -> ScheduledTerms:
    """Return the terms of (O1) for many schedules and gain functions, from rest.

    cart_mass, half_length: Knots (time, value) of M [kg] and l [m], linear between, shape (N,
        knots, 2); two knots at one time are a jump.
    coefficients: Coefficients of (G1) for K, lambda and Phi, shape (N, 3, 5) or (3, 5).
    durations: The horizons [s], shape (N,).
    start_angle, pole_mass, gravity: phi(0) [rad], m [kg] and g [m/s^2].
    """
    masses, lengths = (np.ascontiguousarray(x, dtype=np.float64) for x in (cart_mass, half_length))
    if masses.ndim != 3 or lengths.ndim != 3 or len(masses) != len(lengths):
        rule = "must be knots (time, value) of equally many loops"
        raise InvalidValueError("schedules", rule, (masses.shape, lengths.shape))
    count = len(masses)
    gains = np.ascontiguousarray(np.broadcast_to(coefficients, (count, 3, 5)), dtype=np.float64)
    ends = np.ascontiguousarray(np.broadcast_to(durations, count), dtype=np.float64)
    constants = (
        start_angle,
        require_positive("pole_mass", pole_mass),
        require_positive("gravity", gravity),
        0.1 / require_positive("tolerance", tolerance),
        held,
    )
    found = np.empty((count, 5))

    def integrate(part: slice) -> None:
        _integrate(masses[part], lengths[part], gains[part], ends[part], *constants, found[part])

    if threads == 1:
        integrate(slice(None))
    else:
        bounds = np.linspace(0, count, 8 * threads + 1).astype(int)
        parts = [slice(a, b) for a, b in pairwise(bounds.tolist()) if a < b]
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(integrate, parts))
    return ScheduledTerms(
        iae_z=found[:, 0],
        iae_phi=found[:, 1],
        peak_force=found[:, 2],
        max_force=found[:, 3],
        lost=found[:, 4] > 0.0,
    )


@kernel
def _integrate(masses, lengths, gains, ends, start_angle, pole_mass, gravity, weight, held, found):
    """Integrate the loops one after the other."""
    for i in range(len(found)):
        _integrate_one(
            masses[i], lengths[i], gains[i], ends[i], start_angle, pole_mass, gravity, weight,
            held, found[i],
        )  # fmt: skip


@jitable
def _line(knots, time):
    """Return value and slope just after `time`, and the time of the next knot."""
    last = -1
    for k in range(len(knots)):
        if knots[k, 0] <= time:
            last = k
    if last < 0:
        return knots[0, 1], 0.0, knots[0, 0]
    if last == len(knots) - 1:
        return knots[last, 1], 0.0, np.inf
    rate = (knots[last + 1, 1] - knots[last, 1]) / (knots[last + 1, 0] - knots[last, 0])
    return knots[last, 1] + rate * (time - knots[last, 0]), rate, knots[last + 1, 0]


@jitable
def _gains(mass, length, w):
    """Return (K, lambda, Phi) by (G1)."""
    return (
        scheduled_gain(mass, length, w[0]),
        scheduled_gain(mass, length, w[1]),
        scheduled_gain(mass, length, w[2]),
    )


@jitable
def _slopes(x, length, gains, gravity):
    """Return `reduced_slopes` of (z, z', sigma, tau, phi')."""
    lever = 4.0 / 3.0 * length
    return reduced_slopes(
        x[0], x[1], x[2], x[3], x[4],
        lever, 1.0 / lever, gravity, gains[0], gains[1], 1.0 / gains[2],
    )  # fmt: skip


@jitable
def _moved(x, h, k):
    """Return the state x + h k; `k` are `reduced_slopes` at a state of rates (z', phi')."""
    return (
        x[0] + h * k[0],
        x[1] + h * k[1],
        x[2] + h * k[2],
        x[3] + h * k[3],
        x[4] + h * k[4],
        x[5] + h * k[5],
    )


@jitable
def _rates(x, found):
    """Return the derivative of (z, z', sigma, tau, phi', phi)."""
    return x[1], found[0], found[2], found[3], found[1], x[4]


@jitable
def _force(found, x, mass, length, pole_mass, gravity):
    """Return the force by (L1), from the slopes found at a state."""
    lever = 4.0 / 3.0 * length
    return reduced_force(found[0], x[3], x[4], found[8], mass, pole_mass, lever, gravity)


@jitable
def _try_step(x, at, h, elapsed, line, gains, w, follows, gravity):
    """Return state, slopes and gains after a step of RK4, and the largest error of a slope.

    The estimate is that of `batch.advance`. `line` holds M, M', l, l' at the last knot, `elapsed`
    the time since.
    """
    middle, after = elapsed + 0.5 * h, elapsed + h
    length2, length4 = line[2] + line[3] * middle, line[2] + line[3] * after
    gains2, gains4 = gains, gains
    if follows:
        gains2 = _gains(line[0] + line[1] * middle, length2, w)
        gains4 = _gains(line[0] + line[1] * after, length4, w)
    k1 = _rates(x, at)
    x2 = _moved(x, 0.5 * h, k1)
    k2 = _rates(x2, _slopes(x2, length2, gains2, gravity))
    x3 = _moved(x, 0.5 * h, k2)
    k3 = _rates(x3, _slopes(x3, length2, gains2, gravity))
    x4 = _moved(x, h, k3)
    k4 = _rates(x4, _slopes(x4, length4, gains4, gravity))
    outer, inner = h / 6.0, h / 3.0
    new = _moved(_moved(_moved(_moved(x, outer, k1), inner, k2), inner, k3), outer, k4)
    at_new = _slopes(new, length4, gains4, gravity)
    k5 = _rates(new, at_new)
    error = 0.0
    for j in range(5):
        error = max(error, abs(k4[j] - k5[j]) / (1.0 + abs(new[j])))
    return new, at_new, gains4, error


@jitable
def _integrate_one(masses, lengths, w, end, start_angle, pole_mass, gravity, weight, held, found):
    """Integrate one loop with its own step; no step passes a knot."""
    tau = math.tan(start_angle)
    x = (0.0, 0.0, math.asinh(tau), tau, 0.0, start_angle)
    highest, time = -np.inf, 0.0
    gains = _gains(_line(masses, 0.0)[0], _line(lengths, 0.0)[0], w)
    found[:] = 0.0
    found[4] = 1.0 if _is_lost(x) else 0.0
    while time < end and found[4] == 0.0:
        mass, mass_rate, mass_next = _line(masses, time)
        length, length_rate, length_next = _line(lengths, time)
        line, begin, until = (
            (mass, mass_rate, length, length_rate),
            time,
            min(end, mass_next, length_next),
        )
        follows = not held and (mass_rate != 0.0 or length_rate != 0.0)
        if not held:
            gains = _gains(mass, length, w)
        if min(gains) <= 0.0:
            found[4] = 1.0
            break
        at = _slopes(x, length, gains, gravity)
        force = _force(at, x, mass, length, pole_mass, gravity)
        found[2], highest = max(found[2], abs(force)), max(highest, force)
        step = 0.02 * length
        while time < until:
            h = min(step, until - time)
            new, at_new, after, error = _try_step(
                x, at, h, time - begin, line, gains, w, follows, gravity
            )
            error *= weight * h
            factor = min(4.0, 0.9 / math.sqrt(math.sqrt(error + 1e-6)))
            step = (factor if factor > 0.2 else 0.2) * h  # 0.2 too if the error is NaN
            if not error <= 1.0:
                if step < SMALLEST_STEP:
                    found[4] = 1.0
                    break
                continue
            found[0] += absolute_area(x[0], new[0], x[1], new[1], h)
            found[1] += absolute_area(x[5], new[5], x[4], new[4], h)
            x, at, gains = new, at_new, after
            time = until if h == until - time else time + h
            here, there = mass + mass_rate * (time - begin), length + length_rate * (time - begin)
            force = _force(at, x, here, there, pole_mass, gravity)
            found[2], highest = max(found[2], abs(force)), max(highest, force)
            if _is_lost(x):
                found[4] = 1.0
                break
            if max(abs(x[0]), abs(x[1]), abs(x[5]), abs(x[4])) < AT_REST:
                time = until = end
    found[3] = highest


@jitable
def _is_lost(x):
    """Return whether the pole fell, or the state diverged."""
    size = max(abs(x[0]), abs(x[1]), abs(x[4]))
    return not size < STATE_LIMIT or abs(x[3]) >= FALL_TANGENT
