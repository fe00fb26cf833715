"""A baseline: recorded runs of one scenario and controller, its file, and what has changed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from afl_mujoco.errors import FileError
from afl_mujoco.files import read_json
from afl_mujoco.simulation.metrics import STATES
from afl_mujoco.studies.cases import Settings

WRONG = "is not a baseline"

PERIOD = 0.5
"""Spacing of the instants in a baseline [s]."""

SETTINGS = Settings()
"""The step sizes of every baseline."""

RELATIVE_LIMIT = 1e-6
"""Largest relative change of a metric: no control engineer would notice less. Round-off is far
below it: 0 between Python 3.11 and 3.12, 1e-14 against code for a processor without FMA and AVX."""

ABSOLUTE_LIMIT = 1e-9
"""Largest change of a metric that is zero or nearly so, SI units: round-off is below 1e-12, and
the smallest metric that is not zero is 0.4."""

STATE_LIMIT = 1e-8
"""Largest change of a state at any kept instant, SI units: ten times the limit between the two
simulators (B1); round-off is 2e-14, as the closed loop contracts it."""

FORCE_LIMIT = 1e-6
"""Largest change of the force at any kept instant [N]: a controller's gain on a state is about
100 N; round-off is 2e-13."""

SLACK = 1e-6
"""Share of a sample that round-off may add to a metric quantised by the samples."""

Number = float | None
Row = tuple[Number, Number, Number, Number, Number, Number]
COLUMNS = ("t", *STATES, "force")


@dataclass(frozen=True, slots=True)
class Recording:
    """The record of one run.

    Attributes
    ----------
    settings
        Settings of the simulator.
    outcome
        How the run ended, without the time.
    metrics
        Its metrics.
    trajectory
        Rows of `COLUMNS`, one every `PERIOD`.
    """

    settings: Mapping[str, Any]
    outcome: str
    metrics: Mapping[str, Number]
    trajectory: tuple[Row, ...]


@dataclass(frozen=True, slots=True)
class Baseline:
    """The record of one scenario with one controller: the content of one file.

    Attributes
    ----------
    columns
        Columns of the rows of each recording.
    scenario, controller
        Their names.
    versions
        Versions of the packages with which it was made.
    runs
        A recording for each simulator.
    """

    schema: Literal[1] = field(default=1, kw_only=True)
    columns: tuple[str, ...] = field(default=COLUMNS, kw_only=True)
    scenario: str
    controller: str
    versions: Mapping[str, str]
    runs: Mapping[str, Recording]

    @property
    def file_name(self) -> str:
        """Name of its file."""
        return f"{self.scenario}.{self.controller}.json"


@dataclass(frozen=True, slots=True)
class Change:
    """A value that has changed.

    Attributes
    ----------
    run, figure
        Which value of which run.
    old, new
        The value in the baseline, and the new one.
    limit
        How much it may change; ``None`` if not at all.
    """

    run: str
    figure: str
    old: object
    new: object
    limit: float | None = None

    def __str__(self) -> str:
        """Return the change as one line."""
        said = f"{self.run}: {self.figure} {_said(self.old)} -> {_said(self.new)}"
        if self.limit is None or not isinstance(self.old, float) or not isinstance(self.new, float):
            return said
        by = self.new - self.old
        relative = f", relative {by / abs(self.old):+.2e}" if self.old else ""
        return f"{said} (by {by:+.2e}{relative}; it may move by {self.limit:.2e})"


def _said(value: object) -> str:
    """Return a value as a line shows it."""
    return "none" if value is None else f"{value:.10g}" if isinstance(value, float) else str(value)


def load_baseline(path: Path) -> Baseline:
    """Read a baseline from its file."""
    baseline = read_json(path, Baseline, WRONG)
    if baseline.file_name != path.name:
        raise FileError(str(path), f"{WRONG}: its file must be named {baseline.file_name}")
    return baseline


def changes(old: Baseline, new: Baseline) -> list[Change]:
    """Return every value that changed by more than its limit, in order."""
    found: list[Change] = []
    for simulator in dict.fromkeys((*old.runs, *new.runs)):
        name = f"{new.scenario} / {new.controller} / {simulator}"
        if simulator not in old.runs or simulator not in new.runs:
            there = [simulator in b.runs for b in (old, new)]
            found.append(Change(name, "recorded", *there))
            continue
        found += _changes_of_run(name, old.runs[simulator], new.runs[simulator])
    return found


def _changes_of_run(name: str, old: Recording, new: Recording) -> Iterator[Change]:
    """Yield the values of one run that changed by more than their limits."""
    if old.outcome != new.outcome:
        yield Change(name, "outcome", old.outcome, new.outcome)
    for figure in dict.fromkeys((*old.metrics, *new.metrics)):
        if (figure in old.metrics) != (figure in new.metrics):
            yield Change(name, f"has {figure}", figure in old.metrics, figure in new.metrics)
            continue
        before, after = old.metrics[figure], new.metrics[figure]
        if _moved(before, after, limit := _limit(figure, old)):
            yield Change(name, figure, before, after, limit)
    if [row[0] for row in old.trajectory] != [row[0] for row in new.trajectory]:
        yield Change(name, "number of instants", len(old.trajectory), len(new.trajectory))
        return
    for column, figure in enumerate(COLUMNS[1:], start=1):
        limit = FORCE_LIMIT if figure == "force" else STATE_LIMIT
        pairs = zip(old.trajectory, new.trajectory, strict=True)
        moved = [(a, b) for a, b in pairs if _moved(a[column], b[column], limit)]
        if moved:
            (time, *_), _ = moved[0]
            place = f"{figure} at {len(moved)} instants, first at t = {time:g} s,"
            yield Change(name, place, moved[0][0][column], moved[0][1][column], limit)


def _limit(figure: str, old: Recording) -> float:
    """Return how much a metric may change."""
    sample = (1.0 + SLACK) * SETTINGS.timestep
    if figure.startswith("settling_"):
        return sample
    if figure == "saturated_share":  # samples that are saturated, as a share of the run
        return sample / (old.metrics.get("end_time") or 1.0)
    return max(RELATIVE_LIMIT * abs(old.metrics[figure] or 0.0), ABSOLUTE_LIMIT)


def _moved(old: Number, new: Number, limit: float) -> bool:
    """Return whether a value changed by more than `limit`."""
    if old is None or new is None:
        return old is not new
    return not abs(new - old) <= limit
