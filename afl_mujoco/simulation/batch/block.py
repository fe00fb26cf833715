"""A block of closed loops side by side, each with its own step (`closed_loop_terms`).

One flat array and constant row numbers show the compiler that rows do not overlap, so that it
vectorises over the lanes; every function in the loop is inlined for that. A lane is an element of
these vectors.
"""

from __future__ import annotations

import math

from numba.extending import register_jitable

from afl_mujoco.compiled import kernel
from afl_mujoco.simulation.batch.reduced_loop import (
    absolute_area,
    reduced_force,
    reduced_slopes,
    tail_bound,
)
from afl_mujoco.simulation.trajectory import FALL_ANGLE, STATE_LIMIT

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


@kernel
def advance(block, pole_mass, gravity, duration, weight):
    """Try a step in every lane; the compiler vectorises over the lanes.

    Parameters
    ----------
    block
        Rows of `LANES` numbers.
    pole_mass, gravity, duration
        m [kg], g [m/s^2] and the horizon [s].
    weight
        Factor from a difference of slopes to the error of a step, which may be at most 1.
    """
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


@register_jitable(forceinline=True)
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


@register_jitable(forceinline=True)
def _plant(block, i):
    """Return the constants of a lane: lever, its inverse, K, lambda, 1 / Phi."""
    return (
        block[LEVER * LANES + i],
        block[LEVER_INVERSE * LANES + i],
        block[SWITCHING * LANES + i],
        block[SLOPE * LANES + i],
        block[LAYER_INVERSE * LANES + i],
    )


@register_jitable(forceinline=True)
def _slopes(state, gravity, plant):
    """Return `reduced_slopes` of (z, v, sigma, tau, w, ...)."""
    lever, inverse, switching, slope, layer = plant
    return reduced_slopes(
        state[0], state[1], state[2], state[3], state[4],
        lever, inverse, gravity, switching, slope, layer,
    )  # fmt: skip


@register_jitable(forceinline=True)
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


@register_jitable(forceinline=True)
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
