"""Logs cut into windows of equal numbers of rows, each of which starts anew: multiple shooting."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.identification.log import Log

SEEN = 6
"""Readings of the angle that a window must have among its first rows, for a state to start from."""

FINE = 0.01
"""Readings closer together [s] are left out: one of several is read, all commands count."""

GAP = 1.5
"""Times the spacing of two rows from which on one is missing between them."""

STEP = 5e-3
"""Of a simulation, about [s]: a whole part of the time from a reading to the next."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Windows:
    """Windows of logs.

    Attributes
    ----------
    logs
        All of them.
    log, first
        Which log a window is of, and its first row, shape (B,).
    time, phi, turns, z
        As of `Log`, shape (B, n).
    valid
        1 where the angle's reading says something, shape (B, n).
    starts
        A first guess of the states (z, phi, z_dot, phi_dot), shape (B, 4).
    spacing
        Between two rows that are read [s].
    step
        Of a simulation [s].
    """

    logs: Sequence[Log]
    log: NDArray[np.int64]
    first: NDArray[np.int64]
    time: NDArray[np.float64]
    phi: NDArray[np.float64]
    turns: NDArray[np.float64]
    z: NDArray[np.float64]
    valid: NDArray[np.float64]
    starts: NDArray[np.float64]
    spacing: float
    step: float

    @property
    def whole(self) -> NDArray[np.bool_]:
        """Which have every row, shape (B,)."""
        found: NDArray[np.bool_] = np.diff(self.time, axis=1).max(axis=1) < GAP * self.spacing
        return found

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self.log)

    def some(self, every: int) -> Windows:
        """Return one of so many windows."""
        names = ("log", "first", "time", "phi", "turns", "z", "valid", "starts")
        return replace(self, **{name: getattr(self, name)[::every] for name in names})

    def finer(self, times: int) -> Windows:
        """Return the windows with a step that is so many times smaller."""
        return replace(self, step=self.step / times)

    @property
    def steps(self) -> int:
        """Steps of a simulation that reaches the last row of each, and a period beyond it."""
        longest = float((self.time[:, -1] - self.time[:, 0]).max())
        spare = float(np.diff(self.time, axis=1).max())
        return int(np.ceil((longest + spare) / self.step - 1e-6))


def stride_of(period: float) -> int:
    """Return of how many rows one is read, at a time between rows [s]."""
    return max(1, round(FINE / period))


def cut(
    logs: Sequence[Log],
    length: float,
    every: float,
    *,
    seen: int = SEEN,
    head: int = 2 * SEEN,
    gap: float = GAP,
) -> Windows:
    """Cut logs into windows.

    Parameters
    ----------
    length
        Of a window [s].
    every
        Between the starts of two [s].
    seen, head
        Readings of the angle that a window must have among so many of its first rows; one with
        fewer is left out.
    gap
        From one row to the next, in their spacing, from which on a window is left out: what was
        commanded in between is not known.
    """
    period = min(log.period for log in logs)
    stride = stride_of(period)
    rows = max(2, round(length / (stride * period))) + 1
    reach, apart = stride * (rows - 1) + 1, stride * max(1, round(every / (stride * period)))
    head = min(rows, head)
    places = [
        (number, first)
        for number, log in enumerate(logs)
        for first in range(0, len(log.time) - reach + 1, apart)
        if log.valid[first : first + reach : stride][:head].sum() >= min(head, seen)
        and np.diff(log.time[first : first + reach : stride]).max() < gap * stride * log.period
    ]
    if not places:
        rule = (
            f"must be longer than {length:g} s, one of them at least, the angle known at its start"
        )
        raise InvalidValueError("logs", rule)
    parts = [slice(first, first + reach, stride) for _, first in places]

    def taken(name: str) -> NDArray[np.float64]:
        arrays = [getattr(logs[n], name)[part] for (n, _), part in zip(places, parts, strict=True)]
        return np.array(arrays, dtype=np.float64).reshape(len(places), rows)

    starts = [_start(logs[n], part) for (n, _), part in zip(places, parts, strict=True)]
    return Windows(
        logs=logs,
        log=np.array([n for n, _ in places], dtype=np.int64),
        first=np.array([first for _, first in places], dtype=np.int64),
        time=taken("time"),
        phi=taken("phi"),
        turns=taken("turns"),
        z=taken("z"),
        valid=taken("valid"),
        starts=np.array(starts).reshape(len(places), 4),
        spacing=stride * period,
        step=stride * period / max(1, round(stride * period / STEP)),
    )


def _start(log: Log, part: slice) -> list[float]:
    """Return a state near that of the first row: parabolas through the rows that follow."""
    near = slice(part.start, min(part.start + SEEN * part.step, part.stop), part.step)
    time = log.time[near] - log.time[part.start]
    phi, z = (np.polyfit(time, values[near], 2) for values in (log.angle, log.z))
    return [float(z[2]), float(phi[2]), float(z[1]), float(phi[1])]
