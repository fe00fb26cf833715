"""Stability margins of a linear loop broken where the force enters the plant.

They come from python-control. Added here are the choice of the worst of several crossovers and
the sampled loop, which is transformed into a continuous loop with the same margins.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass

import control
import numpy as np
from numpy.typing import NDArray

from afl_mujoco.scenario.imperfections import IDEAL, Imperfections
from afl_mujoco.scenario.parameters import require_positive
from afl_mujoco.scenario.sampling import SNAP
from afl_mujoco.studies.linearization import Loop

COARSE, FINE = 80, 40
"""Numbers of frequencies at which the disk margin is sought: overall, then near the minimum."""

BEYOND = 100.0
"""Factor by which these frequencies reach below the slowest and above the fastest pole."""

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Margins:
    """What a stable loop tolerates before it becomes unstable, one change at a time.

    Attributes
    ----------
    gain_decrease, gain_increase
        Factors of the loop gain between which it stays stable: below 1, above 1. The plant is
        unstable, so too little gain destabilises the loop; ``inf`` if no increase does.
    phase
        Least additional lag or lead at a crossover [deg].
    delay
        Least additional delay [s]; ``inf`` if there is no crossover.
    crossover
        Frequency at which that delay destabilises it [rad/s].
    disk
        Size alpha of the largest disk of simultaneous changes of gain and phase, by the peak of
        (S - T)/2.
    disk_gain
        The factor of gain, up and down, that the disk contains.
    disk_phase
        The phase, lag and lead, that the disk contains [deg].
    """

    gain_decrease: float
    gain_increase: float
    phase: float
    delay: float
    crossover: float
    disk: float
    disk_gain: float
    disk_phase: float


def loop_margins(
    loop: Loop, control_period: float | None = None, imperfections: Imperfections = IDEAL
) -> Margins | None:
    """Return the margins of a loop, or None if it is not stable.

    Parameters
    ----------
    control_period
        How long the force is held [s]; ``None`` for a continuous controller. The delay of
        the hold itself, half a period, is then no longer part of the margin; with a delay of
        whole periods the loop is stable exactly up to the margin.
    imperfections
        Those of a loop with a held force: its transport delay, besides which the delay margin is
        additional, and how it gets the velocities.
    """
    if control_period is None:
        if not loop.stable:
            return None
        return _margins(control.ss(loop.a, loop.b[:, None], loop.k[None], 0.0), None)
    period = require_positive("control_period", control_period)
    a, b = held_plant(loop, period, imperfections.delay)
    k = np.concatenate([loop.k, np.zeros(len(a) - len(loop.k))])
    if imperfections.differentiated or imperfections.velocity_filter:
        a, b, k = measured_loop(a, b, k, period, imperfections)
    if not np.abs(np.linalg.eigvals(a - np.outer(b, k))).max() < 1.0:
        return None
    return _margins(_bilinear(a, b, k, period), period)


def held_plant(loop: Loop, period: float, delay: float = 0.0) -> tuple[Array, Array]:
    """Return A and B of the plant from sample to sample, its force held in between.

    With a delay, the pending forces follow the states, the latest first.

    Parameters
    ----------
    period
        Time between two samples [s].
    delay
        Time from when a force is commanded to when it acts [s].
    """
    whole = math.floor(delay / period + SNAP)
    late = max(delay - whole * period, 0.0)
    late = late if late > SNAP * period else 0.0
    a, b = _sampled(loop, period - late)  # of the force that comes last
    if delay < SNAP * period:
        return a, b
    order, waiting = len(a), whole + (1 if late else 0)
    system, drive = np.zeros((order + waiting, order + waiting)), np.zeros(order + waiting)
    system[:order, :order] = a
    if late:
        before, by_before = _sampled(loop, late)
        system[:order, :order] = a @ before
        system[:order, order + waiting - 1] = a @ by_before
    if whole:
        system[:order, order + whole - 1] += b
    else:
        drive[:order] = b
    drive[order] = 1.0
    for i in range(1, waiting):
        system[order + i, order + i - 1] = 1.0
    return system, drive


def measured_loop(
    a: Array, b: Array, k: Array, period: float, imperfections: Imperfections
) -> tuple[Array, Array, Array]:
    """Return A, B and K of a sampled loop whose controller gets its velocities by measurement.

    Four states are added, what the sensors remember: the positions and the filtered velocities of
    the sample before.

    Parameters
    ----------
    period
        Time between two samples [s].
    imperfections
        Whether velocities are differences of positions, and how they are filtered.
    """
    order, r = len(a), imperfections
    rows = np.eye(order + 4)
    positions, velocities, before, filtered = rows[:2], rows[2:4], rows[order:-2], rows[-2:]
    if r.differentiated:
        velocities = (positions - before) / period
    kept = math.exp(-period / r.velocity_filter) if r.velocity_filter else 0.0
    seen = kept * filtered + (1.0 - kept) * velocities
    system = np.zeros((order + 4, order + 4))
    system[:order, :order], system[order:-2], system[-2:] = a, positions, seen
    gains = np.append(k, np.zeros(4))
    gains[2:4] = 0.0
    return system, np.append(b, np.zeros(4)), gains + k[2:4] @ seen


def _sampled(loop: Loop, length: float) -> tuple[Array, Array]:
    """Return A and B of the plant over a length of time [s], its force held."""
    order = len(loop.a)
    plant = control.ss(loop.a, loop.b[:, None], np.eye(order), np.zeros((order, 1)))
    sampled = control.sample_system(plant, length, method="zoh")
    return np.asarray(sampled.A), np.asarray(sampled.B)[:, 0]


def _bilinear(a: Array, b: Array, k: Array, period: float) -> control.StateSpace:
    """Return a sampled loop as a function of w, where ``z = (1 + w T/2) / (1 - w T/2)``.

    The unit circle becomes the imaginary axis, so gain, phase and disk margins are those of a
    continuous loop, at frequencies ``(2/T) tan(omega T/2)``.
    """
    half = 0.5 * period
    inverse = np.linalg.inv(np.eye(len(a)) + a)
    a_w = inverse @ (a - np.eye(len(a))) / half
    b_w = inverse @ b / half
    direct = -half * (k @ b_w)
    return control.ss(a_w, (b_w - half * (a_w @ b_w))[:, None], k[None], direct)


def _margins(system: control.StateSpace, period: float | None) -> Margins:
    """Return the margins of a stable loop; of a sampled one as a function of w with its period."""
    gains, phases, _, _, crossovers, _ = control.stability_margins(system, returnall=True)
    if period is not None:
        at_nyquist = float(system.D[0, 0])  # w is infinite there: no crossover, but L is real
        gains = np.append(gains, -1.0 / at_nyquist) if at_nyquist < 0.0 else gains
        crossovers = 2.0 / period * np.arctan(0.5 * period * crossovers)
    delays = np.radians(np.mod(phases, 360.0)) / crossovers
    worst = int(np.argmin(delays)) if len(delays) else None
    disk, disk_gain, disk_phase = _disk(system)
    return Margins(
        gain_decrease=float(np.max(gains[gains < 1.0], initial=0.0)),
        gain_increase=float(np.min(gains[gains > 1.0], initial=np.inf)),
        phase=float(np.min(np.abs(phases), initial=np.inf)),
        delay=np.inf if worst is None else float(delays[worst]),
        crossover=np.inf if worst is None else float(crossovers[worst]),
        disk=disk,
        disk_gain=disk_gain,
        disk_phase=disk_phase,
    )


def _disk(system: control.StateSpace) -> tuple[float, float, float]:
    """Return disk margin, its gain as a factor and its phase [deg]."""
    with warnings.catch_warnings():  # python-control 0.10 does what NumPy 2.5 deprecates
        warnings.filterwarnings("ignore", "Setting the shape", DeprecationWarning)
        return _disk_margins(system)


def _disk_margins(system: control.StateSpace) -> tuple[float, float, float]:
    """Return the same, with the warnings of python-control."""
    closed = np.abs(control.poles(control.feedback(system)))
    bounds = closed.min() / BEYOND, closed.max() * BEYOND
    omega = np.geomspace(*bounds, COARSE)
    least = int(np.argmin(control.disk_margins(system, omega, returnall=True)[0]))
    near = omega[max(least - 1, 0)], omega[min(least + 1, COARSE - 1)]
    alpha, gain, phase = control.disk_margins(system, np.geomspace(*near, FINE))
    return float(alpha), float(control.db2mag(gain)), float(phase)
