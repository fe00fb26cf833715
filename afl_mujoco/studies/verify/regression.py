"""The physics regression: every run of the paper's scenarios against its baseline, a JSON file."""

from __future__ import annotations

import platform
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from afl_mujoco.control.controller import Controller
from afl_mujoco.errors import FileError
from afl_mujoco.files import read_json, remove_file, write_json
from afl_mujoco.plants.cartpole import CART_POLE
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.scoring import nominal_scales, with_objective
from afl_mujoco.simulation.trajectory import Trajectory
from afl_mujoco.studies.shared.contract import Progress, compute, silent
from afl_mujoco.studies.verify.cases import (
    Case,
    Settings,
    closed_loop_runs,
    reported_runs,
)

REGRESSED = ("fixed", "adaptive")  # the controllers that have baselines
UPDATE = "make baselines"  # the command that makes the current state the baseline
WRONG = "is not a baseline"

PERIOD = 0.5  # spacing of the instants in a baseline [s]
SETTINGS = Settings()  # the step sizes of every baseline
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

SLACK = 1e-6  # share of a sample that round-off may add to a metric quantised by the samples

Number = float | None
Row = tuple[Number, Number, Number, Number, Number, Number]
COLUMNS = ("t", *CART_POLE.states, "force")


@dataclass(frozen=True, slots=True)
class Recording:
    """The record of one run."""

    settings: Mapping[str, Any]  # of the simulator
    outcome: str  # without the time
    metrics: Mapping[str, Number]
    trajectory: tuple[Row, ...]  # rows of `COLUMNS`, one every `PERIOD`


@dataclass(frozen=True, slots=True)
class Baseline:
    """The record of one scenario with one controller: the content of one file."""

    schema: Literal[1] = field(default=1, kw_only=True)
    columns: tuple[str, ...] = field(default=COLUMNS, kw_only=True)
    scenario: str
    controller: str
    versions: Mapping[str, str]  # of the packages with which it was made
    runs: Mapping[str, Recording]  # by simulator

    @property
    def file_name(self) -> str:
        """Name of its file."""
        return f"{self.scenario}.{self.controller}.json"


# --- what is recorded ---------------------------------------------------------------------------


def record(case: Case) -> Baseline:
    """Simulate one scenario with one controller and return the baseline of the runs."""
    scenario, controller, settings = case
    runs = closed_loop_runs(scenario, controller, settings)
    recordings = {
        run.simulator: Recording(
            settings=runs[run.simulator].provenance["settings"],
            outcome=runs[run.simulator].outcome.kind,
            metrics=run.metrics,
            trajectory=_decimated(runs[run.simulator]),
        )
        for run in reported_runs(scenario, controller, runs)
    }
    versions = {"python": platform.python_version(), **runs["ode"].provenance["versions"]}
    return Baseline(scenario.name, controller.name, versions, recordings)


def record_all(
    scenarios: Sequence[Scenario],
    controllers: Sequence[Controller],
    *,
    workers: int = 1,
    progress: Progress = silent,
) -> dict[str, Baseline]:
    """Record every scenario with every controller, by the name of its file."""
    cases = [(s, c, SETTINGS) for s in scenarios for c in controllers]
    scales = nominal_scales(SETTINGS.timestep)
    names = [f"{scenario.name} / {controller.name}" for scenario, controller, _ in cases]
    fresh = {}
    for made in compute(record, cases, "validating", progress, workers, names):
        runs = {
            name: replace(run, metrics=with_objective(dict(run.metrics), scales))
            for name, run in made.runs.items()
        }
        fresh[made.file_name] = replace(made, runs=runs)
    return fresh


def _decimated(run: Trajectory) -> tuple[Row, ...]:
    wanted = PERIOD * np.arange(int(run.time[-1] / PERIOD + SLACK) + 1)
    index = np.searchsorted(run.time, wanted - SLACK * SETTINGS.timestep)
    rows = np.column_stack([wanted, run.state[index], run.force[index]])
    known: Any = ([x if np.isfinite(x) else None for x in row] for row in rows.tolist())
    return tuple(map(tuple, known))


# --- what has changed ---------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Change:
    """A value that has changed, and how much it may; None if not at all."""

    run: str
    figure: str
    old: object
    new: object
    limit: float | None = None

    def __str__(self) -> str:
        said = f"{self.run}: {self.figure} {_said(self.old)} -> {_said(self.new)}"
        if self.limit is None or not isinstance(self.old, float) or not isinstance(self.new, float):
            return said
        by = self.new - self.old
        relative = f", relative {by / abs(self.old):+.2e}" if self.old else ""
        return f"{said} (by {by:+.2e}{relative}; it may move by {self.limit:.2e})"


def _said(value: object) -> str:
    return "none" if value is None else f"{value:.10g}" if isinstance(value, float) else str(value)


def changes(old: Baseline, new: Baseline) -> list[Change]:
    """Return every value that changed by more than its limit, in order."""
    found: list[Change] = []
    for simulator in dict.fromkeys((*old.runs, *new.runs)):
        name = f"{new.scenario} / {new.controller} / {simulator}"
        there = [simulator in one.runs for one in (old, new)]
        if all(there):
            found += _changes_of_run(name, old.runs[simulator], new.runs[simulator])
        else:
            found.append(Change(name, "recorded", *there))
    return found


def _changes_of_run(name: str, old: Recording, new: Recording) -> Iterator[Change]:
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
        moved = [(a[0], a[column], b[column]) for a, b in pairs
                 if _moved(a[column], b[column], limit)]  # fmt: skip
        if moved:
            time, before, after = moved[0]
            place = f"{figure} at {len(moved)} instants, first at t = {time:g} s,"
            yield Change(name, place, before, after, limit)


def _limit(figure: str, old: Recording) -> float:
    sample = (1.0 + SLACK) * SETTINGS.timestep
    if figure.startswith("settling_"):
        return sample
    if figure == "saturated_share":  # samples that are saturated, as a share of the run
        return sample / (old.metrics.get("end_time") or 1.0)
    return max(RELATIVE_LIMIT * abs(old.metrics[figure] or 0.0), ABSOLUTE_LIMIT)


def _moved(old: Number, new: Number, limit: float) -> bool:
    if old is None or new is None:
        return old is not new
    return not abs(new - old) <= limit


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """What differs between fresh runs and a folder of baselines."""

    runs: int
    changes: Mapping[str, Sequence[Change]]  # by the file of their baseline
    missing: tuple[str, ...]  # files that should be there
    orphaned: tuple[str, ...]  # files for which there is no such run
    versions: tuple[tuple[str, str, str], ...]  # that differ where something changed: old, new

    @property
    def passed(self) -> bool:
        """Whether every run has its baseline, every baseline its run, and nothing moved."""
        return self.runs > 0 and not (self.changes or self.missing or self.orphaned)

    def lines(self, folder: Path) -> list[str]:
        """Return the report, a line for each deviation, the verdict last."""
        moved = [change for found in self.changes.values() for change in found]
        said = [f"moved     {change}" for change in moved]
        said += [f"missing   {folder / x}; {UPDATE} writes it" for x in self.missing]
        said += [f"orphaned  {folder / x} has no run; {UPDATE} removes it" for x in self.orphaned]
        said += [f"note      {name} was {old}, is {new}" for name, old, new in self.versions]
        if self.passed:
            return [*said, f"PASS: {self.runs} runs match their baselines"]
        counts = {
            "figures moved": len(moved),
            "baselines missing": len(self.missing),
            "orphaned": len(self.orphaned),
        }
        summary = ", ".join(f"{count} {what}" for what, count in counts.items() if count)
        return [*said, f"FAIL: {summary or 'no runs'}; {UPDATE} accepts intended changes"]


def compare(baselines: Mapping[str, Baseline], fresh: Mapping[str, Baseline]) -> Comparison:
    """Compare fresh runs with baselines."""
    both = [name for name in fresh if name in baselines]
    moved = {name: found for name in both if (found := changes(baselines[name], fresh[name]))}
    versions = {
        (package, old, fresh[name].versions.get(package, "none"))
        for name in moved
        for package, old in baselines[name].versions.items()
    }
    return Comparison(
        runs=sum(len(baseline.runs) for baseline in fresh.values()),
        changes=moved,
        missing=tuple(name for name in fresh if name not in baselines),
        orphaned=tuple(name for name in baselines if name not in fresh),
        versions=tuple(sorted(v for v in versions if v[1] != v[2])),
    )


# --- the folder ---------------------------------------------------------------------------------


def load_baselines(folder: Path) -> dict[str, Baseline]:
    """Read every baseline of a folder, by the name of its file."""
    if not folder.is_dir():
        raise FileError(f"baseline folder {folder}", f"must exist; {UPDATE} makes it")
    found = {}
    for path in sorted(folder.glob("*.json")):
        found[path.name] = read_json(path, Baseline, WRONG)
        if (name := found[path.name].file_name) != path.name:
            raise FileError(str(path), f"{WRONG}: its file must be named {name}")
    return found


def update_baselines(
    folder: Path, baselines: Mapping[str, Baseline], fresh: Mapping[str, Baseline]
) -> list[str]:
    """Make fresh runs the baselines, but for unmoved files; return what changed, a line each."""
    comparison = compare(baselines, fresh)
    for name in (*comparison.missing, *comparison.changes):
        write_json(folder / name, fresh[name])
    for name in comparison.orphaned:
        remove_file(folder / name)
    said = [f"moved    {change}" for found in comparison.changes.values() for change in found]
    said += [f"new      {folder / name}" for name in comparison.missing]
    said += [f"removed  {folder / name}" for name in comparison.orphaned]
    return said or ["nothing moved"]
