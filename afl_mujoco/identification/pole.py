"""The pole driven by a cart that is measured, with dry friction as Coulomb has it."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from scipy.interpolate import make_interp_spline

from afl_mujoco.compiled import borrowing_kernel, kernel
from afl_mujoco.identification.description import Description
from afl_mujoco.identification.least_squares import Array, Parameter
from afl_mujoco.identification.log import Windows, stride_of
from afl_mujoco.simulation.mujoco_model import forward

PIECES = 8  # most reversals in a step; beyond them, the cart sticks for the rest of it
SECANTS = 12  # most secants to find a reversal


@borrowing_kernel
def _accelerations(at, space, x, force, push):
    """Return (z'', phi'') under a force of the drive and one beside it; `space` has room for 9."""
    state, inputs, forces, found = space[:4], space[4:5], space[5:7], space[7:]
    state[0], state[1], state[2], state[3] = x
    inputs[0], forces[0] = force, push
    forward(at, state, inputs, forces, found)
    return found[0], found[1]


@borrowing_kernel
def _coulomb_rates(at, space, x, force, friction, way):
    """Return (z'', phi''); `way` is the sign of the sliding, 0 while the cart sticks."""
    if way != 0.0:
        return _accelerations(at, space, x, force, -friction * way)
    z0, phi0 = _accelerations(at, space, x, force, 0.0)
    z1, phi1 = _accelerations(at, space, x, force, 1.0)  # accelerations are linear in it
    return 0.0, phi0 - z0 / (z1 - z0) * (phi1 - phi0)


@borrowing_kernel
def _after(at, space, x, force, friction, way, h):
    z, phi, v, w = x
    a1, b1 = _coulomb_rates(at, space, x, force, friction, way)
    v2, w2 = v + 0.5 * h * a1, w + 0.5 * h * b1
    second = (z + 0.5 * h * v, phi + 0.5 * h * w, v2, w2)
    a2, b2 = _coulomb_rates(at, space, second, force, friction, way)
    v3, w3 = v + 0.5 * h * a2, w + 0.5 * h * b2
    third = (z + 0.5 * h * v2, phi + 0.5 * h * w2, v3, w3)
    a3, b3 = _coulomb_rates(at, space, third, force, friction, way)
    v4, w4 = v + h * a3, w + h * b3
    last = (z + h * v3, phi + h * w3, v4, w4)
    a4, b4 = _coulomb_rates(at, space, last, force, friction, way)
    return (
        z + h / 6.0 * (v + 2.0 * (v2 + v3) + v4),
        phi + h / 6.0 * (w + 2.0 * (w2 + w3) + w4),
        v + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4),
        w + h / 6.0 * (b1 + 2.0 * (b2 + b3) + b4),
    )


@borrowing_kernel
def _way(at, space, x, force, friction):
    """Return the sign of the sliding at a state, 0 where the cart sticks."""
    if x[2] != 0.0:
        return 1.0 if x[2] > 0.0 else -1.0
    z0, _ = _accelerations(at, space, x, force, 0.0)
    z1, _ = _accelerations(at, space, x, force, 1.0)
    if abs(z0) <= friction * (z1 - z0):
        return 0.0
    return 1.0 if z0 > 0.0 else -1.0


@borrowing_kernel
def _reversal(at, space, x, force, friction, way, h, end):
    """Return when in a step the cart stops, by the Illinois method; `end` is its speed then."""
    early, late, low, high = 0.0, h, x[2], end
    for _ in range(SECANTS):
        time = (early * high - late * low) / (high - low)
        speed = _after(at, space, x, force, friction, way, time)[2]
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
    """Write the states on the steps of windows, each from its start, as a track (B, steps + 1, 4).

    Forces of the drive are [N], shape (B, steps), as is the dry friction of the rail; steps [s].
    """
    space = np.zeros(9)
    for b in range(len(starts)):
        x = (starts[b, 0], starts[b, 1], starts[b, 2], starts[b, 3])
        for i in range(4):
            track[b, 0, i] = starts[b, i]
        for k in range(forces.shape[1]):
            force, left = forces[b, k], step
            way = _way(at, space, x, force, friction)
            for piece in range(PIECES):
                if piece == PIECES - 1:
                    way = 0.0
                    x = (x[0], x[1], 0.0, x[3])
                after = _after(at, space, x, force, friction, way, left)
                if way * after[2] >= 0.0 or not np.isfinite(after[2]):
                    x = after
                    break
                if x[2] == 0.0:  # it would slide back at once
                    way = 0.0
                    continue
                time = _reversal(at, space, x, force, friction, way, left, after[2])
                x = _after(at, space, x, force, friction, way, time)
                x = (x[0], x[1], 0.0, x[3])
                left -= time
                way = _way(at, space, x, force, friction)
            for i in range(4):
                track[b, k + 1, i] = x[i]


HARMONICS = 4  # number of harmonics of the angle in the nonlinearity of a sensor with a dead zone
SLOW = 0.05  # rate of the hinge below which its dry friction passes smoothly through zero [rad/s]
START_SCALE = np.array([0.01, 0.1])  # scale of the changes of a start (phi, phi_dot) [rad, rad/s]


def parameters_of(description: Description) -> list[Parameter]:
    """Return the parameters of the pole and of the two sensors.

    They include scale and linearity of the angle only if the sensor has a dead zone: a sensor that
    covers the whole turn counts its turns.
    """
    w2, reach = description.nominal.gravity_term, max(2.0 * description.period, 0.04)
    found = [  # name, unit, title, start, low, high, scale
        Parameter("gravity_term", "1/s²", "gravity term w2", w2, w2 / 5.0, 5.0 * w2, w2),
        Parameter("coupling", "1", "coupling k", 1.0, -0.5, 5.0, 1.0),
        Parameter("damping", "1/s", "viscous friction of the hinge", 0.05, -1.0, 20.0, 0.1),
        Parameter("friction", "rad/s²", "dry friction of the hinge", 0.05, -2.0, 20.0, 0.1),
        Parameter("skew", "s", "skew: the position is read after the angle by",
                  0.0, -reach, reach, 1e-2),
        Parameter("compliance", "s²", "compliance: the cart is ahead of its reading by, "
                  "per acceleration", 0.0, -1e-3, 1e-3, 1e-4),
        Parameter("angle_offset", "rad", "angle at the zero of its readings", 0.0, -0.5, 0.5, 0.01),
    ]  # fmt: skip
    if description.phi.dead_zone is not None:
        found.append(Parameter("angle_scale", "1", "scale of the angle", 0.97, 0.7, 1.3, 0.1))
        found += [
            Parameter(f"{wave}_{k}", "rad", f"linearity: {wave} {k} phi", 0.0, -0.1, 0.1, 2e-3)
            for k in range(1, HARMONICS + 1)
            for wave in ("sin", "cos")
        ]
    return found


NONE = {"angle_scale": 1.0}  # values of parameters that are not estimated


class Drive:
    """The recorded motion of the cart over windows, under gravity [m/s^2]."""

    def __init__(self, windows: Windows, gravity: float) -> None:
        self.windows, self.gravity = windows, gravity
        strides = [slice(None, None, stride_of(log.period)) for log in windows.logs]
        self._tracks = [
            make_interp_spline(log.time[some], log.z[some], k=5)
            for log, some in zip(windows.logs, strides, strict=True)
        ]

    def readings(self, values: Mapping[str, float], starts: Array) -> Array:
        """Return the readings of the angle at the rows, (B, n), from states (phi, phi_dot)."""
        v, w = {**NONE, **values}, self.windows
        factor = v["coupling"] * v["gravity_term"] / self.gravity
        track = pole_motion(
            starts, factor * self.velocities(v["skew"], v["compliance"]), w.step,
            v["gravity_term"], v["damping"], v["friction"],
        )  # fmt: skip
        return readings(v, at_rows(w, track[..., 0], track[..., 1], 0.0), w.turns)

    def velocities(self, skew: float, compliance: float) -> Array:
        """Return the cart's velocity on the half steps of the windows [m/s], (B, 2 steps + 1)."""
        w = self.windows
        found = np.empty((w.count, 2 * w.steps + 1))
        half = 0.5 * w.step * np.arange(2 * w.steps + 1)
        for number in np.unique(w.log):
            log, spline, mine = w.logs[number], self._tracks[number], w.log == number
            when = np.clip(w.time[mine, :1] + half - skew, log.time[0], log.time[-1])
            found[mine] = spline(when, 1)
            if compliance:
                found[mine] += compliance * spline(when, 3)
        return found


def readings(values: Mapping[str, float], angles: Array, turns: Array) -> Array:
    """Return what the sensor reads at some angles with so many whole turns [rad]."""
    v, off = {**NONE, **values}, np.zeros_like(angles)
    read: Array = (angles - 2.0 * np.pi * turns - v["angle_offset"]) / v["angle_scale"]
    for k in range(1, HARMONICS + 1):
        if f"sin_{k}" in v:
            off += v[f"sin_{k}"] * np.sin(k * angles) + v[f"cos_{k}"] * np.cos(k * angles)
    return read + off


def at_rows(windows: Windows, values: Array, rates: Array, late: float) -> Array:
    """Return a signal and its rates on the steps, (B, steps + 1), at the rows, (B, n), or later."""
    w = windows
    place = (w.time - w.time[:, :1] + late) / w.step
    i = np.clip(np.floor(place + 1e-9).astype(int), 0, w.steps - 1)
    s, h = place - i, w.step
    b = np.arange(w.count)[:, None]
    y0, y1, d0, d1 = values[b, i], values[b, i + 1], h * rates[b, i], h * rates[b, i + 1]
    a3, a2 = 2.0 * (y0 - y1) + d0 + d1, 3.0 * (y1 - y0) - 2.0 * d0 - d1
    return np.asarray(y0 + s * (d0 + s * (a2 + s * a3)))


@kernel
def _rates(phi, p, drive, w2, c, d):
    """Return (phi', p') for the drive ``(k w2 / g) z'``."""
    rate = p + drive * math.cos(phi)
    sine = math.sin(phi)
    return rate, w2 * sine + drive * rate * sine - c * rate - d * math.tanh(rate / SLOW)


@kernel
def pole_motion(starts, drives, step, w2, c, d):
    """Return (phi, phi') on the steps of each window, by RK4, shape (B, steps + 1, 2).

    drives: ``(k w2 / g) z'`` on the half steps [rad/s], shape (B, 2 steps + 1).
    w2, c, d: Gravity term [1/s^2], viscous [1/s] and dry friction [rad/s^2].
    """
    steps = (drives.shape[1] - 1) // 2
    track = np.empty((len(starts), steps + 1, 2))
    h = step
    for b in range(len(starts)):
        phi = starts[b, 0]
        p = starts[b, 1] - drives[b, 0] * math.cos(phi)
        track[b, 0, 0], track[b, 0, 1] = phi, starts[b, 1]
        for j in range(steps):
            v0, v1, v2 = drives[b, 2 * j], drives[b, 2 * j + 1], drives[b, 2 * j + 2]
            f1, q1 = _rates(phi, p, v0, w2, c, d)
            f2, q2 = _rates(phi + 0.5 * h * f1, p + 0.5 * h * q1, v1, w2, c, d)
            f3, q3 = _rates(phi + 0.5 * h * f2, p + 0.5 * h * q2, v1, w2, c, d)
            f4, q4 = _rates(phi + h * f3, p + h * q3, v2, w2, c, d)
            phi += h / 6.0 * (f1 + 2.0 * f2 + 2.0 * f3 + f4)
            p += h / 6.0 * (q1 + 2.0 * q2 + 2.0 * q3 + q4)
            track[b, j + 1, 0] = phi
            track[b, j + 1, 1] = p + v2 * math.cos(phi)
    return track
