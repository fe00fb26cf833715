"""One run of one controller on one scenario, judged: the row of every study."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import PlainSerializer, PlainValidator, TypeAdapter, ValidationError

from afl_mujoco.control.controller import Controller
from afl_mujoco.plants.plant import Plant
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.time_steps import DEFAULT, Deployed
from afl_mujoco.simulation.judgement import (
    CONTROLLER_FAILED,
    Judgement,
    failure_of,
    judge,
    judge_failure,
    least_margin,
    settling_time,
)
from afl_mujoco.simulation.metrics import effort_names
from afl_mujoco.simulation.trajectory import COMPLETED, Outcome, Trajectory, criterion_of

if TYPE_CHECKING:
    from afl_mujoco.simulation.sampled.rollouts import Rollout


def columns_of(plant: Plant) -> tuple[str, ...]:
    """Return the figures of every row of runs of a plant, in SI units; None for a missing one."""
    efforts = [effort_names(plant.inputs, name)[:2] for name in plant.inputs]
    return (
        *(f"peak_{name}" for name in plant.coordinates),
        *(x for one in efforts for x in one),
        *(f"iae_{name}" for name in plant.coordinates),
        "settling_time",
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """One run: the row of every table."""

    scenario: str
    controller: str
    draw: int = 0  # of noise and start, or number of the sample or the start, from 0
    outcome: str  # one of `OUTCOMES`, or CONTROLLER_FAILED
    failure: str  # how it failed, from `failure_of`; empty if it met every requirement
    settled: bool  # within its bands for the last second at least, required or not
    time: float | None  # when it ended, or reached the end stop if that is its failure [s]
    metrics: Mapping[str, float | None]  # `columns_of` the plant
    requirements: tuple[Judgement, ...]
    message: str = ""  # of a controller that computed no force

    @property
    def missed(self) -> list[Judgement]:
        """The requirements that are not met."""
        return [one for one in self.requirements if not one.met]

    @property
    def ending(self) -> str:
        """How it ended, and when, in words."""
        if self.outcome == CONTROLLER_FAILED:
            return f"failed: {self.message}"
        if self.outcome == COMPLETED or self.time is None:
            return self.outcome
        return str(Outcome(self.outcome, self.time))

    @property
    def margin(self) -> float | None:
        """The least margin of a run that completed; None if it has none."""
        return least_margin(self.requirements) if self.outcome == COMPLETED else None

    def severity(self, scenario: Scenario) -> float:
        """Return how bad it was: up to 1 if it passed, from 1 on if it did not.

        Of a run that completed it is the share of the tightest limit that is used up, 1 + x / (1 +
        x) if the limit is exceeded by a share x; without requirements, the mean of its largest and
        its average deviation as shares of that which ends a run, in bands where none does. A run
        that ended early comes after all of these, the earlier the worse, a controller that failed
        last.
        """
        duration = scenario.duration
        if self.outcome == CONTROLLER_FAILED:
            return 3.0
        if self.failure == self.outcome:
            return 3.0 - (self.time or 0.0) / duration
        tightest = self._robustness
        if tightest is None:
            names = scenario.plant.coordinates
            away = max(self._away(name, duration) / scenario.band(name) for name in names)
            ends = [self._away(name, duration) / end for name, end in scenario.ends_at.items()]
            return max(ends) if ends else away / (1.0 + away)
        return 1.0 - tightest if tightest >= 0.0 else 1.0 - tightest / (1.0 - tightest)

    def _away(self, name: str, duration: float) -> float:
        """Return the mean of the largest and the average deviation."""
        mean = (self.metrics[f"iae_{name}"] or 0.0) / duration
        return 0.5 * ((self.metrics[f"peak_{name}"] or 0.0) + mean)

    @property
    def _robustness(self) -> float | None:
        """The least margin for a search: what never settles has a graded one there."""
        if self.outcome != COMPLETED:
            return None
        found = [
            one.graded if one.margin is None else one.margin
            for one in self.requirements
            if one.requirement != "completes"
        ]
        return min((x for x in found if x is not None), default=None)

    @property
    def row(self) -> dict[str, Any]:
        """The run as one flat row, as the result files and pandas have it."""
        apart = ("metrics", "message", "requirements")
        named = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in apart}
        judged = [{**asdict(one), "met": one.met} for one in self.requirements]
        return {**named, **self.metrics, "message": self.message, "requirements": judged}


def run_all(
    controller: Controller,
    scenarios: Sequence[Scenario],
    deployed: Deployed = DEFAULT,
    *,
    threads: int = 1,
) -> list[Run]:
    """Run a controller on scenarios as deployed; one that computes no force fails its own run."""
    return [run for run, _ in run_kept(controller, scenarios, deployed, threads, keep=False)]


def run_kept(
    controller: Controller,
    scenarios: Sequence[Scenario],
    deployed: Deployed = DEFAULT,
    threads: int = 1,
    *,
    keep: bool = True,
) -> list[tuple[Run, Trajectory | None]]:
    """Do the same, and keep the trajectories; a run whose controller fails has none."""
    from afl_mujoco.control.catalogue import GainError
    from afl_mujoco.control.own import ControllerError
    from afl_mujoco.errors import AflMujocoError
    from afl_mujoco.simulation.sampled.rollouts import roll_out  # not before MuJoCo may be imported

    caught = (ControllerError, GainError)
    found = roll_out(scenarios, controller, deployed, threads=threads, keep=keep, caught=caught)
    return [
        (_failed(scenario, controller, str(one)), None)
        if isinstance(one, AflMujocoError)
        else (_of_rollout(scenario, controller, one), one.trajectory)
        for scenario, one in zip(scenarios, found, strict=True)
    ]


def run_of(scenario: Scenario, controller: Controller, run: Trajectory) -> Run:
    """Return the row of a run that any simulator made."""
    stops = criterion_of(scenario).stops
    reached = (np.abs(run.state[:, : len(stops)]) >= stops).any(axis=1)
    figures = run.metrics | {"settling_time": settling_time(scenario, run)}
    stopped, asked = float(run.time[np.argmax(reached)]), judge(scenario, run)
    return _row(scenario, controller, run.outcome, asked, figures, stopped)


def numbered(runs: Iterable[Run]) -> list[Run]:
    """Return runs with their number as their draw."""
    return [replace(run, draw=number) for number, run in enumerate(runs)]


def _of_rollout(scenario: Scenario, controller: Controller, run: Rollout) -> Run:
    figures = {name: x if math.isfinite(x) else None for name, x in run.figures.items()}
    if run.outcome.kind != COMPLETED:  # a part of the horizon cannot be compared
        figures |= dict.fromkeys(name for name in figures if name.startswith("iae_"))
    stopped = figures["stop_time"]
    return _row(scenario, controller, run.outcome, run.requirements, figures, stopped)


def _row(
    scenario: Scenario,
    controller: Controller,
    outcome: Outcome,
    requirements: tuple[Judgement, ...],
    figures: Mapping[str, float | None],
    stopped: float | None,
) -> Run:
    """Return the row of a run; `stopped` is when it reached an end stop, if it did [s]."""
    failure = failure_of(outcome.kind, requirements)
    return Run(
        scenario=scenario.name,
        controller=controller.name,
        outcome=outcome.kind,
        failure=failure,
        settled=figures["settling_time"] is not None,
        time=stopped if failure == "end_stops" else outcome.time,
        metrics={name: figures.get(name) for name in columns_of(scenario.plant)},
        requirements=requirements,
    )


def _failed(scenario: Scenario, controller: Controller, message: str) -> Run:
    """Return the row of a run whose controller computed no force."""
    return Run(
        scenario=scenario.name,
        controller=controller.name,
        outcome=CONTROLLER_FAILED,
        failure=CONTROLLER_FAILED,
        settled=False,
        time=None,
        metrics=dict.fromkeys(columns_of(scenario.plant)),
        requirements=judge_failure(scenario),
        message=message.removeprefix(f"controller {controller.name!r}").strip().removeprefix(": "),
    )


def _to_rows(runs: Sequence[Run]) -> list[dict[str, Any]]:
    return [run.row for run in runs]


@cache
def _adapter() -> TypeAdapter[tuple[Run, ...]]:
    return TypeAdapter(tuple[Run, ...])


def _from_rows(rows: Any) -> tuple[Run, ...]:
    """Return runs from flat rows, whose keys that a run does not have are its metrics."""
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise ValueError("must be a list of objects")
    known = {one.name for one in fields(Run)}
    nested = [{**row, "metrics": {k: x for k, x in row.items() if k not in known}} for row in rows]
    try:
        return _adapter().validate_python(nested)
    except ValidationError as error:
        first = error.errors()[0]
        raise ValueError(f"{first['msg']} at {'.'.join(map(str, first['loc']))}") from None


Rows = Annotated[tuple[Run, ...], PlainSerializer(_to_rows), PlainValidator(_from_rows)]
"""A field of a result that holds runs, in its file one flat row for each."""
