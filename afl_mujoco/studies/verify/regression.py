"""The physics regression: every run of the paper's scenarios against its baseline, a JSON file."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from afl_mujoco.control.controller import Controller
from afl_mujoco.errors import FileError
from afl_mujoco.files import read_json, remove_file, write_json
from afl_mujoco.plants.cartpole import CART_POLE
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.trajectory import Trajectory
from afl_mujoco.studies.shared.contract import Progress, compute, silent
from afl_mujoco.studies.verify.cases import Case, Settings, closed_loop_runs, reported_runs
from afl_mujoco.studies.verify.claims import nominal_scales, with_objective

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
    scales = nominal_scales(settings.timestep)
    recordings = {
        run.simulator: Recording(
            settings=runs[run.simulator].provenance["settings"],
            outcome=runs[run.simulator].outcome.kind,
            metrics=with_objective(run.metrics, scales),
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
    names = [f"{scenario.name} / {controller.name}" for scenario, controller, _ in cases]
    fresh = compute(record, cases, "validating", progress, workers, names)
    return {made.file_name: made for made in fresh}


def _decimated(run: Trajectory) -> tuple[Row, ...]:
    wanted = PERIOD * np.arange(int(run.time[-1] / PERIOD + SLACK) + 1)
    index = np.searchsorted(run.time, wanted - SLACK * SETTINGS.timestep)
    rows = np.column_stack([wanted, run.state[index], run.force[index]])
    known: Any = ([x if np.isfinite(x) else None for x in row] for row in rows.tolist())
    return tuple(map(tuple, known))


# --- what has changed ---------------------------------------------------------------------------


def changes(old: Baseline, new: Baseline) -> list[str]:
    """Return a line for every figure that changed by more than its limit, in order."""
    found = []
    for simulator in dict.fromkeys((*old.runs, *new.runs)):
        place = f"{new.scenario} / {new.controller} / {simulator}"
        before, after = (_figures(one.runs.get(simulator)) for one in (old, new))
        for figure in dict.fromkeys((*before, *after)):
            was, now = (one.get(figure, ["missing"]) for one in (before, after))
            limit = _limit(figure, before)
            pairs = zip(was, now, strict=False)
            moved = [(k, a, b) for k, (a, b) in enumerate(pairs) if _moved(a, b, limit)]
            if len(was) != len(now):
                found.append(f"{place}: {figure} at {len(was)} -> {len(now)} instants")
            elif moved:
                k, a, b = moved[0]
                at = f" at {len(moved)} instants, first at t = {k * PERIOD:g} s,"
                said = f"{figure}{at * (figure in COLUMNS)} {_said(a)} -> {_said(b)}"
                found.append(f"{place}: {said}" + f" (limit {limit:.2e})" * (limit > 0.0))
    return found


def _figures(run: Recording | None) -> dict[str, Sequence[Any]]:
    """Return the outcome, each metric, and each column over time; nothing of no run."""
    if run is None:
        return {}
    single = {"outcome": run.outcome, **run.metrics}
    rows = zip(*run.trajectory, strict=True) if run.trajectory else ((),) * len(COLUMNS)
    columns = zip(COLUMNS, rows, strict=True)
    return {name: [value] for name, value in single.items()} | dict(columns)


def _said(value: object) -> str:
    return "none" if value is None else f"{value:.10g}" if isinstance(value, float) else str(value)


def _limit(figure: str, old: Mapping[str, Sequence[Any]]) -> float:
    sample = (1.0 + SLACK) * SETTINGS.timestep
    if figure.startswith("settling_"):
        return sample
    if figure == "saturated_share" and "end_time" in old:  # samples, as a share of the run
        return sample / (old["end_time"][0] or 1.0)
    if figure in COLUMNS:
        return FORCE_LIMIT if figure == "force" else STATE_LIMIT
    (was,) = old.get(figure, [None])
    return max(RELATIVE_LIMIT * abs(was), ABSOLUTE_LIMIT) if isinstance(was, float) else 0.0


def _moved(old: object, new: object, limit: float) -> bool:
    if isinstance(old, float) and isinstance(new, float):
        return not abs(new - old) <= limit
    return old != new


def compare(baselines: Mapping[str, Baseline], fresh: Mapping[str, Baseline]) -> dict[str, str]:
    """Return what moved, is missing or left over, by the file of the baseline, in lines."""
    told = {}
    for name in dict.fromkeys((*fresh, *baselines)):
        if name not in baselines:
            told[name] = f"missing   {name} has no baseline"
        elif name not in fresh:
            told[name] = f"orphaned  {name} has no run"
        elif moved := changes(baselines[name], fresh[name]):
            old, new = baselines[name].versions, fresh[name].versions
            moved += [f"{package} was {old[package]}, is {new.get(package, 'none')}"
                      for package in old if old[package] != new.get(package)]  # fmt: skip
            told[name] = "\n".join(f"moved     {one}" for one in moved)
    return told


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
    """Make fresh runs the baselines, but for unmoved files; return what changed."""
    told = compare(baselines, fresh)
    for name in told:
        if name in fresh:
            write_json(folder / name, fresh[name])
        else:
            remove_file(folder / name)
    return list(told.values())
