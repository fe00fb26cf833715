"""Many sampled runs on several threads: how each ended and a few figures, not the whole run."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from afl_mujoco.control.controller import Controller
from afl_mujoco.errors import AflMujocoError, require_count
from afl_mujoco.plants.plant import Plant
from afl_mujoco.pool import MOST_WORKERS, Task, share
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.time_steps import SNAP, Deployed
from afl_mujoco.simulation.bound_controllers import bound
from afl_mujoco.simulation.judgement import DWELL, Judgement, judge
from afl_mujoco.simulation.metrics import effort_names
from afl_mujoco.simulation.mujoco_model import SimulatedModel
from afl_mujoco.simulation.sampled.hardware import RunState
from afl_mujoco.simulation.sampled.runs import Timing, perform, prepare, recorded, timing_of
from afl_mujoco.simulation.trajectory import COMPLETED, OUTCOMES, Outcome, Trajectory


class Rollout(NamedTuple):
    """One run: how it ended, its figures by name, how it meets its requirements."""

    outcome: Outcome
    # largest deviations, integrals of their magnitudes, largest commands and inputs, the time from
    # which it was settled and that at which it reached an end stop; None for a missing one
    figures: dict[str, float | None]
    requirements: tuple[Judgement, ...]
    trajectory: Trajectory | None  # where it is kept


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
        done, rows = perform(model, prepare(model, scenario, own, timing), own)
        whole = recorded(scenario, own, timing, done, rows, deployed.integrator)
        figures, judged = _figures(plant, done, timing), judge(scenario, whole)
        return Rollout(whole.outcome, figures, judged, whole if keep else None)

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


def _figures(plant: Plant, run: RunState, timing: Timing) -> dict[str, float | None]:
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
    found["stop_time"] = float(times[stopped]) if stopped >= 0 else math.nan
    if not completed:  # a part of the horizon cannot be compared
        found |= dict.fromkeys((f"iae_{name}" for name in plant.coordinates), math.nan)
    return {name: x if math.isfinite(x) else None for name, x in found.items()}
