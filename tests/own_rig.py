"""A cart-pole on real hardware, integrated from scratch: it shares no code with the package.

The equations are Lagrange's for a cart with a uniform rod, with viscous friction on rail and hinge;
the drive cuts the command off, delays it and lags it; the sensors are encoders, of which the
controllers get differences. Between the instants at which anything changes SciPy's DOP853
integrates cart, pole and drive together.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp

Law = Callable[[float, np.ndarray], float]


@dataclass(frozen=True, kw_only=True)
class Rig:
    cart: float = 3.2
    pole: float = 0.31
    half: float = 0.42
    gravity: float = 9.81
    rail_damping: float = 4.0
    hinge_damping: float = 2e-3
    period: float = 0.005
    delay: float = 0.0073
    lag: float = 0.011
    limit: float = 60.0
    step_z: float = 1e-4
    step_phi: float = 1e-3
    start: float = 0.15
    push: tuple[float, float, float] = (20.0, 1.6, 0.1034)
    duration: float = 3.2


@dataclass(frozen=True, kw_only=True)
class Motion:
    """What a run shows: state and force often within each period, and the commands."""

    time: np.ndarray
    state: np.ndarray
    force: np.ndarray
    command: np.ndarray
    fell: bool

    def rest(self, begin: float, end: float) -> float | None:
        """How long after `begin` z or phi last leaves 5 cm and 0.02 rad before `end`."""
        outside = (np.abs(self.state[:, 0]) > 0.05) | (np.abs(self.state[:, 1]) > 0.02)
        last = self.time[outside & (self.time >= begin) & (self.time <= end)]
        return None if len(last) and last[-1] > end - 0.01 else float(max([begin, *last])) - begin


def move(rig: Rig, law: Law) -> Motion:
    ticks = math.ceil(rig.duration / rig.period - 1e-9)
    begin, lasts = rig.push[1:]
    sent: list[tuple[float, float]] = [(-1.0, 0.0)]  # when a command arrives at the drive, and it
    seen, x = None, np.array([0.0, rig.start, 0.0, 0.0, 0.0])
    times, states, commands, fell = [], [], [], False
    for tick in range(ticks):
        now, end = tick * rig.period, min((tick + 1) * rig.period, rig.duration)
        position = np.round(x[:2] / (rig.step_z, rig.step_phi)) * (rig.step_z, rig.step_phi)
        rates = np.zeros(2) if seen is None else (position - seen) / rig.period
        seen = position
        asked = law(now, np.concatenate([position, rates]))
        commands.append(asked)
        sent.append((now + rig.delay, float(np.clip(asked, -rig.limit, rig.limit))))
        cuts = sorted({t for t, _ in sent} | {begin, begin + lasts} | {now, end})
        for first, last in pairwise(t for t in cuts if now <= t <= end):
            middle = 0.5 * (first + last)
            wanted = next(f for t, f in reversed(sent) if t <= middle)
            pushed = rig.push[0] if begin <= middle < begin + lasts else 0.0
            part = solve_ivp(
                _slopes, (first, last), x, method="DOP853", rtol=1e-9, atol=1e-11,
                args=(rig, wanted, pushed), t_eval=np.linspace(first, last, 7),
            )  # fmt: skip
            times.append(part.t)
            states.append(part.y.T)
            x = part.y[:, -1]
        if abs(x[1]) > 1.5:
            fell = True
            break
    state = np.concatenate(states)
    return Motion(
        time=np.concatenate(times), state=state[:, :4], force=state[:, 4],
        command=np.array(commands), fell=fell,
    )  # fmt: skip


def _slopes(t: float, x: np.ndarray, rig: Rig, wanted: float, pushed: float) -> list[float]:
    """Lagrange's equations solved for the accelerations, and the lag of the drive."""
    _, phi, v, w, force = x
    ml, sin, cos = rig.pole * rig.half, math.sin(phi), math.cos(phi)
    mass = np.array([[rig.cart + rig.pole, -ml * cos], [-ml * cos, 4.0 / 3.0 * ml * rig.half]])
    loads = [
        force + pushed - rig.rail_damping * v - ml * w * w * sin,
        ml * rig.gravity * sin - rig.hinge_damping * w,
    ]
    return [v, w, *np.linalg.solve(mass, loads), (wanted - force) / rig.lag]
