"""Logs cut into windows of equal numbers of rows, each with its own start: multiple shooting."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

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


LEAST = 10
"""Rows that a window must have: a lost row ends it, since the command after it is not known."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Windows:
    """Windows of logs."""

    logs: Sequence[Log]  # all logs
    # index of the log of each window, and its first row in the log, shape (B,)
    log: NDArray[np.int64]
    first: NDArray[np.int64]
    # as in `Log`, shape (B, n); where there is no row, the time that it would have
    time: NDArray[np.float64]
    phi: NDArray[np.float64]
    turns: NDArray[np.float64]
    z: NDArray[np.float64]
    there: NDArray[np.float64]  # 1 where there is a row of the window, else 0, shape (B, n)
    # 1 where there is one whose reading of the angle is valid, else 0, shape (B, n)
    valid: NDArray[np.float64]
    # first guess of the initial states (z, phi, z_dot, phi_dot), shape (B, 4)
    starts: NDArray[np.float64]
    spacing: float  # time between two rows that are used [s]
    step: float  # step of a simulation [s]
    # number of stretches that would have been windows, but whose angle is not known at the start or
    # that are too short
    dropped: int
    share: float  # share of the duration of the logs that lies in a window [1]

    @property
    def whole(self) -> NDArray[np.bool_]:
        """Which windows lack no row, shape (B,)."""
        return np.asarray((self.there > 0.0).all(axis=1))

    @property
    def count(self) -> int:
        """Number of windows."""
        return len(self.log)

    def some(self, every: int) -> Windows:
        """Return every n-th window, with n = `every`."""
        names = ("log", "first", "time", "phi", "turns", "z", "there", "valid", "starts")
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
    least: int | None = LEAST,
) -> Windows:
    """Cut logs into windows.

    A lost row ends a window, and the next begins after it: the command in between is not known, and
    to hold the one before it is off by as much as the command changes in a row.

    length: Length of a window [s].
    every: Time between the starts of two windows [s].
    """
    period = min(log.period for log in logs)
    stride = stride_of(period)
    rows = max(2, round(length / (stride * period))) + 1
    apart = stride * max(1, round(every / (stride * period)))
    least, head = rows if least is None else min(least, rows), min(rows, head)
    columns: dict[str, list[NDArray[Any]]] = {name: [] for name in _COLUMNS}
    places, starts, dropped, covered = [], [], 0, 0.0
    for number, log in enumerate(logs):
        ends = np.flatnonzero(np.diff(log.slots) > gap * stride)
        for first, last in zip([0, *(ends + 1)], [*ends, len(log.time) - 1], strict=True):
            for slot in range(log.slots[first], log.slots[last], apart):
                row = int(np.searchsorted(log.slots, slot))
                part = _part(log, row, last, stride * np.arange(rows))
                there = np.flatnonzero(part["there"])
                if len(there) < least or part["valid"][:head].sum() < min(head, seen):
                    dropped += 1
                    continue
                for name, column in part.items():
                    columns[name].append(column)
                places.append((number, row))
                starts.append(_start(log, row, last, stride))
                covered += float(part["time"][there[-1]] - part["time"][0])
    if not places:
        what = f"one longer than {length:g} s" if least == rows else f"{least} rows without a gap"
        rule = f"must include {what} whose angle is known at the start"
        raise InvalidValueError("logs", rule)
    return Windows(
        logs=logs,
        log=np.array([n for n, _ in places], dtype=np.int64),
        first=np.array([first for _, first in places], dtype=np.int64),
        **{name: np.array(found, dtype=np.float64) for name, found in columns.items()},
        starts=np.array(starts).reshape(len(places), 4),
        spacing=stride * period,
        step=stride * period / max(1, round(stride * period / STEP)),
        dropped=dropped,
        share=min(1.0, covered / sum(log.duration for log in logs)),
    )


_COLUMNS = ("time", "phi", "turns", "z", "there", "valid")


def _part(
    log: Log, row: int, last: int, ahead: NDArray[np.int64]
) -> dict[str, NDArray[np.float64]]:
    """Return the columns of a window from a row on, at most to a last row.

    ahead: How many periods after the first each of its rows is, shape (n,).
    """
    slots = log.slots[row] + ahead
    rows = np.minimum(np.searchsorted(log.slots, slots), last)
    there = (log.slots[rows] == slots).astype(float)
    beyond = log.period * np.maximum(0, slots - log.slots[-1])
    return {
        "time": np.interp(slots, log.slots, log.time) + beyond,
        "phi": log.phi[rows],
        "turns": log.turns[rows],
        "z": log.z[rows],
        "there": there,
        "valid": there * log.valid[rows],
    }


def _start(log: Log, row: int, last: int, stride: int) -> list[float]:
    """Return a state near that of a row, from parabolas through the rows that follow."""
    near = slice(row, min(row + SEEN * stride, last + 1), stride)
    time = log.time[near] - log.time[row]
    phi, z = (np.polyfit(time, values[near], 2) for values in (log.angle, log.z))
    return [float(z[2]), float(phi[2]), float(z[1]), float(phi[1])]
