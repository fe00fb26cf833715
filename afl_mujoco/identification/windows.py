"""Logs cut into windows of equal numbers of rows, each with its own start: multiple shooting."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.identification.log import Log

SEEN = 6
"""Readings of the angle that a window must have among its first rows, to find its initial state."""

FINE = 0.01
"""Readings that are closer together [s] are thinned out; all commands are used."""

GAP = 1.5
"""Gap between two rows, in units of their spacing, from which a row is missing between them."""

STEP = 5e-3
"""Approximate step of a simulation [s]: a whole fraction of the time between two readings."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Windows:
    """Windows of logs.

    Attributes
    ----------
    logs
        All logs.
    log, first
        Index of the log of each window, and its first row in the log, shape (B,).
    time, phi, turns, z
        As in `Log`, shape (B, n).
    valid
        1 where the reading of the angle is valid, else 0, shape (B, n).
    starts
        First guess of the initial states (z, phi, z_dot, phi_dot), shape (B, 4).
    spacing
        Time between two rows that are used [s].
    step
        Step of a simulation [s].
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
        """Which windows lack no row, shape (B,)."""
        found: NDArray[np.bool_] = np.diff(self.time, axis=1).max(axis=1) < GAP * self.spacing
        return found

    @property
    def count(self) -> int:
        """Number of windows."""
        return len(self.log)

    def some(self, every: int) -> Windows:
        """Return every n-th window, with n = `every`."""
        names = ("log", "first", "time", "phi", "turns", "z", "valid", "starts")
        return replace(self, **{name: getattr(self, name)[::every] for name in names})

    def finer(self, times: int) -> Windows:
        """Return the windows with a step that is `times` smaller."""
        return replace(self, step=self.step / times)

    @property
    def steps(self) -> int:
        """Number of steps of a simulation to the last row of every window, and a period beyond."""
        longest = float((self.time[:, -1] - self.time[:, 0]).max())
        spare = float(np.diff(self.time, axis=1).max())
        return int(np.ceil((longest + spare) / self.step - 1e-6))


def stride_of(period: float) -> int:
    """Return n if every n-th row is read, for a time between rows [s]."""
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
        Length of a window [s].
    every
        Time between the starts of two windows [s].
    seen, head
        Number of readings of the angle that a window must have among its first `head` rows; a
        window with fewer is left out.
    gap
        Gap between two rows, in units of their spacing, from which a window is left out: the
        command in the gap is not known.
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
        rule = f"must include one longer than {length:g} s whose angle is known at its start"
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
    """Return a state near that of the first row, from parabolas through the rows that follow."""
    near = slice(part.start, min(part.start + SEEN * part.step, part.stop), part.step)
    time = log.time[near] - log.time[part.start]
    phi, z = (np.polyfit(time, values[near], 2) for values in (log.angle, log.z))
    return [float(z[2]), float(phi[2]), float(z[1]), float(phi[1])]
