"""Thousands of closed loops at once: the terms of the objective (O1) on constant plants, ideal ODE.

By (L1) the closed loop has ``z'' = u`` and ``phi'' = 3/(4l) (g sin + u cos)``, so that M enters
only the force. With ``tau = tan(phi)`` and ``sigma = ln((1 + sin)/cos)`` integrated along with z,
one square root and one division remain, and no transcendental function. The equations as the paper
writes them are in `control.feedback_linearization`, and tests compare the two.

Each lane of a compiled block integrates one loop with its own step-size control, so that its
result does not depend on its neighbours; a lane that has ended takes the next loop. A step is
RK4 with an embedded estimate of order 3, and ends where the state enters or leaves the boundary
layer. Once the pole is nearly upright on the sliding surface, the rest is known in closed form.
One flat array and constant row numbers show the compiler that rows do not overlap, so that it
vectorises over the lanes; every function in the loop is inlined for that.

The largest force is taken at the steps and at the edge of the layer. Where a loop crosses that edge
after the start, a smooth peak between two steps may be missed: of 400 random sets of gains 11 had a
max|F| that was too small, by 0.46 % at most. The optima of the gain table are not among them: their
max|F| is that of the start, and MuJoCo confirms each.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from afl_mujoco.compiled import inlined_jitable, kernel
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.plants.cartpole import FALL_ANGLE
from afl_mujoco.scenario.parameters import NOMINAL
from afl_mujoco.simulation.trajectory import STATE_LIMIT
from afl_mujoco.studies.verify.claims import ObjectiveScales, objective
from afl_mujoco.values import require_positive

LANES = 16
"""Loops that a block integrates at a time: some vectors of the processor, all in its L1 cache."""

NEARLY_UPRIGHT, ON_SURFACE = 1e-2, 1e-5
"""Where the closed form takes over: largest abs(phi) still to come, and what s can add to it [rad].
The closed form neglects terms that are cubic in the angle."""

LAYER_EDGE = 1e-6
"""Accuracy with which a step ends on the edge of the boundary layer, as a share of its width."""

SMALLEST_STEP = 1e-12
"""A loop that needs a smaller step than this has diverged [s]."""

FALL_TANGENT = math.tan(FALL_ANGLE)

RUNNING, SETTLED, TIMED_OUT, LOST, IDLE = range(5)

# Rows of a block: the state, its slopes, the step, the sums, and what is constant in a lane.
(
    Z, Z_DOT, SIGMA, TAU, PHI_DOT, PHI,
    U, PHI_DDOT, SIGMA_DOT, TAU_DOT, RATIO,
    STEP, TIME, IAE_Z, IAE_PHI, MAX_FORCE, STATUS,
    LEVER, LEVER_INVERSE, SWITCHING, SLOPE, LAYER_INVERSE, CART_MASS, ROWS,
) = range(24)  # fmt: skip

TOLERANCE = 2e-6
"""Local error of a step, for every state relative to 1 plus its size. The objective is then
accurate to 5e-6 over the whole box of gains and plants."""


STIFFEST = 1e7
"""Largest product of the rate of the boundary layer and the horizon."""


@inlined_jitable
def reduced_slopes(
    z, z_dot, sigma, tau, phi_dot, lever, lever_inverse, gravity, switching, slope, layer_inverse
):
    """Return u, phi'', sigma', tau', s, xi1, xi2, xi3 and cos(phi) of the closed loop, (L1)-(L10).

    lever, lever_inverse: 4 l / 3 [m], and its inverse.
    """
    g, rate2 = gravity, phi_dot * phi_dot
    sec2 = 1.0 + tau * tau
    sec = math.sqrt(sec2)
    beta_sec = 3.0 * rate2 * sec * (1.0 - 2.0 * sec2) - g * lever_inverse * (3.0 * sec2 - 2.0)
    shared = 1.0 / (sec2 * beta_sec)  # the one division: 1 / cos^-1 and 1 / beta from it
    cos, beta_inverse = sec * beta_sec * shared, sec2 * sec * shared
    xi1 = z - lever * sigma
    xi2 = z_dot - lever * phi_dot * sec
    xi3 = -tau * (g + lever * rate2 * sec)
    xi4 = -(lever * (2.0 * sec2 - 1.0) * sec * rate2 + (3.0 * sec2 - 2.0) * g) * phi_dot
    quadratic = lever * tau * sec * (6.0 * sec2 - 1.0) * rate2 + 3.0 * g * tau * (4.0 * sec2 - 1.0)
    alpha = g * g * lever_inverse * tau * cos * (2.0 - 3.0 * sec2) - quadratic * rate2
    surface = xi4 + slope * (3.0 * xi3 + slope * (3.0 * xi2 + slope * xi1))
    drift = alpha + slope * (3.0 * xi4 + slope * (3.0 * xi3 + slope * xi2))
    saturated = min(1.0, max(-1.0, surface * layer_inverse))
    u = switching * saturated - drift * beta_inverse
    phi_ddot = (g * tau + u) * cos * lever_inverse
    return u, phi_ddot, phi_dot * sec, phi_dot * sec2, surface, xi1, xi2, xi3, cos


@inlined_jitable
def reduced_force(u, tau, phi_dot, cos, cart_mass, pole_mass, lever, gravity):
    """Return the force [N] of Eq. (L1)."""
    inertia = cart_mass + pole_mass - 0.75 * pole_mass * cos * cos
    return inertia * u + 0.75 * pole_mass * tau * cos * (lever * phi_dot * phi_dot - gravity * cos)


@inlined_jitable
def tail_bound(xi1, xi2, xi3, slope):
    """Return a bound on the future ``g abs(phi)`` on the surface s = 0, nearly upright."""
    first = xi2 + slope * xi1
    second = xi3 + slope * (first + xi2)
    linear, square = abs(slope * first - 2.0 * second), abs(second)
    return abs(xi3) + 0.368 * linear + 0.271 * square  # t e^-t < 0.368, t^2 e^-t / 2 < 0.271


@inlined_jitable
def tail_integrals(xi1, xi2, xi3, slope, lever, gravity, duration):
    """Return the integrals of abs(z) and abs(phi) over the rest of a run that is nearly upright.

    There ``s = (d/dt + lambda)^3 xi1 = 0`` and ``xi3 = -g phi``: xi1 and phi are parabolas times
    ``exp(-lambda t)``, and so is ``z = xi1 + (4l/3) phi``.
    """
    first = xi2 + slope * xi1
    second = xi3 + slope * (first + xi2)
    phi0 = -xi3 / gravity
    phi1 = -slope * (slope * first - 2.0 * second) / gravity
    phi2 = -slope * slope * second / gravity
    iae_phi = _absolute_integral(phi0, phi1, phi2, slope, duration)
    iae_z = _absolute_integral(
        xi1 + lever * phi0, first + lever * phi1, second + lever * phi2, slope, duration
    )
    return iae_z, iae_phi


@inlined_jitable
def _absolute_integral(c0, c1, c2, slope, duration):
    """Return the integral of ``abs(c0 + c1 t + c2 t^2 / 2) exp(-slope t)`` over the duration."""
    first_root = second_root = -1.0
    discriminant = c1 * c1 - 2.0 * c2 * c0
    if discriminant > 0.0:
        q = -(c1 + math.copysign(math.sqrt(discriminant), c1))
        roots = (q / c2 if c2 != 0.0 else -1.0), (2.0 * c0 / q if q != 0.0 else -1.0)
        first_root, second_root = min(roots[0], roots[1]), max(roots[0], roots[1])
    total, start = 0.0, 0.0
    for end in (first_root, second_root, duration):
        end = min(end, duration)
        if end > start:
            total += abs(_primitive(c0, c1, c2, slope, end) - _primitive(c0, c1, c2, slope, start))
            start = end
    return total


@inlined_jitable
def _primitive(c0, c1, c2, slope, t):
    """Return a primitive of ``(c0 + c1 t + c2 t^2 / 2) exp(-slope t)``."""
    parabola, derivative = c0 + t * (c1 + 0.5 * c2 * t), c1 + c2 * t
    return -(parabola + (derivative + c2 / slope) / slope) / slope * math.exp(-slope * t)


@inlined_jitable
def absolute_area(f0, f1, d0, d1, h):
    """Return the integral of abs(cubic) over a step; values and derivatives at its ends given."""
    whole = h * (0.5 * (f0 + f1) + h * (d0 - d1) * (1.0 / 12.0))
    crosses = f0 * f1 < 0.0
    a1, a2, a3 = h * d0, 3.0 * (f1 - f0) - h * (2.0 * d0 + d1), 2.0 * (f0 - f1) + h * (d0 + d1)
    root = f0 / (f0 - f1 if crosses else 1.0)  # followed by one step of Newton's method
    value = f0 + root * (a1 + root * (a2 + root * a3))
    steepness = a1 + root * (2.0 * a2 + 3.0 * root * a3)
    root = min(1.0, max(0.0, root - value / (steepness if crosses else 1.0)))
    part = h * root * (f0 + root * (0.5 * a1 + root * (a2 * (1.0 / 3.0) + root * 0.25 * a3)))
    return abs(part) + abs(whole - part) if crosses else abs(whole)


@kernel
def advance(block, pole_mass, gravity, duration, weight):
    """Try a step in every lane; the compiler vectorises over the lanes."""
    for i in range(LANES):
        time, ratio = block[TIME * LANES + i], block[RATIO * LANES + i]
        h = min(block[STEP * LANES + i], duration - time)
        new, last = _rk4(block, i, h, gravity)
        z, v, _, tau, w, _ = new
        plant = _plant(block, i)
        lever, K, slope, layer = plant[0], plant[2], plant[3], plant[4]
        slopes = _slopes(new, gravity, plant)
        surface, xi1, xi2, xi3, cos = slopes[4:]
        error = weight * h * _estimate(new, last, slopes)
        # the edge of the boundary layer
        before, after = abs(ratio) - 1.0, abs(surface * layer) - 1.0
        crosses = before * after < 0.0 and min(abs(before), abs(after)) > LAYER_EDGE
        leaps = ratio * surface < 0.0 and min(before, after) > LAYER_EDGE  # over the whole layer
        taken = error <= 1.0 and not (crosses or leaps) and block[STATUS * LANES + i] == RUNNING
        factor = 0.9 / math.sqrt(math.sqrt(error + 1e-6))
        grows = factor > 0.2 and not leaps  # false if the error is NaN
        factor = min(factor, 4.0) if grows else 0.2
        to_edge = h * before / (before - after if crosses else 1.0)
        # where it ends
        on_surface = abs(surface) * lever < ON_SURFACE * gravity * gravity * K * layer
        small = on_surface and tail_bound(xi1, xi2, xi3, slope) < NEARLY_UPRIGHT * gravity
        status = SETTLED if small else RUNNING
        status = TIMED_OUT if time + h >= duration else status
        gone = max(max(abs(z), abs(v)), abs(w)) >= STATE_LIMIT or abs(tau) >= FALL_TANGENT
        status = LOST if gone else status
        mass = block[CART_MASS * LANES + i]
        force = reduced_force(slopes[0], tau, w, cos, mass, pole_mass, lever, gravity)
        step = to_edge if crosses and error <= 1.0 else factor * h
        block[STEP * LANES + i] = step
        block[TIME * LANES + i] = time + h if taken else time
        kept = block[STATUS * LANES + i]
        stuck = step < SMALLEST_STEP and kept == RUNNING
        block[STATUS * LANES + i] = status if taken else LOST if stuck else kept
        block[RATIO * LANES + i] = surface * layer if taken else ratio
        peak = block[MAX_FORCE * LANES + i]
        block[MAX_FORCE * LANES + i] = max(peak, abs(force)) if taken else peak
        _commit(block, i, h, taken, new, slopes)


@inlined_jitable
def _commit(block, i, h, taken, new, slopes):
    """Move a lane to its new state and slopes, if the step is taken."""
    z, v = block[Z * LANES + i], block[Z_DOT * LANES + i]
    phi, w = block[PHI * LANES + i], block[PHI_DOT * LANES + i]
    sigma, tau = block[SIGMA * LANES + i], block[TAU * LANES + i]
    area_z, area_phi = (
        absolute_area(z, new[0], v, new[1], h),
        absolute_area(phi, new[5], w, new[4], h),
    )
    block[IAE_Z * LANES + i] += area_z if taken else 0.0  # a rejected step may be NaN
    block[IAE_PHI * LANES + i] += area_phi if taken else 0.0
    block[Z * LANES + i] = new[0] if taken else z
    block[Z_DOT * LANES + i] = new[1] if taken else v
    block[SIGMA * LANES + i] = new[2] if taken else sigma
    block[TAU * LANES + i] = new[3] if taken else tau
    block[PHI_DOT * LANES + i] = new[4] if taken else w
    block[PHI * LANES + i] = new[5] if taken else phi
    u, a = block[U * LANES + i], block[PHI_DDOT * LANES + i]
    s, t = block[SIGMA_DOT * LANES + i], block[TAU_DOT * LANES + i]
    block[U * LANES + i] = slopes[0] if taken else u
    block[PHI_DDOT * LANES + i] = slopes[1] if taken else a
    block[SIGMA_DOT * LANES + i] = slopes[2] if taken else s
    block[TAU_DOT * LANES + i] = slopes[3] if taken else t


@inlined_jitable
def _plant(block, i):
    """Return the constants of a lane: lever, its inverse, K, lambda, 1 / Phi."""
    return (
        block[LEVER * LANES + i],
        block[LEVER_INVERSE * LANES + i],
        block[SWITCHING * LANES + i],
        block[SLOPE * LANES + i],
        block[LAYER_INVERSE * LANES + i],
    )


@inlined_jitable
def _slopes(state, gravity, plant):
    """Return `reduced_slopes` of (z, v, sigma, tau, w, ...)."""
    lever, inverse, switching, slope, layer = plant
    return reduced_slopes(
        state[0], state[1], state[2], state[3], state[4],
        lever, inverse, gravity, switching, slope, layer,
    )  # fmt: skip


@inlined_jitable
def _rk4(block, i, h, gravity):
    """Return (z, v, sigma, tau, w, phi) after a step of RK4, and the slopes of its last stage.

    v and w are the velocities of z and phi.
    """
    z, v, sigma = block[Z * LANES + i], block[Z_DOT * LANES + i], block[SIGMA * LANES + i]
    tau, w, phi = block[TAU * LANES + i], block[PHI_DOT * LANES + i], block[PHI * LANES + i]
    u1, a1 = block[U * LANES + i], block[PHI_DDOT * LANES + i]
    s1, t1 = block[SIGMA_DOT * LANES + i], block[TAU_DOT * LANES + i]
    plant, half, sixth = _plant(block, i), 0.5 * h, h * (1.0 / 6.0)
    v2, w2 = v + half * u1, w + half * a1
    at = (z + half * v, v2, sigma + half * s1, tau + half * t1, w2)
    u2, a2, s2, t2, _, _, _, _, _ = _slopes(at, gravity, plant)
    v3, w3 = v + half * u2, w + half * a2
    at = (z + half * v2, v3, sigma + half * s2, tau + half * t2, w3)
    u3, a3, s3, t3, _, _, _, _, _ = _slopes(at, gravity, plant)
    v4, w4 = v + h * u3, w + h * a3
    at = (z + h * v3, v4, sigma + h * s3, tau + h * t3, w4)
    u4, a4, s4, t4, _, _, _, _, _ = _slopes(at, gravity, plant)
    new = (
        z + sixth * (v + 2.0 * (v2 + v3) + v4),
        v + sixth * (u1 + 2.0 * (u2 + u3) + u4),
        sigma + sixth * (s1 + 2.0 * (s2 + s3) + s4),
        tau + sixth * (t1 + 2.0 * (t2 + t3) + t4),
        w + sixth * (a1 + 2.0 * (a2 + a3) + a4),
        phi + sixth * (w + 2.0 * (w2 + w3) + w4),
    )
    return new, (v4, u4, s4, t4, a4)


@inlined_jitable
def _estimate(new, last, slopes):
    """Return the largest difference between the slopes of RK4's last stage and of the new state.

    Each is relative to 1 plus the size of its state; those of z and sigma are absolute. A share of
    it times the step is the difference from a formula of order 3.
    """
    scale_v, scale_tau, scale_w = 1.0 + abs(new[1]), 1.0 + abs(new[3]), 1.0 + abs(new[4])
    rates = scale_tau * scale_w  # one division for all
    error = max(abs(last[0] - new[1]), abs(last[2] - slopes[2])) * scale_v * rates
    error = max(error, abs(last[1] - slopes[0]) * rates)
    error = max(error, abs(last[3] - slopes[3]) * scale_v * scale_w)
    error = max(error, abs(last[4] - slopes[1]) * scale_v * scale_tau)
    return error / (scale_v * rates)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Terms:
    """The terms of (O1) of many closed loops."""

    # integrals of abs(z) [m s] and abs(phi) [rad s] up to `end_time`, shape (N,)
    iae_z: NDArray[np.float64]
    iae_phi: NDArray[np.float64]
    max_force: NDArray[np.float64]  # largest abs(F) [N], shape (N,)
    # when the loop ended [s], shape (N,): the horizon, or the time at which it fell or diverged
    end_time: NDArray[np.float64]
    lost: NDArray[np.bool_]  # whether it fell or diverged, shape (N,)


def closed_loop_terms(
    gains: ArrayLike,
    plants: ArrayLike,
    *,
    initial_state: tuple[float, float, float, float] = (0.0, -math.pi / 3.0, 0.0, 0.0),
    duration: float = 20.0,
    pole_mass: float = NOMINAL.pole_mass,
    gravity: float = NOMINAL.gravity,
    tolerance: float = TOLERANCE,
    threads: int = 1,
) -> Terms:
    """Return the terms of (O1) for many gains and plants.

    Parameters
    ----------
    gains
        (K, lambda, Phi), shape (N, 3).
    plants
        (M, l) [kg, m], shape (N, 2) or (2,).
    duration
        The horizon [s].
    pole_mass, gravity
        m [kg] and g [m/s^2].
    tolerance
        Local error of a step, 1e-12 to 1e-2.
    threads
        Threads to share the loops among; the result does not depend on their number.

    Notes
    -----
    From a start well away from upright, such as the paper's, the relative error of the integrals is
    a few times the tolerance. The tail in closed form neglects terms that are cubic in 0.01 rad,
    which are not small for a start that is itself nearly upright. The largest force is taken at the
    steps and at the edge of the boundary layer, where the paper's start has it; from other starts a
    smooth peak between two steps may be missed by some 1e-3.
    """
    gains = _positive("gains", gains, 3)
    plants = np.asarray(plants, dtype=np.float64)
    if plants.shape not in ((2,), (len(gains), 2)):
        raise InvalidValueError(
            "plants", f"must have shape (2,) or ({len(gains)}, 2)", plants.shape
        )
    plants = _positive("plants", np.broadcast_to(plants, (len(gains), 2)), 2)
    constants = np.array(
        [
            require_positive("pole_mass", pole_mass),
            require_positive("gravity", gravity),
            require_positive("duration", duration),
            0.1 / require_positive("tolerance", tolerance),
        ]
    )
    if not 1e-12 <= tolerance <= 1e-2:
        raise InvalidValueError("tolerance", "must lie within 1e-12 and 1e-2", tolerance)
    if threads < 1:
        raise InvalidValueError("threads", "must be at least 1", threads)
    start = _start(initial_state)
    stiffness = 0.75 * gravity * gains[:, 0] / (gains[:, 2] * plants[:, 1]) * duration
    if np.any(stiffness > STIFFEST):
        rule = f"must not exceed {STIFFEST:g}: the loop would take as many steps"
        raise InvalidValueError("3 g K T / (4 l Phi)", rule, float(stiffness.max()))
    loops = np.ascontiguousarray(np.hstack([plants, gains]))
    found = np.empty((len(loops), 5))
    if threads == 1:
        integrate_all(loops, start, constants, found)
    else:
        with ThreadPoolExecutor(threads) as pool:
            bounds = np.linspace(0, len(loops), 4 * threads + 1).astype(int)
            parts = [slice(a, b) for a, b in pairwise(bounds) if a < b]
            list(pool.map(lambda p: integrate_all(loops[p], start, constants, found[p]), parts))
    return Terms(
        iae_z=found[:, 0],
        iae_phi=found[:, 1],
        max_force=found[:, 2],
        end_time=found[:, 3],
        lost=found[:, 4] == LOST,
    )


def _start(initial_state: tuple[float, float, float, float]) -> NDArray[np.float64]:
    """Return an initial state as an array, or raise."""
    start = np.array(initial_state, dtype=np.float64)
    sound = start.shape == (4,) and bool(np.all(np.abs(start) < STATE_LIMIT))
    if not sound or abs(start[1]) >= FALL_ANGLE:
        rule = f"must be four finite numbers, the angle within {FALL_ANGLE:.4f} rad"
        raise InvalidValueError("initial_state", rule, initial_state)
    return start


def _positive(thing: str, values: ArrayLike, width: int) -> NDArray[np.float64]:
    """Return an array of rows of positive finite numbers, or raise."""
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != width or not len(array):
        raise InvalidValueError(thing, f"must have shape (N, {width})", array.shape)
    bad = ~(np.isfinite(array) & (array > 0.0))
    if np.any(bad):
        raise InvalidValueError(thing, "must be positive and finite", array[bad][0])
    return array


@kernel
def integrate_all(loops, start, constants, found):
    """Integrate every loop to its end.

    loops: (M, l, K, lambda, Phi) of each, shape (N, 5).
    start: The initial state, shape (4,).
    constants: m, g, horizon and the weight of the error, shape (4,).
    found: Takes integrals, largest force, end and status of each loop, shape (N, 5).
    """
    block = np.zeros(ROWS * LANES)
    holds = np.empty(LANES, dtype=np.int64)
    waiting = running = 0
    for lane in range(LANES):
        _load(block, lane, loops[min(lane, len(loops) - 1)], start, constants)
        holds[lane] = waiting
        if waiting < len(loops):
            waiting += 1
            running += 1
        else:
            block[STATUS * LANES + lane] = IDLE
    while running > 0:
        advance(block, constants[0], constants[1], constants[2], constants[3])
        for lane in range(LANES):
            status = block[STATUS * LANES + lane]
            if status == RUNNING or status == IDLE:
                continue
            _finish(block, lane, constants, found[holds[lane]])
            if waiting < len(loops):
                _load(block, lane, loops[waiting], start, constants)
                holds[lane] = waiting
                waiting += 1
            else:
                block[STATUS * LANES + lane] = IDLE
                running -= 1


@kernel
def _load(block, lane, loop, start, constants):
    """Put a loop into a lane, at its start."""
    pole_mass, gravity = constants[0], constants[1]
    cart_mass, half_length, switching, slope, layer = loop
    lever, tau = 4.0 / 3.0 * half_length, math.tan(start[1])
    sigma = math.asinh(tau)
    u, phi_ddot, sigma_dot, tau_dot, surface, _, _, _, cos = reduced_slopes(
        start[0], start[2], sigma, tau, start[3],
        lever, 1.0 / lever, gravity, switching, slope, 1.0 / layer,
    )  # fmt: skip
    force = reduced_force(u, tau, start[3], cos, cart_mass, pole_mass, lever, gravity)
    values = (
        start[0], start[2], sigma, tau, start[3], start[1],
        u, phi_ddot, sigma_dot, tau_dot, surface / layer,
        0.02 * half_length, 0.0, 0.0, 0.0, abs(force), float(RUNNING),
        lever, 1.0 / lever, switching, slope, 1.0 / layer, cart_mass,
    )  # fmt: skip
    for row in range(ROWS):
        block[row * LANES + lane] = values[row]


@kernel
def _finish(block, lane, constants, found):
    """Write the results of the loop in a lane, including its tail."""
    iae_z, iae_phi = block[IAE_Z * LANES + lane], block[IAE_PHI * LANES + lane]
    end, status = block[TIME * LANES + lane], block[STATUS * LANES + lane]
    if status == SETTLED:
        lever, slope = block[LEVER * LANES + lane], block[SLOPE * LANES + lane]
        _, _, _, _, _, xi1, xi2, xi3, _ = reduced_slopes(
            block[Z * LANES + lane], block[Z_DOT * LANES + lane], block[SIGMA * LANES + lane],
            block[TAU * LANES + lane], block[PHI_DOT * LANES + lane], lever, 1.0 / lever,
            constants[1], block[SWITCHING * LANES + lane], slope,
            block[LAYER_INVERSE * LANES + lane],
        )  # fmt: skip
        rest = tail_integrals(xi1, xi2, xi3, slope, lever, constants[1], constants[2] - end)
        iae_z, iae_phi, end = iae_z + rest[0], iae_phi + rest[1], constants[2]
    found[0], found[1], found[2] = iae_z, iae_phi, block[MAX_FORCE * LANES + lane]
    found[3], found[4] = end, status


PENALTY = 1e9
"""Cost of a loop that falls or diverges at the horizon; one that does so at once costs twice as
much."""


def penalised_objective(
    terms: Terms, scales: ObjectiveScales, duration: float
) -> NDArray[np.float64]:
    """Return a finite cost of each loop: lost loops cost more than others, early losses most."""
    costs = objective(terms.iae_z, terms.iae_phi, terms.max_force, scales)
    return np.where(terms.lost, PENALTY * (2.0 - terms.end_time / duration), costs)
