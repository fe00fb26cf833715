"""The physics regression: every run against its baseline, and the update of the baselines."""

from __future__ import annotations

import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np

from afl_mujoco.control.controller import Controller
from afl_mujoco.errors import FileError
from afl_mujoco.files import output_folder, write_json
from afl_mujoco.pool import compute_all, open_executor
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.scoring import nominal_scales, with_objective
from afl_mujoco.simulation.trajectory import Trajectory
from afl_mujoco.studies.cases import (
    Case,
    case_name,
    closed_loop_runs,
    reported_runs,
    require_runnable,
)
from afl_mujoco.studies.regression.baseline import (
    PERIOD,
    SETTINGS,
    SLACK,
    Baseline,
    Change,
    Recording,
    Row,
    changes,
    load_baseline,
)

REGRESSED = ("fixed", "adaptive")
"""The controllers that have baselines."""

UPDATE = "make baselines"
"""The command that makes the current state the baseline."""


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
    progress: Callable[[str], None] = lambda done: None,
) -> dict[str, Baseline]:
    """Record every scenario with every controller, by the name of its file.

    Parameters
    ----------
    workers
        Number of processes that share the work; the result does not depend on it.
    progress
        Called with the name of each case as it is done.
    """
    require_runnable(scenarios, controllers, SETTINGS)
    cases = [(s, c, SETTINGS) for s in scenarios for c in controllers]
    scales = nominal_scales(SETTINGS.timestep)
    with open_executor(min(workers, len(cases))) as executor:
        recorded = compute_all(record, cases, executor, lambda i: progress(case_name(cases[i])))
    fresh = {}
    for made in recorded:
        runs = {
            name: replace(run, metrics=with_objective(dict(run.metrics), scales))
            for name, run in made.runs.items()
        }
        fresh[made.file_name] = replace(made, runs=runs)
    return fresh


def _decimated(run: Trajectory) -> tuple[Row, ...]:
    """Return the rows of a run that a baseline keeps."""
    wanted = PERIOD * np.arange(int(run.time[-1] / PERIOD + SLACK) + 1)
    index = np.searchsorted(run.time, wanted - SLACK * SETTINGS.timestep)
    rows = np.column_stack([wanted, run.state[index], run.force[index]])
    known = ([x if np.isfinite(x) else None for x in row] for row in rows.tolist())
    return tuple(cast(Row, tuple(row)) for row in known)


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """What differs between fresh runs and a folder of baselines.

    Attributes
    ----------
    runs
        Number of runs.
    changes
        Every value that changed by more than its limit, by the file of its baseline.
    missing
        Files that should be there.
    orphaned
        Files for which there is no such run.
    versions
        Packages whose versions differ from those of a changed baseline: name, old, new.
    """

    runs: int
    changes: Mapping[str, Sequence[Change]]
    missing: tuple[str, ...]
    orphaned: tuple[str, ...]
    versions: tuple[tuple[str, str, str], ...]

    @property
    def passed(self) -> bool:
        """Whether every run has its baseline, every baseline its run, and nothing moved."""
        return self.runs > 0 and not (self.changes or self.missing or self.orphaned)

    def lines(self, folder: Path) -> list[str]:
        """Return the report, a line for each deviation, the verdict last."""
        moved = [change for found in self.changes.values() for change in found]
        said = [f"moved     {change}" for change in moved]
        said += [f"missing   {folder / name}; {UPDATE} writes it" for name in self.missing]
        said += [
            f"orphaned  {folder / name} has no run; {UPDATE} removes it" for name in self.orphaned
        ]
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


def load_baselines(folder: Path) -> dict[str, Baseline]:
    """Read every baseline of a folder, by the name of its file."""
    if not folder.is_dir():
        raise FileError(f"baseline folder {folder}", f"must exist; {UPDATE} makes it")
    return {path.name: load_baseline(path) for path in sorted(folder.glob("*.json"))}


def open_for_update(folder: Path) -> dict[str, Baseline]:
    """Make the folder if it is missing, and read its baselines as `load_baselines` does."""
    return load_baselines(output_folder(folder))


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


def update_baselines(
    folder: Path, baselines: Mapping[str, Baseline], fresh: Mapping[str, Baseline]
) -> list[str]:
    """Make fresh runs the baselines and return what changed, a line each.

    A file in which no value changed by more than its limit keeps its bytes, so that the last digits
    of another host do not rewrite all files.
    """
    comparison = compare(baselines, fresh)
    for name in (*comparison.missing, *comparison.changes):
        write_json(folder / name, fresh[name])
    for name in comparison.orphaned:
        try:
            (folder / name).unlink()
        except OSError as error:
            raise FileError.cannot_be("removed", folder / name, error) from None
    said = [f"moved    {change}" for found in comparison.changes.values() for change in found]
    said += [f"new      {folder / name}" for name in comparison.missing]
    said += [f"removed  {folder / name}" for name in comparison.orphaned]
    return said or ["nothing moved"]
