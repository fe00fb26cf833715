"""Many sampled runs on several threads: how each ended and a few figures, not the whole run."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.catalogue import as_controller
from afl_mujoco.control.controller import Controller
from afl_mujoco.errors import AflMujocoError, require_count
from afl_mujoco.plants.plant import Plant
from afl_mujoco.pool import MOST_WORKERS, Task, share
from afl_mujoco.scenario.files import as_scenarios
from afl_mujoco.scenario.requirements import NONE
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.time_steps import SNAP, Deployed
from afl_mujoco.simulation.bound_controllers import bound
from afl_mujoco.simulation.judgement import DWELL, Judgement, failure_of, judge, judge_ending
from afl_mujoco.simulation.metrics import effort_names
from afl_mujoco.simulation.mujoco_model import SimulatedModel
from afl_mujoco.simulation.sampled.hardware import RunState
from afl_mujoco.simulation.sampled.runs import Timing, perform, prepare, recorded, timing_of
from afl_mujoco.simulation.trajectory import COMPLETED, OUTCOMES, Outcome, Trajectory


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rollouts:
    """Outcomes of many runs; every array has one entry per run, in the order of the scenarios.

    Attributes
    ----------
    status
        How each ended: 0 completed, 1 fell, 2 diverged.
    end_time
        When it ended [s].
    figures
        Figures by name, also attributes: of each coordinate the largest deviation (`peak_z` [m],
        `peak_phi` [rad]) and the integral of its magnitude (`iae_z` [m s], `iae_phi` [rad s]) up to
        then; of each input the largest that was asked for and exerted (`max_command`, `max_force`
        [N]); `settling_time` [s], from which the coordinates stayed within their bands, NaN if that
        is less than a second before the end or the run did not complete; `stop_time` [s], when a
        coordinate first reached an end stop, NaN if none did.
    requirements
        How each run meets the requirements of its scenario.
    """

    status: NDArray[np.int64]
    end_time: NDArray[np.float64]
    figures: Mapping[str, NDArray[np.float64]]
    requirements: tuple[tuple[Judgement, ...], ...]

    def __getattr__(self, name: str) -> NDArray[np.float64]:
        if name.startswith("_") or name not in self.figures:
            raise AttributeError(name)
        return self.figures[name]

    def __len__(self) -> int:
        return len(self.status)

    def outcome(self, index: int) -> Outcome:
        """Return how one run ended.

        Parameters
        ----------
        index
            Its index.
        """
        return Outcome(OUTCOMES[int(self.status[index])], float(self.end_time[index]))

    def failure(self, index: int) -> str:
        """Return how one run failed, from `failure_of`; empty if it met every requirement.

        Parameters
        ----------
        index
            Its index.
        """
        return failure_of(OUTCOMES[int(self.status[index])], self.requirements[index])

    def settled(self, index: int) -> bool:
        """Return whether one run settled, required or not.

        Parameters
        ----------
        index
            Its index.
        """
        return bool(np.isfinite(self.settling_time[index]))


class Rollout(NamedTuple):
    """One run: how it ended, its figures by name, how it meets its requirements."""

    outcome: Outcome
    figures: dict[str, float]  # those of `Rollouts`, NaN for a missing one
    requirements: tuple[Judgement, ...]
    trajectory: Trajectory | None  # where it is kept


def run_rollouts(
    scenarios: Scenario | str | Path | Sequence[Scenario | str | Path],
    controller: Any,
    *,
    timestep: float | None = None,
    control_period: float | None = None,
    integrator: str = "RK4",
    threads: int = 1,
) -> Rollouts:
    """Run one controller on many scenarios, each as `simulate_mujoco` does in sampled mode.

    A run depends on its scenario alone, which includes its seed: it is the same to the last bit
    with any other runs, on any number of threads, and in `simulate_mujoco` with the same settings.

    Parameters
    ----------
    scenarios
        One or several, with their imperfections.
    controller
        The controller; both as `simulate_mujoco` takes them.
    timestep, control_period, integrator
        As in `simulate_mujoco`.
    threads
        Number of threads, each with its own model. A single thread is that of the caller; so is
        that of a Python controller, which can be stopped there if it hangs.

    Returns
    -------
    Rollouts
        Their outcomes.

    Raises
    ------
    UnknownNameError
        If there is no scenario, controller or integrator of that name.
    InvalidValueError
        If `threads` is no whole number from 1, or the step is not positive or does not divide the
        control period.

    Examples
    --------
    >>> import afl_mujoco as afl
    >>> afl.run_rollouts(["nominal", "step-step"], "lqr").status  # 0: completed
    array([0, 0])
    """
    controller, asked = as_controller(controller), as_scenarios(scenarios)
    deployed = Deployed(integrator, timestep, control_period)
    found = roll_out(asked, controller, deployed, threads=threads)
    runs = [one for one in found if isinstance(one, Rollout)]
    names = runs[0].figures if runs else ()
    return Rollouts(
        status=np.array([OUTCOMES.index(run.outcome.kind) for run in runs], dtype=np.int64),
        end_time=np.array([run.outcome.time for run in runs]),
        figures={name: np.array([run.figures[name] for run in runs]) for name in names},
        requirements=tuple(run.requirements for run in runs),
    )


def roll_out(
    scenarios: Sequence[Scenario],
    controller: Controller,
    deployed: Deployed,
    *,
    threads: int = 1,
    keep: bool = False,
    caught: tuple[type[AflMujocoError], ...] = (),
) -> list[Rollout | AflMujocoError]:
    """Return runs, with `keep` their trajectories too, or the errors that are caught."""
    require_count("threads", threads, 1, MOST_WORKERS)
    found: list[Any] = [None] * len(scenarios)

    def run(models: dict[Plant, SimulatedModel], scenario: Scenario) -> Rollout:
        plant = scenario.plant
        if plant not in models:
            models[plant] = SimulatedModel(plant, integrator=deployed.integrator)
        model = models[plant]
        model.set_imperfections(scenario.imperfections)
        model.compute_only()
        own, timing = bound(controller, scenario), timing_of(scenario, model, deployed)
        asked, whole = scenario.requirements != NONE, None
        prepared = prepare(model, scenario, own, timing)
        done, rows = perform(model, prepared, own, record=keep or asked)
        status, step = int(done.marks["status"]), int(done.marks["step"])
        ended = Outcome(OUTCOMES[status], float(timing.times[step]))
        if keep or asked:
            whole = recorded(scenario, own, timing, done, rows, deployed.integrator)
        if asked and whole is not None:
            judged = judge(scenario, whole)
        else:  # which needs no record
            judged = judge_ending(scenario, ended, done.peak.tolist())
        return Rollout(ended, _figures(plant, done, timing), judged, whole if keep else None)

    def task_on(models: dict[Plant, SimulatedModel]) -> Task:
        def run_part(part: slice) -> None:
            for i in range(part.start, part.stop):
                try:
                    found[i] = run(models, scenarios[i])
                except caught as error:
                    found[i] = error

        return run_part

    alone = controller.interpreted  # threads do not speed it up; here it can be stopped
    count = 1 if alone else min(threads, max(len(scenarios), 1))
    tasks = [task_on({}) for _ in range(count)]
    share(len(scenarios), tasks, part=1)
    return found


def _figures(plant: Plant, run: RunState, timing: Timing) -> dict[str, float]:
    marks, times = run.marks, timing.times
    steps, settled, stopped = (int(marks[name]) for name in ("step", "unsettled", "at_stop"))
    dwelled = settled <= steps and times[steps] - times[settled] >= DWELL - SNAP * timing.timestep
    completed = OUTCOMES[int(marks["status"])] == COMPLETED
    found = {f"peak_{name}": float(x) for name, x in zip(plant.coordinates, run.peak, strict=True)}
    for name, drive in zip(plant.inputs, run.drive, strict=True):
        command, force, *_ = effort_names(plant.inputs, name)
        found[command], found[force] = float(drive["max_command"]), float(drive["max_force"])
    found |= {f"iae_{name}": float(x) for name, x in zip(plant.coordinates, run.iae, strict=True)}
    found["settling_time"] = float(times[settled]) if completed and dwelled else math.nan
    return {**found, "stop_time": float(times[stopped]) if stopped >= 0 else math.nan}
