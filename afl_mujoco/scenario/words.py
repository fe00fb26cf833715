"""A scenario in words: how the plant changes, where it starts, how long it lasts."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterator

from afl_mujoco.report.numbers import short
from afl_mujoco.scenario.belief import NOMINAL, TRUTH, Assumed, Belief
from afl_mujoco.scenario.disturbances import ForcePulse
from afl_mujoco.scenario.imperfections import Imperfections
from afl_mujoco.scenario.parameters import symbol
from afl_mujoco.scenario.ranges import scheduled
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.schedules import Schedule

MOST = 8
"""Largest number of changes that are listed one by one."""


def describe(scenario: Scenario) -> list[tuple[str, str]]:
    """Return what happens in a scenario as pairs of a label and a text."""
    plant = scenario.plant
    named = _NAMES if scenario.is_cart_pole else {}
    return [
        *([] if scenario.is_cart_pole else [("plant", plant.name)]),
        *(
            (named.get(name, name), _parameter(scenario, name, one))
            for name, one in scenario.schedule.items()
        ),
        ("disturbances", _disturbances(scenario)),
        ("start", _start(scenario)),
        ("horizon", f"{short(scenario.duration)} s"),
        ("imperfections", departures_text(scenario.imperfections)),
        ("controllers", belief_text(scenario.belief)),
    ]


_NAMES = {
    "cart_mass": "cart mass M", "pole_mass": "pole mass m", "half_length": "half-length l",
    "gravity": "gravity g",
}  # fmt: skip


def _parameter(scenario: Scenario, name: str, schedule: Schedule) -> str:
    """Return in words how a parameter changes; one that cannot is a number."""
    unit = scenario.plant.units[name]
    if name not in scheduled(scenario.plant):
        return f"{short(schedule.at(0.0))} {unit}"
    return schedule_text(schedule, unit, scenario.duration)


def _start(scenario: Scenario) -> str:
    """Return in words where a run starts."""
    said, units = [], scenario.plant.units
    for name, x in zip(scenario.plant.states, scenario.initial_state, strict=True):
        if x and units[name] == "rad":
            said.append(f"{symbol(name)} = {short(math.degrees(x))}°")
        elif x:
            said.append(f"{symbol(name)} = {short(x)} {units[name]}")
    return f"{', '.join(said)}, the rest 0" if said else "at rest at 0"


def belief_text(belief: Belief) -> str:
    """Return what controllers are told of the plant."""
    if belief == TRUTH:
        return "told the true parameters"
    if belief == Belief.of(NOMINAL):
        return "believe nominal"
    said = []
    if belief.rest == NOMINAL:
        said.append("nominal")
    for name, one in belief.assumed.items():
        if one != Assumed():
            value = one.value if isinstance(one.value, str) else short(one.value)
            said.append(f"{name} {value}" + (f" {100.0 * one.error:+.3g} %" if one.error else ""))
    return f"believe {', '.join(said)}"


def departures_text(imperfections: Imperfections) -> str:
    """Return what is not ideal, by the keys of a scenario file."""
    found = imperfections.departing()
    return "; ".join(f"{name} = {json.dumps(value)}" for name, value in found.items()) or "none"


def schedule_text(schedule: Schedule, unit: str, until: float) -> str:
    """Return in words how a parameter changes from time 0 to an end [s]."""
    changes = list(_changes(schedule, unit, until))
    start = f"{short(schedule.at(0.0))} {unit}"
    if not changes:
        return f"{start} throughout"
    if len(changes) > MOST:
        least, most = (short(f(schedule.values)) for f in (min, max))
        return f"{least} to {most} {unit}, {len(changes)} changes"
    return "; ".join((start, *changes))


def _changes(schedule: Schedule, unit: str, until: float) -> Iterator[str]:
    """Yield every jump and ramp in words."""
    knots = zip(schedule.times, schedule.values, strict=True)
    for (start, first), (end, last) in itertools.pairwise(knots):
        if end <= 0.0 or start >= until or first == last:
            continue
        if start == end:
            yield f"jumps to {short(last)} {unit} at {short(end)} s"
        else:
            way = "rises" if last > first else "falls"
            over = f"over {short(max(0.0, start))} to {short(min(end, until))} s"
            yield f"{way} to {short(schedule.before(min(end, until)))} {unit} {over}"


def _disturbances(scenario: Scenario) -> str:
    """Return in words what disturbs the plant."""
    told = [
        (
            f"{short(one.force)} N over {short(one.start)} to {short(one.end)} s"
            if isinstance(one, ForcePulse)
            else f"an impulse of {short(one.momentum)} N s at {short(one.time)} s"
        )
        + (f" on {where}" if (where := one.input or one.coordinate) else "")
        for one in scenario.disturbances
    ]
    if not told:
        return "none"
    return "; ".join(told) if len(told) <= MOST else f"{len(told)} pulses and impulses"
