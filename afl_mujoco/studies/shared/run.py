"""One run of one controller on one scenario, judged: the row of every study."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import PlainSerializer, PlainValidator, TypeAdapter, ValidationError

from afl_mujoco.control.catalogue import GainError
from afl_mujoco.control.controller import Controller
from afl_mujoco.control.own import ControllerError
from afl_mujoco.errors import InvalidValueError, require_count
from afl_mujoco.plants.plant import Plant
from afl_mujoco.pool import MOST_WORKERS, on_threads
from afl_mujoco.scenario.files import as_scenarios
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.time_steps import DEFAULT, Deployed
from afl_mujoco.simulation.bound_controllers import bound
from afl_mujoco.simulation.judgement import (
    CONTROLLER_FAILED,
    Judgement,
    failure_of,
    judge,
    judge_failure,
    least_margin,
    settling_time,
    stops_of,
)
from afl_mujoco.simulation.trajectory import COMPLETED, Outcome, Trajectory, effort_names


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
    """One run, judged: the row of every table.

    Attributes
    ----------
    scenario, controller
        Their names.
    draw
        Which draw of noise and start it is, or the number of the sample or the start, from 0.
    outcome
        ``"completed"``, ``"fell"``, ``"diverged"`` or ``"controller failed"``.
    failure
        How it failed: how it ended early, else the requirement with the least margin; empty if it
        met every requirement.
    settled
        Whether it was within its bands for the last second at least, required or not.
    time
        When it ended, or reached the end stop if that is its failure [s].
    metrics
        Largest deviations and integrals of their magnitudes by coordinate, largest commands and
        inputs, settling time; None for a missing one.
    requirements
        How it meets each requirement of its scenario.
    message
        What a controller that computed no force said.
    """

    scenario: str
    controller: str
    draw: int = 0
    outcome: str
    failure: str
    settled: bool
    time: float | None
    metrics: Mapping[str, float | None]
    requirements: tuple[Judgement, ...]
    message: str = ""

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
    controller: Any,
    scenarios: Scenario | str | Path | Sequence[Scenario | str | Path],
    deployed: Deployed = DEFAULT,
    *,
    threads: int = 1,
) -> list[Run]:
    """Run a controller on scenarios, each as `simulate_mujoco` does in sampled mode, and judge it.

    A run depends on its scenario alone, which includes its seed: it is the same to the last bit
    with any other runs, on any number of threads, and in `simulate_mujoco` with the same settings.

    Parameters
    ----------
    controller, scenarios
        As `simulate_mujoco` takes them; one scenario, or several.
    deployed
        MuJoCo's integrator, its step [s], and the control period [s] of scenarios that have none.
    threads
        Number of threads, each with its own model. A single thread is that of the caller; so is
        that of a Python controller, which can be stopped there if it hangs.

    Returns
    -------
    list of Run
        A row for each; a controller that computes no force fails its own run.

    Raises
    ------
    AflMujocoError
        If there is no scenario, controller or integrator of that name, or a number breaks its rule.

    Examples
    --------
    >>> import afl_mujoco as afl
    >>> [run.outcome for run in afl.run_all("lqr", ["nominal", "step-step"])]
    ['completed', 'completed']
    """
    from afl_mujoco.control.catalogue import as_controller

    own, asked = as_controller(controller), as_scenarios(scenarios)
    return [run for run, _ in run_kept(own, asked, deployed, threads, keep=False)]


def run_kept(
    controller: Controller,
    scenarios: Sequence[Scenario],
    deployed: Deployed = DEFAULT,
    threads: int = 1,
    *,
    keep: bool = True,
) -> list[tuple[Run, Trajectory | None]]:
    """Do the same, and keep the trajectories; a run whose controller fails has none."""
    from afl_mujoco.simulation.mujoco_model import SimulatedModel
    from afl_mujoco.simulation.sampled.runs import simulate_sampled

    models: dict[tuple[int, Plant], SimulatedModel] = {}  # of each thread

    def made(scenario: Scenario) -> tuple[Run, Trajectory | None]:
        plant = threading.get_ident(), scenario.plant
        if (model := models.get(plant)) is None:
            models[plant] = model = SimulatedModel(scenario.plant, integrator=deployed.integrator)
        model.set_imperfections(scenario.imperfections)
        model.compute_only()
        try:
            run = simulate_sampled(scenario, bound(controller, scenario), deployed, model=model)
        except (ControllerError, GainError) as error:
            return _failed(scenario, controller, str(error)), None
        return run_of(scenario, controller, run), run if keep else None

    require_count("threads", threads, 1, MOST_WORKERS)
    alone = controller.interpreted  # threads do not speed it up; here it can be stopped
    return on_threads(made, scenarios, 1 if alone else min(threads, max(len(scenarios), 1)))


def require_alike(controller: Controller, scenario: Scenario, run: Run, deployed: Deployed) -> None:
    """Raise if a controller in Python does not repeat a run after it has made others.

    What it keeps outside itself, or draws without a seed, would make results depend on which
    process makes which run. One that computed no force is not judged: a call may be too slow once.
    """
    if not controller.interpreted:
        return
    (again,) = run_all(controller, [scenario], deployed)
    ended = {run.outcome, again.outcome}
    if CONTROLLER_FAILED not in ended and replace(again, draw=run.draw) != run:
        rule = "must make the same run each time, but keeps something from run to run, or draws "
        rule += "without a seed: make it a class, whose instances make one run each"
        raise InvalidValueError(f"controller {controller.name!r}", rule)


def run_of(scenario: Scenario, controller: Controller, run: Trajectory) -> Run:
    """Return the row of a run that any simulator made."""
    requirements, ended = judge(scenario, run), run.outcome.time
    failure = failure_of(run.outcome.kind, requirements)
    if failure == "end_stops":  # when it reached one
        stops = stops_of(scenario)
        low, high = np.array([*stops.values()]).T
        at = run.state[:, [*stops]]
        ended = float(run.time[np.argmax(((at <= low) | (at >= high)).any(axis=1))])
    settled = settling_time(scenario, run)
    figures = {**run.metrics, "settling_time": settled}
    return Run(
        scenario=scenario.name,
        controller=controller.name,
        outcome=run.outcome.kind,
        failure=failure,
        settled=settled is not None,
        time=ended,
        metrics={name: figures.get(name) for name in columns_of(scenario.plant)},
        requirements=requirements,
    )


def numbered(runs: Iterable[Run]) -> list[Run]:
    """Return runs with their number as their draw."""
    return [replace(run, draw=number) for number, run in enumerate(runs)]


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
