"""What a reader of a run should know that no requirement says."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import numpy as np

from afl_mujoco.control.controller import Controller
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.bound_controllers import plant_model
from afl_mujoco.simulation.trajectory import DIVERGED, STATE_LIMIT, Trajectory


def remarks_on(run: Trajectory, scenario: Scenario, controller: Controller) -> list[str]:
    """Return remarks on a run that no requirement makes, one sentence each."""
    if scenario.is_cart_pole:
        told, at_start = scenario.assumed_plants, scenario.parameters_at(0.0)
        of_plants = (
            *controller.remarks(told),
            *controller.estimator_remarks(at_start, scenario.plants),
        )
    else:
        of_plants = (*_beyond(scenario),)
    return [*of_plants, *_jumps(scenario), *_ended(scenario, run), *_odd(scenario, run)]


def _beyond(scenario: Scenario) -> Iterator[str]:
    """Remark on parameters beyond the bounds within which a plant was checked."""
    spans = zip(scenario.plant.parameters.items(), scenario.spans.values(), strict=True)
    for (name, one), (least, most) in spans:
        if least < (one.low or 0.0) or most > (one.high or 0.0):
            checked = f"but is checked in {one.low:g} to {one.high:g}"
            found = f"is {least:g}" if least == most else f"goes from {least:g} to {most:g}"
            yield f"{name} {found} {one.unit}, {checked}"


def _jumps(scenario: Scenario) -> Iterator[str]:
    """Remark on parameters that jump though their rates act."""
    for name, enters in zip(scenario.plant.parameters, scenario.plant.entering, strict=True):
        schedule = scenario.schedule[name]
        for time in schedule.breakpoints:
            jumps = 0.0 < time < scenario.duration and schedule.at(time) != schedule.before(time)
            if enters and jumps and time not in scenario.joins:
                yield (
                    f"{name} jumps at {time:g} s, which only a ramp can make do work: velocities "
                    "stay"
                )


def _odd(scenario: Scenario, run: Trajectory) -> Iterator[str]:
    """Remark on what the MJCF stops, on a finer step, on nothing that can fail."""
    model = plant_model(scenario.plant, threading.get_ident()).mj_model
    for i, name in enumerate(scenario.plant.coordinates):
        joint = model.joint(name)
        low, high = joint.range
        outside = (run.state[:, i] <= low) | (run.state[:, i] >= high)
        if model.jnt_limited[joint.id] and outside.any():
            yield (
                f"{name} reaches its range in the MJCF, {low:.4g} to {high:.4g} "
                f"{scenario.plant.units[name]}, first at {run.time[np.argmax(outside)]:.3g} s: "
                "MuJoCo stops it there, the equations do not"
            )
    settings = run.provenance.get("settings", {})
    if (asked := settings.get("asked_timestep")) is not None:
        yield (
            f"the physics step is {1e3 * settings['timestep']:.3g} ms: at {1e3 * asked:.3g} ms RK4 "
            "is unstable or inaccurate with these dampers and springs"
        )
    if not scenario.required:
        yield "completes = false and nothing else is required: no run of this scenario can fail"


def _ended(scenario: Scenario, run: Trajectory) -> Iterator[str]:
    """Remark on a command that ends a run."""
    beyond = np.flatnonzero(~(np.abs(run.commands[-1]) < STATE_LIMIT))
    if run.outcome.kind == DIVERGED and beyond.size:
        rule = f"a run ends where a command is not below {STATE_LIMIT:g} or not a number"
        name, value = scenario.plant.inputs[beyond[0]], run.commands[-1][beyond[0]]
        yield f"{name} was {value:g} at {run.outcome.time:.3g} s; {rule}"
