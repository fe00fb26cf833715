"""An identified cart-pole as a scenario, and a simulated run as a log."""

from __future__ import annotations

import re
from dataclasses import asdict, replace
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
from afl_mujoco.identification.identify import Identified
from afl_mujoco.identification.log import write_log
from afl_mujoco.identification.rig import model_of, physical
from afl_mujoco.scenario.belief import ERROR
from afl_mujoco.scenario.requirements import Requirements
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.mujoco_model import SimulatedModel, write_state
from afl_mujoco.simulation.sampled.hardware import new_run, sense, sensors_of
from afl_mujoco.simulation.trajectory import Trajectory

DURATION = 10.0  # duration of the scenario [s]
TILT = 0.1  # initial angle of the pole, and its variation to either side [rad]
UNCERTAIN = 0.5  # relative half-width of an interval from which nothing is drawn
NORMAL = 1.959964  # half-width of an interval of 95 % in standard errors


def certain(identified: Identified) -> bool:
    """Return whether masses and forces are known well enough to draw cart-poles from them."""
    return all(
        not one.on_bound and one.high - one.value < UNCERTAIN * abs(one.value)
        for one in map(identified.find, ("mass_ratio", "gain", "gravity_term"))
    )


def scenario_of(identified: Identified) -> Scenario:
    """Return the scenario of an identified cart-pole, with a pole that leans a little at the start.

    Its imperfections are the estimates, its ranges their intervals; M and l are the estimates, and
    the values that a controller assumes are off by up to their intervals.
    """
    base = with_values(identified, identified.values)
    found = {one.name: one for one in identified.physical}
    whole = found["cart_mass"].value + identified.description.nominal.pole_mass
    decay, dry = (  # at the M of the file: forces are proportional to masses
        replace(of, low=whole * of.low, high=whole * of.high)
        for of in map(identified.find, ("decay", "dry_deceleration"))
    )
    estimates = {
        "damping.phi": found["hinge_damping"], "dry_friction.phi": found["hinge_friction"],
        "damping.z": decay, "dry_friction.z": dry,
        "delay": identified.find("delay"), "lag": identified.find("lag"),
    }  # fmt: skip
    varied = {"phi": (-TILT, TILT)} | {
        path: (max(0.0, one.low), max(0.0, one.high))
        for path, one in estimates.items()
        if not one.on_bound
    }
    for known in ("cart_mass", "half_length"):
        share = (found[known].high - found[known].value) / found[known].value
        varied[f"{known}{ERROR}"] = (-min(share, 0.9), share)

    return replace(base, ranges=varied)


def with_values(identified: Identified, values: dict[str, float]) -> Scenario:
    """Return the scenario of a cart-pole with some values of its parameters."""
    identified.scatter()  # raises without a drive
    d = identified.description
    plant, friction = model_of(values, d)
    rail, limit = d.nominal.rail_half_length, d.command.limit
    return Scenario(
        name=re.sub(r"[^a-z0-9]+", "-", d.name.lower()).strip("-") or "identified",
        duration=DURATION,
        initial_state=(0.0, TILT, 0.0, 0.0),
        schedule=asdict(plant),
        imperfections=replace(
            friction,
            control_period=d.period,
            delay=max(0.0, values["delay"]),
            lag=max(0.0, values["lag"]),
            input_limit=None if limit is None else physical(values, d)["force"] * limit,
            encoder_step={"z": d.z.count, "phi": values.get("angle_scale", 1.0) * d.phi.count},
            differentiated=d.z.count > 0.0 and d.phi.count > 0.0,
            end_stops={} if rail is None else {"z": rail},
        ),
        requirements=Requirements(max={} if rail is None else {"z": rail}),
    )


def draws(identified: Identified, count: int, seed: int) -> list[Scenario]:
    """Return cart-poles drawn from the estimates: normal, with the correlations in each step.

    A controller assumes the estimates of M and l, not the values drawn. A quantity that cannot be
    negative is zero if a negative value is drawn. The pole leans by up to `TILT`.
    """
    generator = np.random.default_rng(seed)
    tilts = generator.uniform(-TILT, TILT, count)
    drawn: list[dict[str, float]] = [{} for _ in range(count)]
    for step in identified.steps:
        names = [one.name for one in step.estimates]
        mean = np.array([one.value for one in step.estimates])
        errors = np.array([(one.high - one.low) / (2.0 * NORMAL) for one in step.estimates])
        covariance = np.array(step.correlations) * np.outer(errors, errors)
        rows = generator.multivariate_normal(mean, covariance, count)
        for values, row in zip(drawn, rows.tolist(), strict=True):
            values.update(zip(names, row, strict=True))
    assumed = with_values(identified, identified.values).parameters_at(0.0)
    return [
        replace(
            with_values(identified, {**values, "mass_ratio": max(values["mass_ratio"], 1e-4)}),
            name=f"draw-{i:04d}",
            initial_state=(0.0, tilt, 0.0, 0.0),
            belief={"cart_mass": assumed.cart_mass, "half_length": assumed.half_length},
        )
        for i, (values, tilt) in enumerate(zip(drawn, tilts.tolist(), strict=True))
    ]


def require_loggable(scenario: Scenario, controller: Controller, simulator: str) -> None:
    """Raise unless a run can be a log: sampled, without an estimator; a cart-pole is constant."""
    if simulator != "sampled":
        raise InvalidValueError("simulator", "must be sampled for a log", repr(simulator))
    if controller.estimates:
        rule = "must not use the estimator"
        raise InvalidValueError("controller of a log", rule, controller.name)
    if not scenario.is_cart_pole:
        return
    if len({*scenario.cart_mass.values}) > 1 or len({*scenario.half_length.values}) > 1:
        raise InvalidValueError("scenario of a log", "must keep M and l constant", scenario.name)


def write_run(scenario: Scenario, run: Trajectory, folder: Path, stem: str) -> list[Path]:
    """Write a sampled run as a log, of a cart-pole with its description; return the files.

    The readings are those that the controller got, with the noise and resolution of its sensors.
    The commands are those that it gave, cut off at the limits of the inputs, before any delay or
    lag of the drives.
    """
    settings, plant = run.provenance["settings"], scenario.plant
    period, r = settings["control_period"], scenario.imperfections
    hold, sensors = round(period / settings["timestep"]), sensors_of(scenario, period)
    n, k = len(plant.coordinates), len(plant.inputs)
    model, run_state = SimulatedModel(plant), new_run(n, k)
    steps = range(0, len(run.time) - 1, hold)
    readings = np.empty((len(steps), n))
    for tick, step in enumerate(steps):
        write_state(model.addresses, run.state[step].copy())
        sense(model.addresses, sensors, run_state, tick)
        readings[tick] = run_state.measured[:n]
    commands = np.clip(run.command[steps].reshape(len(steps), k), *scenario.limits.T)
    files = [folder / f"{stem}-log.csv", folder / f"{stem}-log.toml"]
    names = ("time", *plant.coordinates, *plant.inputs)
    columns = dict(zip(names, [run.time[steps], *readings.T, *commands.T], strict=True))
    if not scenario.is_cart_pole:
        write_log(files[0], columns)
        return files[:1]
    own = {"time": "time", "phi": "phi", "z": "z", "command": "force"}
    write_log(files[0], {name: columns[of] for name, of in own.items()})
    described = Description(
        name=scenario.name,
        period=period,
        phi=AngleColumn(resolution=r.at("encoder_step.phi")),
        z=PositionColumn(resolution=r.at("encoder_step.z")),
        command=CommandColumn(limit=r.input_limit),
        nominal=Nominal(
            **asdict(scenario.parameters_at(0.0)),
            force=1.0,
            hinge_damping=r.at("damping.phi"),
            rail_damping=r.at("damping.z"),
            rail_half_length=scenario.rail,
        ),
    )
    write_text(files[1], tomli_w.dumps(to_table(described)))
    return files
