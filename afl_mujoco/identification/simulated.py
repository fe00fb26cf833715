"""A simulated run as the log that its hardware would write."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import tomli_w

from afl_mujoco.control.controller import Controller
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.files import write_text
from afl_mujoco.identification.description import (
    AngleColumn,
    CommandColumn,
    Description,
    Nominal,
    PositionColumn,
    to_table,
)
from afl_mujoco.identification.log import write_log
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.mujoco_model import CartPoleModel, write_state
from afl_mujoco.simulation.sampled.hardware import new_run, sense, sensors_of
from afl_mujoco.simulation.trajectory import Trajectory


def require_loggable(scenario: Scenario, controller: Controller, simulator: str) -> None:
    """Raise unless a run can be a log: in sampled mode, with constant M and l and no estimator."""
    if simulator != "sampled":
        raise InvalidValueError("simulator", "must be sampled for a log", repr(simulator))
    if controller.estimates:
        raise InvalidValueError(
            "controller of a log", "must not use the estimator", controller.name
        )
    if len({*scenario.cart_mass.values}) > 1 or len({*scenario.half_length.values}) > 1:
        raise InvalidValueError("scenario of a log", "must keep M and l constant", scenario.name)


def write_run(scenario: Scenario, run: Trajectory, folder: Path, stem: str) -> list[Path]:
    """Write a sampled run as a log and its description; return the two files.

    The readings are those that the controller got, with the noise and resolution of its sensors.
    The commands are those that it gave, cut off at the force limit, before any delay or lag of the
    drive.
    """
    settings = run.provenance["settings"]
    period, r = settings["control_period"], scenario.imperfections
    hold, sensors = round(period / settings["timestep"]), sensors_of(r, period)
    model, memory, rows = CartPoleModel(scenario.parameters_at(0.0)), new_run(), []
    for tick, k in enumerate(range(0, len(run.time) - 1, hold)):
        write_state(model.addresses, *run.state[k].tolist())
        seen = sense(model.addresses, sensors, memory, tick)
        rows.append((run.time[k], seen[1], seen[0], run.command[k]))
    columns = np.array(rows).reshape(len(rows), 4).T
    if r.force_limit is not None:
        columns[3] = np.clip(columns[3], -r.force_limit, r.force_limit)
    files = [folder / f"{stem}-log.csv", folder / f"{stem}-log.toml"]
    limit = scenario.imperfections.force_limit
    described = description_of(scenario, period, limit or _above(columns[3]))
    write_log(files[0], *columns)
    write_text(files[1], tomli_w.dumps(to_table(described)))
    return files


def description_of(scenario: Scenario, period: float, limit: float) -> Description:
    """Return the description of a log of a scenario and its cart-pole.

    period: Time between two rows [s].
    limit: Largest command [N].
    """
    r, plant = scenario.imperfections, scenario.parameters_at(0.0)
    return Description(
        name=scenario.name,
        period=period,
        phi=AngleColumn(resolution=r.encoder_step_phi),
        z=PositionColumn(resolution=r.encoder_step_z),
        command=CommandColumn(limit=limit),
        nominal=Nominal(
            pole_mass=plant.pole_mass,
            half_length=plant.half_length,
            cart_mass=plant.cart_mass,
            force=1.0,
            hinge_damping=r.hinge_damping,
            rail_damping=r.rail_damping,
            rail_half_length=r.rail_half_length,
            gravity=plant.gravity,
        ),
    )


def _above(commands: np.ndarray) -> float:
    """Return a limit that no command exceeds."""
    return float(np.abs(commands).max(initial=0.0)) or 1.0
