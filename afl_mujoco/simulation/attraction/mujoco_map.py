"""The map of attraction in MuJoCo, as deployed: `mj_step`, the control held over each step."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from afl_mujoco.compiled import kernel
from afl_mujoco.control.controller import Controller
from afl_mujoco.execution.threads import Task, require_threads, share
from afl_mujoco.scenario.imperfections import IDEAL
from afl_mujoco.scenario.parameters import NOMINAL
from afl_mujoco.scenario.sampling import whole_steps
from afl_mujoco.simulation.attraction.grid import (
    FALLEN,
    FOUND,
    SETTLED,
    UNDECIDED,
    AttractionMap,
    Grid,
    Settling,
)
from afl_mujoco.simulation.mujoco_model import CartPoleModel
from afl_mujoco.simulation.sampled.hardware import (
    RECORD,
    RUNNING,
    actuator_of,
    new_run,
    no_commands,
    sensors_of,
)
from afl_mujoco.simulation.sampled.loop import PROFILE, Criterion, Plan, run_to_end
from afl_mujoco.simulation.sampled.loop import SETTLED as ENDED_SETTLED
from afl_mujoco.simulation.trajectory import COMPLETED, FALL_ANGLE, OUTCOMES

_COMPLETED = OUTCOMES.index(COMPLETED)

TIMESTEP = 2e-3
"""Physics step, and how long the control is held [s]."""


def map_in_mujoco(
    grid: Grid,
    controller: Controller,
    *,
    settling: Settling | None = None,
    timestep: float = TIMESTEP,
    integrator: str = "RK4",
    threads: int = 1,
    progress: Callable[[int], None] = lambda points: None,
) -> AttractionMap:
    """Return how MuJoCo's loop, as deployed, ends when started from every grid point.

    Parameters
    ----------
    timestep
        Physics step [s].
    threads
        Threads to share the grid points among, each with a model of its own; the result does not
        depend on their number.
    """
    settling = Settling() if settling is None else settling
    models = [
        CartPoleModel(NOMINAL, timestep=timestep, integrator=integrator)
        for _ in range(require_threads(threads))
    ]
    for model in models:
        model.compute_only(IDEAL)
    plan = Plan(
        steps=whole_steps("horizon", settling.horizon, "timestep", timestep),
        hold=1,
        timestep=timestep,
        last=timestep,
        pole_mass=grid.pole_mass,
        gravity=grid.gravity,
        criterion=Criterion(
            FALL_ANGLE,
            *settling.bands,
            dwell=whole_steps("dwell", settling.dwell, "timestep", timestep),
        ),
    )
    sensors, actuator = sensors_of(IDEAL, timestep), actuator_of(IDEAL, timestep, plan.steps)
    kind = controller.kind  # raises if the controller is not compiled
    masses, lengths = grid.plants.T
    inputs = controller.inputs_along_run(masses, lengths, grid.pole_mass, grid.gravity)
    profiles = np.zeros((len(grid.starts), 1), PROFILE)
    profiles["cart_mass"][:, 0], profiles["half_length"][:, 0] = grid.plants.T
    found = np.empty((len(grid.starts), len(FOUND)))

    def task_on(model: CartPoleModel) -> Task:
        run = new_run()

        def run_part(part: slice) -> None:
            _run_points(
                model.addresses, plan, run, no_commands(actuator), sensors, actuator, kind,
                grid.starts[part], inputs[part], profiles[part], found[part],
            )  # fmt: skip

        return run_part

    share(len(found), [task_on(model) for model in models], progress)
    settings = settling.describe() | {"timestep": timestep, "integrator": integrator}
    return AttractionMap.of(grid, controller.name, "mujoco", settings, found)


@kernel
def _run_points(at, plan, run, pending, sensors, actuator, kind, starts, inputs, profiles, found):
    """Run the rollouts of grid points one after the other and write the results of each.

    Parameters
    ----------
    at, plan, run, pending, sensors, actuator, kind
        As in `loop.run_to_end`; the hardware is ideal except that the force is held, so that it
        carries no state from one run to the next.
    starts
        Initial states, shape (N, 4).
    inputs
        Inputs of the controller on each plant, shape (N, 7) or (N, 8).
    profiles
        The plants, shape (N, 1).
    found
        Takes the results that `FOUND` names, shape (N, 4).
    """
    nothing = np.empty((0, len(RECORD)))
    for i in range(len(starts)):
        run.written_mass, run.status, run.unsettled, run.at_stop = np.nan, RUNNING, 0, -1
        run.peak_z, run.force, run.max_force = 0.0, 0.0, 0.0
        run_to_end(
            at, plan, profiles[i], run, pending, nothing, starts[i], sensors, actuator, kind,
            inputs[i : i + 1],
        )  # fmt: skip
        if run.status == ENDED_SETTLED:
            found[i, 0] = SETTLED
        else:
            found[i, 0] = UNDECIDED if run.status == _COMPLETED else FALLEN
        found[i, 1], found[i, 2], found[i, 3] = run.step * plan.timestep, run.peak_z, run.max_force
