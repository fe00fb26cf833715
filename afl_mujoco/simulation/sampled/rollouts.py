"""Many sampled runs on several threads, each made into what is kept of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from afl_mujoco.control.controller import Controller
from afl_mujoco.errors import AflMujocoError, require_count
from afl_mujoco.plants.plant import Plant
from afl_mujoco.pool import MOST_WORKERS, Task, share
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.time_steps import Deployed
from afl_mujoco.simulation.bound_controllers import bound
from afl_mujoco.simulation.mujoco_model import SimulatedModel
from afl_mujoco.simulation.sampled.runs import perform, prepare, recorded, timing_of
from afl_mujoco.simulation.trajectory import COMPLETED, Trajectory

Row = TypeVar("Row")


def roll_out(
    scenarios: Sequence[Scenario],
    controller: Controller,
    deployed: Deployed,
    row: Callable[[Scenario, Trajectory, Mapping[str, float]], Row],
    *,
    threads: int = 1,
    caught: tuple[type[AflMujocoError], ...] = (),
) -> list[Row | AflMujocoError]:
    """Return what `row` makes of each run, or the error that is caught.

    row: Called with a scenario, its run, and the integrals that the loop summed up along it.
    """
    require_count("threads", threads, 1, MOST_WORKERS)
    found: list[Any] = [None] * len(scenarios)

    def run(models: dict[Plant, SimulatedModel], scenario: Scenario) -> Row:
        plant = scenario.plant
        if plant not in models:
            models[plant] = SimulatedModel(plant, integrator=deployed.integrator)
        model = models[plant]
        model.set_imperfections(scenario.imperfections)
        model.compute_only()
        own, timing = bound(controller, scenario), timing_of(scenario, model, deployed)
        done, rows = perform(model, prepare(model, scenario, own, timing), own)
        whole = recorded(scenario, own, timing, done, rows, deployed.integrator)
        completed = whole.outcome.kind == COMPLETED  # a part of the horizon cannot be compared
        integrals = zip(plant.coordinates, done.iae.tolist(), strict=True)
        return row(scenario, whole, {f"iae_{x}": y for x, y in integrals} if completed else {})

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
