"""Logs of a measured cart-pole, and the windows that they are cut into."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.errors import FileError, InvalidValueError, meant, reading
from afl_mujoco.files import atomic_file, read_utf8
from afl_mujoco.identification.description import UNITS, Description, SensorColumn
from afl_mujoco.values import require_distinct, within

Floats = NDArray[np.float64]

MOST_BYTES = 100_000_000  # largest size of a file that is read
LEAST_ROWS = 50  # least number of rows of a log: a second at 50 Hz
PERIOD_DIFFERENCE = 0.1  # largest relative difference of a period from the nominal one
LARGEST = {"time": 1e20, "phi": 1e7, "z": 1e6, "command": 1e9}
"""Bounds on the numbers in a log: nanoseconds since 1970 [any unit], [rad], [m] and a command."""

SPIKE, LEAST_SPIKE = 2.0, 0.01
"""Step of a reading which, if the readings step back within two rows, no cart-pole makes: in the
largest of a motion one way, and in that which 90 % are below; and at least so far [m, rad]."""

JITTER = 0.05
"""Scatter of time stamps about a regular period up to which the device is taken to be regular and
its stamps to be late at random [period]; beyond it, its readings tell."""

FOLLOWED = 0.2  # share of a stamp's difference by which the clock follows it at first
LEAST_ROUGHNESS = 1e-12  # readings that are smoother than this are taken to be alike [m, rad]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Log:
    """A log in SI units."""

    name: str  # name of its file, without the suffix
    # time since the first row [s], shape (N,); multiples of the device's own period if its stamps
    # only scatter about them
    time: Floats
    # readings of the angle [rad], shape (N,), upright at the zero that the description gives; if
    # there is a dead zone, the readings above it less 2 pi, so that they grow from end to end
    phi: Floats
    # whole turns to add, shape (N,): the angle is continuous where a reading jumps from end to end
    turns: Floats
    valid: NDArray[np.bool_]  # where the reading of the angle is valid, shape (N,)
    z: Floats  # position of the cart [m], shape (N,)
    # command, held from the time of a row to that of the next, shape (N,)
    command: Floats
    # number of periods from the first row to each, whole, shape (N,): more than one more than that
    # of the row before where rows are missing
    slots: NDArray[np.int64]
    period: float  # time between two rows, and the scatter of the stamps about it [s]
    jitter: float

    @property
    def missing(self) -> int:
        """Number of missing rows."""
        return int(self.slots[-1]) - (len(self.time) - 1)

    @property
    def duration(self) -> float:
        """Time from the first row to the last [s]."""
        return float(self.time[-1])

    @property
    def angle(self) -> Floats:
        """The unwrapped angle [rad] from the valid readings, linear across the dead zone."""
        there = self.valid
        known = self.phi[there] + 2.0 * np.pi * self.turns[there]
        return np.interp(self.time, self.time[there], known)


def read_log(path: str | Path, description: Description) -> Log:
    """Read a log from a CSV file."""
    path = Path(path)
    table = _read(path, list(description.columns.values()))
    with within(f"{path}: "):
        return log_of(path.stem, table, description)


def read_logs(paths: Sequence[str | Path], description: Description) -> list[Log]:
    """Read logs from files, or from all CSV files of a folder in the order of their names."""
    files: list[Path] = []
    for path in map(Path, paths):
        found = [path]
        if path.is_dir():
            found = sorted(one for one in path.iterdir() if one.suffix.lower() == ".csv")
        if not found:
            raise FileError(str(path), "must contain logs, *.csv")
        files += found
    require_distinct("log", [file.stem for file in files])
    return [read_log(file, description) for file in files]


def write_log(path: Path, columns: Mapping[str, Floats]) -> None:
    """Write columns of numbers in SI units as a log, by their names."""
    rows, header = np.stack([*columns.values()], axis=1), ",".join(columns)
    with atomic_file(path) as temporary:
        np.savetxt(temporary, rows, "%.9g", ",", header=header, comments="")


def log_of(name: str, table: dict[str, Floats], description: Description) -> Log:
    """Return a log from its columns by header, in the units of the description, or raise."""
    d = description
    columns = {signal: table[header] for signal, header in d.columns.items()}
    units = {"phi": abs(d.phi.si), "z": abs(d.z.si)}
    for signal, values in columns.items():
        largest = LARGEST[signal] / units.get(signal, 1.0)
        fine = np.abs(values) < largest
        if not fine.all():
            row = int(np.argmin(fine)) + 1
            rule = f"must be numbers below {largest:g}"
            raise InvalidValueError(d.columns[signal], rule, f"{values[row - 1]:g} in row {row}")
    if len(columns["time"]) < LEAST_ROWS:
        raise InvalidValueError("rows", f"must be at least {LEAST_ROWS}", len(columns["time"]))
    stamps, slots, period = _stamps(columns["time"], d)
    raw = columns["phi"]
    zone = d.phi.dead_zone
    valid = np.ones(len(raw), bool) if zone is None else (raw <= zone[0]) | (raw >= zone[1])
    unit = 2.0 * math.pi / abs(d.phi.si)  # one turn, in the unit of the readings
    span = float(np.ptp(raw))
    if zone is not None and span > 1.01 * unit:
        rule = f"must lie within a turn, {unit:.4g} {d.phi.unit} (or its unit is wrong)"
        raise InvalidValueError(d.phi.column, rule, f"a range of {span:.4g}")
    middle = math.inf if zone is None else 0.5 * (zone[0] + zone[1])
    zero = d.phi.zero - unit if d.phi.zero > middle else d.phi.zero
    phi = d.phi.si * (np.where(raw > middle, raw - unit, raw) - zero)
    z, command = d.z.si * columns["z"], d.command.sign * columns["command"]
    for signal, values, sensor in (("angle", np.unwrap(phi[valid]), d.phi), ("position", z, d.z)):
        if len(values) == 0 or np.ptp(values) <= 3.0 * sensor.count or np.ptp(values) == 0.0:
            rule = f"must vary: the {signal} is constant in this log"
            raise InvalidValueError(sensor.column, rule)
    worst, limit = float(np.abs(command).max()), d.command.limit
    if limit is not None and worst > limit * (1.0 + 1e-6):
        raise InvalidValueError(d.command.column, f"must be within {limit:g}", worst)
    there = np.flatnonzero(valid)
    whole = np.round((np.unwrap(phi[there]) - phi[there]) / (2.0 * math.pi))
    turns = np.interp(np.arange(len(phi)), there, whole).round()
    log = Log(
        name=name, time=stamps, phi=phi, turns=turns, valid=valid, z=z, command=command,
        slots=slots, period=period, jitter=0.0,
    )  # fmt: skip
    for values, sensor in ((log.angle, d.phi), (z, d.z)):
        _require_no_spike(values, log, sensor)
    return _on_its_clock(log)


def _require_no_spike(values: Floats, log: Log, sensor: SensorColumn) -> None:
    """Raise if a reading jumps there and back, as no motion does, or at an end of the log."""
    steps = np.diff(values) / np.diff(log.slots)
    size, ends = np.abs(steps), [0, -1]  # there is no row beyond an end, to jump back
    turns = [(k, np.flatnonzero(steps[:-k] * steps[k:] < 0.0)) for k in (1, 2)]
    smooth = np.ones(len(steps), np.bool_)
    for k, at in turns:
        smooth[at] = smooth[at + k] = False
    smooth[ends] = False
    usual = SPIKE * max(size[smooth].max(initial=0.0), np.quantile(size, 0.9), sensor.count)
    far = size > max(usual, LEAST_SPIKE)
    back = np.zeros(len(steps), np.bool_)
    for k, at in turns:
        back[at] |= far[at] & far[at + k]
    back[ends] |= far[ends]
    if back.any():
        row = int(np.argmax(back)) + 1
        rule = "must not jump there and back within two rows (mend the log, or leave the rows out)"
        jump = (values[row] - values[row - 1]) / sensor.si
        raise InvalidValueError(sensor.column, rule, f"{jump:+.4g} {sensor.unit} in row {row + 1}")


def _stamps(stamps: Floats, description: Description) -> tuple[Floats, NDArray[np.int64], float]:
    """Return the time stamps [s], their slots and the usual time between them [s], or raise."""
    d = description
    time = UNITS["time"][d.time.unit] * (stamps - stamps[0])
    steps = np.diff(time)
    if not (steps > 0.0).all():
        row = int(np.argmin(steps > 0.0)) + 2
        how = "no change" if steps[row - 2] == 0.0 else "a decrease"
        rule = "must increase from row to row"
        raise InvalidValueError(d.time.column, rule, f"{how} in row {row}")
    period = float(np.median(steps))
    if abs(period / d.period - 1.0) > PERIOD_DIFFERENCE:
        rule = f"must be near the period of the description, {d.period:g} s"
        raise InvalidValueError(f"time between rows ({d.time.column})", rule, f"{period:g} s")
    slots = _slots(time, period, 0.0, FOLLOWED)
    own, origin, _ = _clock(time, slots)
    slots = _slots(time, own, origin, 0.25 * FOLLOWED)
    every = np.arange(len(time))  # strong jitter looks like lost rows, which fit worse
    return time, min(every, slots, key=lambda one: _clock(time, one)[2]), period


def _clock(time: Floats, slots: NDArray[np.int64]) -> tuple[float, float, float]:
    """Return period and origin of a regular clock, and the scatter of stamps about it [s]."""
    slope, origin = np.polyfit(slots, time, 1)
    return float(slope), float(origin), float(np.std(time - (origin + slope * slots)))


def _slots(time: Floats, period: float, clock: float, followed: float) -> NDArray[np.int64]:
    """Return how many periods each stamp is after the first.

    The clock follows the stamps slowly: rounding each step by itself would take a late stamp and an
    early one after it for a lost row.
    """
    found = [0]
    for stamp in time[1:].tolist():
        ahead = round((stamp - clock) / period)
        if ahead < 1 and len(found) > 1 and found[-1] - found[-2] > 1:
            found[-1] -= 1  # the row before was late, and none was lost
            clock -= period
            ahead += 1
        ahead = max(1, ahead)
        found.append(found[-1] + ahead)
        clock += ahead * period
        clock += followed * (stamp - clock)
    return np.array(found, dtype=np.int64)


def _on_its_clock(log: Log) -> Log:
    """Return a log on the clock of its device: regular, unless its readings follow the stamps."""
    period, _, jitter = _clock(log.time, log.slots)
    regular = np.asarray(period * log.slots, dtype=np.float64)
    if jitter > JITTER * log.period and _smoother(log, log.time) < _smoother(log, regular):
        return replace(log, jitter=jitter)
    return replace(log, time=regular, period=period, jitter=jitter)


def _smoother(log: Log, time: Floats) -> float:
    """Return how far the readings are from cubics through their neighbours, for some times [1].

    The logarithms of the medians over both signals: only differences between two times matter.
    """
    at = np.flatnonzero(log.slots[4:] - log.slots[:-4] == 4) + 2
    far = 0.0
    for values, known in ((log.z, np.ones_like(log.valid)), (log.angle, log.valid)):
        rows = at[known[at]]
        near = rows[:, None] + [-2, -1, 1, 2]
        apart = time[near][:, :, None] - time[near][:, None] + np.eye(4)
        weight = 1.0 / (apart.prod(axis=2) * (time[rows, None] - time[near]))  # as in Lagrange's
        off = values[rows] - (weight * values[near]).sum(axis=1) / weight.sum(axis=1)
        far += math.log(float(np.median(np.abs(off))) + LEAST_ROUGHNESS) if len(rows) else 0.0
    return far


_Row = tuple[str, str, list[str]]  # its place, its line and its values
SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs"}  # of the values of a row


def _read(path: Path, headers: Sequence[str]) -> dict[str, Floats]:
    """Return some columns of a CSV file, or raise where it is wrong."""
    by, there, rows = _table(path, headers)
    for header in headers:
        if there.count(header) > 1:
            raise FileError(f"{path}: column {header!r}", "must occur only once")
        if header not in there:
            rule = f"is missing; the columns are {', '.join(there)}{meant(header, there)} ({by})"
            raise FileError(f"{path}: column {header!r}", rule)
    for place, line, cells in rows:
        if len(cells) < len(there) or any(cells[len(there) :]):
            rule = f"must have {len(there)} values, {by}"
            raise FileError(place, rule, f"{len(cells)}: {line[:60]!r}")
    columns = {}
    for header in headers:
        texts = [cells[there.index(header)] for _, _, cells in rows]
        columns[header] = np.empty(len(rows))
        point = any("." in text for text in texts)  # then a comma is one between thousands
        for row, text in enumerate(texts):
            try:
                if "_" in text:  # which Python reads as 10_000 is written
                    raise ValueError
                columns[header][row] = float(text if point else text.replace(",", "."))
            except ValueError:
                rule = f"must have a number in column {header!r}, {by}"
                raise FileError(rows[row][0], rule, repr(text)) from None
    return columns


def _table(path: Path, wanted: Sequence[str]) -> tuple[str, list[str], list[_Row]]:
    """Return how the values of a CSV file are separated, their names, and its rows."""
    with reading(path, "cannot be read"):
        lines = enumerate(read_utf8(path, MOST_BYTES).splitlines(), start=1)
    numbered = [(number, line) for number, line in lines if line.strip() and line[0] != "#"]
    if not numbered:
        raise FileError(str(path), "must have a header and rows of numbers: it is empty")

    def found(separator: str) -> tuple[int, int]:
        """Return how many columns that are wanted are in the header, and how many there are."""
        names = [name.strip(' "') for name in numbered[0][1].split(separator)]
        return sum(name in names for name in wanted), len(names)

    separator = max(SEPARATORS, key=found)
    by = f"separated by {SEPARATORS[separator]}"
    try:
        first, *rows = csv.reader((line for _, line in numbered), delimiter=separator, strict=True)
    except csv.Error as error:
        raise FileError(str(path), f"is not a table of numbers {by}: {error}") from None
    return by, [name.strip() for name in first], [
        (f"{path}: row {row} (line {numbered[row][0]})", numbered[row][1], cells)
        for row, cells in enumerate(rows, start=1)
    ]  # fmt: skip


SEEN = 6  # readings of the angle among its first rows that a window needs for its start
FINE = 0.01  # readings that are closer together [s] are thinned out; all commands are used
GAP = 1.5  # gap between rows, in their spacing, from which a row is missing there
STEP = 5e-3  # approximate step of a simulation [s]: a whole fraction of that of readings


LEAST = 10  # rows that a window must have: a lost row ends it, its command is not known


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Windows:
    """Windows of logs."""

    logs: Sequence[Log]  # all logs
    log: NDArray[np.int64]  # index of the log of each window, shape (B,)
    # as in `Log`, shape (B, n); where there is no row, the time that it would have
    time: Floats
    phi: Floats
    turns: Floats
    z: Floats
    there: Floats  # 1 where there is a row of the window, else 0, shape (B, n)
    # 1 where there is one whose reading of the angle is valid, else 0, shape (B, n)
    valid: Floats
    # first guess of the initial states (z, phi, z_dot, phi_dot), shape (B, 4)
    starts: Floats
    spacing: float  # time between two rows that are used [s]
    step: float  # step of a simulation [s]
    # number of stretches that would have been windows, but whose angle is not known at the start or
    # that are too short
    dropped: int
    share: float  # share of the duration of the logs that lies in a window [1]
    past: int  # number of rows to which a state to predict from is fitted, the last its own

    @property
    def whole(self) -> NDArray[np.bool_]:
        """Which windows lack no row, shape (B,)."""
        return np.asarray((self.there > 0.0).all(axis=1))

    @property
    def count(self) -> int:
        """Number of windows."""
        return len(self.log)

    def where(self, kept: Any, rows: int | None = None) -> Windows:
        """Return some windows, by an index, and so many of their rows."""
        names = ("time", "phi", "turns", "z", "there", "valid")
        found = {name: getattr(self, name)[kept, :rows] for name in names}
        return replace(self, log=self.log[kept], starts=self.starts[kept], **found)

    @property
    def steps(self) -> int:
        """Number of steps of a simulation to the last row of every window, and a period beyond."""
        longest = float((self.time[:, -1] - self.time[:, 0]).max())
        spare = float(np.diff(self.time, axis=1).max())
        return int(np.ceil((longest + spare) / self.step - 1e-6))

    @property
    def before(self) -> Floats:
        """1 where a reading of the angle is fitted before the start, else 0, shape (B, n)."""
        return self.valid * (np.arange(self.valid.shape[1]) < self.past)

    def rows(self, horizon: float) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Return the row nearest to a time after the start [s], and whether it is near, (B,)."""
        distance = np.abs(self.time - self.time[:, self.past - 1 : self.past] - horizon)
        found: NDArray[np.int64] = np.argmin(distance, axis=1)
        return found, distance.min(axis=1) <= 0.6 * self.spacing


def stride_of(period: float) -> int:
    """Return n if every n-th row is read, for a time between rows [s]."""
    return max(1, round(FINE / period))


def cut(
    logs: Sequence[Log],
    length: float,
    every: float,
    *,
    seen: int = SEEN,
    past: int = 0,
    gap: float = GAP,
    least: int | None = LEAST,
) -> Windows:
    """Cut logs into windows of a length [s], one every so many seconds.

    A lost row ends a window, and the next begins after it: the command in between is not known, and
    to hold the one before it is off by as much as the command changes in a row.
    """
    period = min(log.period for log in logs)
    stride = stride_of(period)
    rows = max(2, round(length / (stride * period))) + 1
    apart = stride * max(1, round(every / (stride * period)))
    least, head = rows if least is None else min(least, rows), min(rows, past or 2 * SEEN)
    parts, numbers, starts, dropped, covered = [], [], [], 0, 0.0
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
                parts.append(part)
                numbers.append(number)
                starts.append(_start(log, row, last, stride))
                covered += float(part["time"][there[-1]] - part["time"][0])
    if not numbers:
        what = f"one longer than {length:g} s" if least == rows else f"{least} rows without a gap"
        raise InvalidValueError("logs", f"must include {what} whose angle is known at the start")
    return Windows(
        logs=logs,
        log=np.array(numbers, dtype=np.int64),
        **{name: np.array([part[name] for part in parts]) for name in parts[0]},
        starts=np.array(starts).reshape(len(numbers), 4),
        spacing=stride * period,
        step=stride * period / max(1, round(stride * period / STEP)),
        dropped=dropped,
        share=min(1.0, covered / sum(log.duration for log in logs)),
        past=past,
    )


def _part(log: Log, row: int, last: int, ahead: NDArray[np.int64]) -> dict[str, Floats]:
    """Return the columns of a window: rows so many periods ahead of one, at most a last one."""
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
