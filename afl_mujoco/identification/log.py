"""Logs of a cart-pole: read from CSV, checked, in SI units, and written."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.errors import FileError, InvalidValueError, meant
from afl_mujoco.files import atomic_file
from afl_mujoco.identification.description import UNITS, Description

MOST_BYTES = 100_000_000
"""Of a file that is read."""

LEAST_ROWS = 50
"""Of a log: a second at 50 Hz."""

PERIOD_DIFFERENCE = 0.1
"""Relative difference up to which the period of a log is its nominal one."""

LARGEST = 1e20
"""Number in a log: nanoseconds since 1970 are below it."""

JITTER = 0.05
"""Scatter of time stamps about a period up to which the device is taken to be regular, and the
stamps to be late by chance [period]."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Log:
    """A log in SI units.

    Attributes
    ----------
    name
        Of its file, without the ending.
    time
        Since the first row [s], shape (N,); of a device whose stamps only scatter, its own period
        counted on.
    phi
        Readings of the angle [rad], shape (N,), upright at the zero that the description gives;
        where there is a dead zone, those above it less 2 pi, so that they grow from end to end.
    turns
        Whole turns to add, shape (N,): the angle goes on where a reading jumps from end to end.
    valid
        Where the angle's reading says something, shape (N,).
    z
        Position of the cart [m], shape (N,).
    command
        Held from a row's time to the next, shape (N,).
    period, jitter
        Time between two rows, and the scatter of the stamps about it [s].
    missing
        How many rows are missing.
    """

    name: str
    time: NDArray[np.float64]
    phi: NDArray[np.float64]
    turns: NDArray[np.float64]
    valid: NDArray[np.bool_]
    z: NDArray[np.float64]
    command: NDArray[np.float64]
    period: float
    jitter: float
    missing: int

    @property
    def duration(self) -> float:
        """From the first row to the last [s]."""
        return float(self.time[-1])

    @property
    def angle(self) -> NDArray[np.float64]:
        """The angle without turns, as far as the readings tell it, across the dead zone a line."""
        there = self.valid
        known = self.phi[there] + 2.0 * np.pi * self.turns[there]
        return np.interp(self.time, self.time[there], known)


def read_log(path: str | Path, description: Description) -> Log:
    """Read a log from a CSV file.

    Parameters
    ----------
    path
        The file: a header, then rows of numbers; lines that begin with # are comments.
    description
        What its columns mean.

    Raises
    ------
    AflMujocoError
        If it cannot be read, or is no log that can be used; the message names file, rule and value.
    """
    path = Path(path)
    table = _read(path, list(description.columns.values()))
    try:
        return log_of(path.stem, table, description)
    except InvalidValueError as error:
        raise error.within(f"{path}: ") from None


def read_logs(paths: Sequence[str | Path], description: Description) -> list[Log]:
    """Read logs, of a folder every CSV file in it, in the order of their names.

    Raises
    ------
    AflMujocoError
        As of `read_log`; if a folder has none, or two have one name.
    """
    files: list[Path] = []
    for path in map(Path, paths):
        found = sorted(path.glob("*.csv")) if path.is_dir() else [path]
        if not found:
            raise FileError(str(path), "must hold logs, *.csv")
        files += found
    stems = [file.stem for file in files]
    for stem in stems:
        if stems.count(stem) > 1:
            raise InvalidValueError("log", "must be given once, by one name", stem)
    return [read_log(file, description) for file in files]


def write_log(
    path: Path,
    time: NDArray[np.float64],
    phi: NDArray[np.float64],
    z: NDArray[np.float64],
    command: NDArray[np.float64],
) -> None:
    """Write a log whose columns are named as a description has them by default, in SI units.

    Parameters
    ----------
    path
        The file.
    time, phi, z, command
        Shape (N,) [s, rad, m, N].
    """
    with atomic_file(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("time", "phi", "z", "command"))
        rows = zip(time, phi, z, command, strict=True)
        writer.writerows([f"{x:.9g}" for x in row] for row in rows)


def log_of(name: str, table: dict[str, NDArray[np.float64]], description: Description) -> Log:
    """Return a log of its columns, or raise if nothing can be learnt from it.

    Parameters
    ----------
    name
        Of the log.
    table
        Its columns by header, shape (N,), in the units of the description.
    """
    d = description
    columns = {signal: table[header] for signal, header in d.columns.items()}
    for signal, values in columns.items():
        fine = np.abs(values) < LARGEST
        if not fine.all():
            row = int(np.argmin(fine)) + 1
            rule = f"must be numbers below {LARGEST:g}"
            raise InvalidValueError(d.columns[signal], rule, f"{values[row - 1]:g} in row {row}")
    if len(columns["time"]) < LEAST_ROWS:
        raise InvalidValueError("rows", f"must be at least {LEAST_ROWS}", len(columns["time"]))
    time, period, jitter, missing = _clock(columns["time"], d)
    raw = columns["phi"]
    zone = d.phi.dead_zone
    valid = np.ones(len(raw), bool) if zone is None else (raw <= zone[0]) | (raw >= zone[1])
    unit = 2.0 * math.pi / abs(d.phi.radians)  # of a turn
    span = float(np.ptp(raw))
    if zone is not None and span > 1.01 * unit:
        rule = f"must lie within a turn, {unit:.4g} {d.phi.unit} (or its unit is another)"
        raise InvalidValueError(d.phi.column, rule, f"a range of {span:.4g}")
    middle = math.inf if zone is None else 0.5 * (zone[0] + zone[1])
    zero = d.phi.zero - unit if d.phi.zero > middle else d.phi.zero
    phi = d.phi.radians * (np.where(raw > middle, raw - unit, raw) - zero)
    z, command = d.z.metres * columns["z"], d.command.sign * columns["command"]
    _require_motion(phi[valid], z, d)
    if (worst := float(np.abs(command).max())) > d.command.limit * (1.0 + 1e-6):
        raise InvalidValueError(d.command.column, f"must be within {d.command.limit:g}", worst)
    there = np.flatnonzero(valid)
    whole = np.round((np.unwrap(phi[there]) - phi[there]) / (2.0 * math.pi))
    turns = np.interp(np.arange(len(phi)), there, whole).round()
    return Log(
        name=name, time=time, phi=phi, turns=turns, valid=valid, z=z, command=command,
        period=period, jitter=jitter, missing=missing,
    )  # fmt: skip


def _clock(
    stamps: NDArray[np.float64], description: Description
) -> tuple[NDArray[np.float64], float, float, int]:
    """Return time, period and jitter [s], and how many rows are missing; or raise."""
    d = description
    time = UNITS["time"][d.time.unit] * (stamps - stamps[0])
    steps = np.diff(time)
    if not (steps > 0.0).all():
        row = int(np.argmin(steps > 0.0)) + 2
        how = "stands still" if steps[row - 2] == 0.0 else "runs back"
        raise InvalidValueError(d.time.column, "must grow from row to row", f"{how} in row {row}")
    period = float(np.median(steps))
    if abs(period / d.period - 1.0) > PERIOD_DIFFERENCE:
        rule = f"must be near the period of the description, {d.period:g} s"
        raise InvalidValueError(f"time between rows ({d.time.column})", rule, f"{period:g} s")
    counts = np.concatenate([[0.0], np.cumsum(np.maximum(1.0, np.round(steps / period)))])
    missing = int(counts[-1]) - (len(time) - 1)
    slope, origin = np.polyfit(counts, time, 1)
    jitter = float(np.std(time - (origin + slope * counts)))
    if jitter <= JITTER * period:
        time, period = slope * counts, float(slope)
    return time, period, jitter, missing


def _require_motion(
    phi: NDArray[np.float64], z: NDArray[np.float64], description: Description
) -> None:
    """Raise where a signal does not move: nothing is known of what it says."""
    d = description
    for signal, values, count, header in (
        ("angle", np.unwrap(phi), d.angle_count, d.phi.column),
        ("position", z, d.position_count, d.z.column),
    ):
        if len(values) == 0 or np.ptp(values) <= 3.0 * count or np.ptp(values) == 0.0:
            raise InvalidValueError(header, f"must move: the {signal} is constant in this log")


def _read(path: Path, headers: Sequence[str]) -> dict[str, NDArray[np.float64]]:
    """Return some columns of a CSV file."""
    try:
        size = path.stat().st_size
        if size > MOST_BYTES:
            rule = f"must be at most {MOST_BYTES // 10**6} MB: cut it into logs of minutes"
            raise InvalidValueError(str(path), rule, f"{size / 1e6:.0f} MB")
        with path.open(newline="", encoding="utf-8-sig") as file:
            lines = csv.reader(line for line in file if line.strip() and not line.startswith("#"))
            first = [name.strip() for name in next(lines, [])]
            for header in headers:
                if first.count(header) > 1:
                    raise FileError(f"{path}: column {header!r}", "must stand there once")
                if header not in first:
                    rule = f"is missing; there are {', '.join(first)}{meant(header, first)}"
                    raise FileError(f"{path}: column {header!r}", rule)
            places = [first.index(header) for header in headers]
            rows = [[row[i] for i in places] for row in lines if row]
    except (UnicodeDecodeError, csv.Error, IndexError):
        raise FileError(str(path), "is no table of numbers, separated by commas") from None
    except OSError as error:
        raise FileError.cannot_be("read", path, error) from None
    try:
        values = np.array(rows, dtype=np.float64).reshape(len(rows), len(headers))
    except ValueError as error:
        raise FileError(str(path), f"must hold numbers: {error}") from None
    return {header: values[:, i] for i, header in enumerate(headers)}
