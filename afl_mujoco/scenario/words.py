"""A scenario in words: how M, l and the push change, where it starts, how long it lasts."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterator

from afl_mujoco.report.numbers import short
from afl_mujoco.scenario.belief import NOMINAL, PARAMETERS, TRUTH, Assumed, Belief
from afl_mujoco.scenario.disturbances import ForcePulse
from afl_mujoco.scenario.imperfections import Imperfections
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.schedules import Schedule

MOST = 8
"""Largest number of changes that are listed one by one."""


def describe(scenario: Scenario) -> list[tuple[str, str]]:
    """Return what happens in a scenario as pairs of a label and a text."""
    z, phi, z_dot, phi_dot = scenario.initial_state
    start = f"φ = {short(math.degrees(phi))}°"
    if z or z_dot or phi_dot:
        start += f", z = {short(z)} m, z′ = {short(z_dot)} m/s, φ′ = {short(phi_dot)} rad/s"
    else:
        start += ", at rest at z = 0"
    return [
        ("cart mass M", schedule_text(scenario.cart_mass, "kg", scenario.duration)),
        ("half-length l", schedule_text(scenario.half_length, "m", scenario.duration)),
        ("pole mass m", f"{short(scenario.pole_mass)} kg"),
        ("gravity g", f"{short(scenario.gravity)} m/s²"),
        ("disturbances", _disturbances(scenario)),
        ("start", start),
        ("horizon", f"{short(scenario.duration)} s"),
        ("imperfections", departures_text(scenario.imperfections)),
        ("controllers", belief_text(scenario.belief)),
    ]


def belief_text(belief: Belief) -> str:
    """Return what controllers are told of the plant."""
    if belief == TRUTH:
        return "told the true M, l"
    if belief == Belief.of(NOMINAL):
        return "believe nominal"
    said = []
    for name in PARAMETERS:
        one = getattr(belief, name)
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
    """Return in words what disturbs the cart."""
    told = [
        f"{short(one.force)} N over {short(one.start)} to {short(one.end)} s"
        if isinstance(one, ForcePulse)
        else f"an impulse of {short(one.momentum)} N s at {short(one.time)} s"
        for one in scenario.disturbances
    ]
    if not told:
        return "none"
    return "; ".join(told) if len(told) <= MOST else f"{len(told)} pulses and impulses"
