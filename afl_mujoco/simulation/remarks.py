"""What a reader of a run should know that no requirement says."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import numpy as np

from afl_mujoco.control.controller import Controller
from afl_mujoco.scenario.parameters import symbol
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.bound_controllers import plant_model
from afl_mujoco.simulation.metrics import effort_names
from afl_mujoco.simulation.trajectory import DIVERGED, STATE_LIMIT, Trajectory

LONG_WAIT, LONG = 0.05, 0.1
"""Share of a run that nobody means as a delay or a control period, if it is so long [s]."""


def remarks_on(run: Trajectory, scenario: Scenario, controller: Controller) -> list[str]:
    """Return remarks on a run that no requirement makes, one sentence each."""
    of_plants = controller.remarks(scenario) if scenario.is_cart_pole else _beyond(scenario)
    own = scenario.imperfections
    return [
        *of_plants,
        *_prescribed(scenario),
        *(
            f"{path} has no effect, because velocities are differentiated"
            for path in own.departing()
            if own.without_effect(path)
        ),
        *unit_remarks(scenario, run.control_period),
        *_ended(scenario, run),
        *_stopped(scenario, run),
        *_limited(scenario, run),
        *_odd(scenario, run),
    ]


def _beyond(scenario: Scenario) -> Iterator[str]:
    """Remark on parameters beyond the bounds within which a plant was checked."""
    spans = zip(scenario.plant.parameters.items(), scenario.spans.values(), strict=True)
    for (name, one), (least, most) in spans:
        if least < (one.low or 0.0) or most > (one.high or 0.0):
            checked = f"but is checked in {one.low:g} to {one.high:g}"
            found = f"is {least:g}" if least == most else f"goes from {least:g} to {most:g}"
            yield f"{name} {found} {one.unit}, {checked}"


def _prescribed(scenario: Scenario) -> Iterator[str]:
    """Remark on parameters that jump though their rates act, or change after the end."""
    end, events = scenario.duration, scenario.events
    for i, (name, enters) in enumerate(
        zip(scenario.plant.parameters, scenario.plant.entering, strict=True)
    ):
        schedule = scenario.schedule[name]
        for time in schedule.breakpoints:
            jumps = 0.0 < time < end and schedule.at(time) != schedule.before(time)
            event = events.get(time)
            joins = event is not None and event.before[i] != event.after[i]
            if enters and jumps and not joins:
                yield (
                    f"{name} jumps at {time:g} s, which only a ramp can make do work: velocities "
                    "stay"
                )
    for name, schedule in scenario.schedule.items():
        knots = zip(schedule.times, schedule.values, strict=True)
        if late := [time for time, value in knots if time > end and value != schedule.at(end)]:
            yield f"{name} changes at {late[-1]:g} s, after the end at {end:g} s"


def _stopped(scenario: Scenario, run: Trajectory) -> Iterator[str]:
    """Remark on coordinates that hit an end stop, or the range that the MJCF gives their joint."""
    names, units = scenario.plant.coordinates, scenario.plant.units
    for i, name in enumerate(names):
        end = scenario.imperfections.end_stops.get(name)
        if end is not None and (hits := np.flatnonzero(np.abs(run.state[:, i]) >= end)).size:
            most = scenario.requirements.max.get(name)
            short = most is not None and most > end
            beyond = f", short of max.{name}, {most:g} {units[name]}" if short else ""
            where = f"{end:g} {units[name]} from the middle"
            first = f"first at {run.time[hits[0]]:.3g} s"
            yield f"{symbol(name)} hits the end stop, {where}, {first}{beyond}"
    model = plant_model(scenario.plant, threading.get_ident()).mj_model
    for i, name in enumerate(names):
        joint = model.joint(name)
        low, high = joint.range
        outside = (run.state[:, i] <= low) | (run.state[:, i] >= high)
        if model.jnt_limited[joint.id] and outside.any():
            yield (
                f"{name} reaches its range in the MJCF, {low:.4g} to {high:.4g} {units[name]}, "
                f"first at {run.time[np.argmax(outside)]:.3g} s: MuJoCo stops it there, the "
                "equations do not"
            )


def _limited(scenario: Scenario, run: Trajectory) -> Iterator[str]:
    figures, inputs = run.metrics, scenario.plant.inputs
    for name in inputs:
        most_named, *_, share_named = effort_names(inputs, name)
        share, most = figures[share_named], figures[most_named]
        limit = scenario.imperfections.of_input("input_limit", name)
        drive = "the drive" if len(inputs) == 1 else f"the drive of {name}"
        if most is None and run.outcome.kind != DIVERGED:
            yield f"{drive} is asked for more than any number"
        if not share or most is None:
            continue
        unit = f" {one}" if (one := scenario.plant.units[name]) else ""
        asked = f"asks for up to {most:.3g}{unit}"
        if limit is not None and most <= limit:
            asked = f"asks for all of {limit:g}{unit}"
        yield (
            f"{drive} is at its limit for {100.0 * share:.0f} % of the run: the controller {asked}"
        )


def _odd(scenario: Scenario, run: Trajectory) -> Iterator[str]:
    """Remark on a finer step, on nothing that can fail, on a controller that does nothing."""
    settings = run.provenance.get("settings", {})
    if (asked := settings.get("asked_timestep")) is not None:
        yield (
            f"the physics step is {1e3 * settings['timestep']:.3g} ms: at {1e3 * asked:.3g} ms RK4 "
            "is unstable or inaccurate with these dampers and springs"
        )
    if not scenario.required:
        yield "completes = false and nothing else is required: no run of this scenario can fail"
    if len(run.time) > 1 and not run.command.any():
        names = run.layout.inputs
        said = f"{' and '.join(names)} {'is' if len(names) == 1 else 'are'} 0 throughout"
        still = not np.ptp(run.state, axis=0).any()
        yield said + " and nothing moves: the run tests no controller" * still


def _ended(scenario: Scenario, run: Trajectory) -> Iterator[str]:
    """Remark on an end that the outcome alone does not explain."""
    for name, x in zip(run.layout.coordinates, run.away[0], strict=False):
        if abs(x) >= scenario.ends_at.get(name, np.inf):
            unit = scenario.plant.units[name]
            far = f"{x:.4g} {unit}" + f" ({np.degrees(x):.4g}°)" * (unit == "rad")
            yield f"{symbol(name)} is at the start where a run ends, {far} from its target"
            return
    beyond = np.flatnonzero(~(np.abs(run.commands[-1]) < STATE_LIMIT))
    if run.outcome.kind == DIVERGED and beyond.size:
        rule = f"a run ends where a command is not below {STATE_LIMIT:g} or not a number"
        name, value = scenario.plant.inputs[beyond[0]], run.commands[-1][beyond[0]]
        yield f"{name} was {value:g} at {run.outcome.time:.3g} s; {rule}"


def unit_remarks(scenario: Scenario, period: float | None) -> Iterator[str]:
    """Remark on values, as the control period [s], that seem meant in another unit."""
    waits = {"delay": scenario.imperfections.longest_delay, "control period": period or 0.0}
    for name, wait in waits.items():  # while a good part of the run is over
        if (share := wait / scenario.duration) >= LONG_WAIT and wait >= LONG:
            yield (
                f"the {name}, {wait:g} s, is {100.0 * share:.0f} % of the run; it is given in "
                "seconds, not in ms or Hz"
            )
    others = {"m": "mm", "rad": "degrees"}
    for field, also in (("encoder_step", "counts"), ("noise", "mrad")):  # of the plant at rest
        for name in scenario.plant.coordinates:
            unit = scenario.plant.units[name]
            value, band = scenario.imperfections.at(f"{field}.{name}"), scenario.band(name)
            if value >= band:
                said = others[unit] + ("" if unit == "m" and also == "mrad" else f" or {also}")
                yield (
                    f"{field}.{name}, {value:g} {unit}, is no less than the {band:g} {unit} to "
                    f"either side within which {name} is at rest; it is given in {unit}, not in "
                    f"{said}"
                )
