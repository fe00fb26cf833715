"""Motions with exact dry friction: MuJoCo's accelerations, integrated from reversal to reversal.

MuJoCo softens dry friction: below some mm/s it is viscous, and a step in which the cart reverses
takes one sign of it. Over a window of half a second that shortens a path by a few parts in ten
thousand, more than good sensors leave open. Here the cart sticks where the force that holds it is
within the friction, else friction opposes the sliding, and each reversal ends a step.
"""

from __future__ import annotations

import numpy as np

from afl_mujoco.compiled import kernel
from afl_mujoco.simulation.mujoco_model import forward

PIECES = 8
"""Most reversals in a step; beyond them, the cart sticks for the rest of it."""

SECANTS = 12
"""Most secants to find a reversal."""


@kernel
def _rates(at, x, force, friction, way):
    """Return (z'', phi''); `way` is the sign of the sliding, 0 while the cart sticks."""
    if way != 0.0:
        return forward(at, x[0], x[1], x[2], x[3], force, -friction * way)
    z0, phi0 = forward(at, x[0], x[1], x[2], x[3], force, 0.0)
    z1, phi1 = forward(at, x[0], x[1], x[2], x[3], force, 1.0)  # accelerations are linear in it
    return 0.0, phi0 - z0 / (z1 - z0) * (phi1 - phi0)


@kernel
def _after(at, x, force, friction, way, h):
    """Return the state after a step of RK4 in which `way` does not change."""
    z, phi, v, w = x
    a1, b1 = _rates(at, x, force, friction, way)
    v2, w2 = v + 0.5 * h * a1, w + 0.5 * h * b1
    a2, b2 = _rates(at, (z + 0.5 * h * v, phi + 0.5 * h * w, v2, w2), force, friction, way)
    v3, w3 = v + 0.5 * h * a2, w + 0.5 * h * b2
    a3, b3 = _rates(at, (z + 0.5 * h * v2, phi + 0.5 * h * w2, v3, w3), force, friction, way)
    v4, w4 = v + h * a3, w + h * b3
    a4, b4 = _rates(at, (z + h * v3, phi + h * w3, v4, w4), force, friction, way)
    return (
        z + h / 6.0 * (v + 2.0 * (v2 + v3) + v4),
        phi + h / 6.0 * (w + 2.0 * (w2 + w3) + w4),
        v + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4),
        w + h / 6.0 * (b1 + 2.0 * (b2 + b3) + b4),
    )


@kernel
def _way(at, x, force, friction):
    """Return the sign of the sliding at a state, 0 where the cart sticks."""
    if x[2] != 0.0:
        return 1.0 if x[2] > 0.0 else -1.0
    z0, _ = forward(at, x[0], x[1], x[2], x[3], force, 0.0)
    z1, _ = forward(at, x[0], x[1], x[2], x[3], force, 1.0)
    if abs(z0) <= friction * (z1 - z0):
        return 0.0
    return 1.0 if z0 > 0.0 else -1.0


@kernel
def _reversal(at, x, force, friction, way, h, end):
    """Return when in a step the cart stops, by the Illinois method; `end` is its speed then."""
    early, late, low, high = 0.0, h, x[2], end
    for _ in range(SECANTS):
        time = (early * high - late * low) / (high - low)
        speed = _after(at, x, force, friction, way, time)[2]
        if abs(speed) < 1e-12:
            break
        if speed * high < 0.0:
            early, low = late, high
        else:
            low *= 0.5
        late, high = time, speed
    return time


@kernel
def coulomb_motion(at, starts, forces, friction, step, track):
    """Write the states on the steps of windows, each from its start.

    starts: (z, phi, z_dot, phi_dot), shape (B, 4).
    forces: Force of the drive in each step [N], shape (B, steps).
    friction: Dry friction of the rail [N].
    step: Length of a step [s].
    track: Written, shape (B, steps + 1, 4).
    """
    for b in range(len(starts)):
        x = (starts[b, 0], starts[b, 1], starts[b, 2], starts[b, 3])
        for i in range(4):
            track[b, 0, i] = starts[b, i]
        for k in range(forces.shape[1]):
            force, left = forces[b, k], step
            way = _way(at, x, force, friction)
            for piece in range(PIECES):
                if piece == PIECES - 1:
                    way = 0.0
                    x = (x[0], x[1], 0.0, x[3])
                after = _after(at, x, force, friction, way, left)
                if way * after[2] >= 0.0 or not np.isfinite(after[2]):
                    x = after
                    break
                if x[2] == 0.0:  # it would slide back at once
                    way = 0.0
                    continue
                time = _reversal(at, x, force, friction, way, left, after[2])
                x = _after(at, x, force, friction, way, time)
                x = (x[0], x[1], 0.0, x[3])
                left -= time
                way = _way(at, x, force, friction)
            for i in range(4):
                track[b, k + 1, i] = x[i]
