"""Whether a run meets its requirements, by what margin, and what no requirement says."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.controller import Controller
from afl_mujoco.control.own import PythonController
from afl_mujoco.errors import AflMujocoError, InvalidValueError
from afl_mujoco.plants.plant import Floats, Plant
from afl_mujoco.scenario.parameters import symbol
from afl_mujoco.scenario.requirements import asked_of, calm, recoveries
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.time_steps import Deployed
from afl_mujoco.simulation.bound_controllers import bound, plant_model
from afl_mujoco.simulation.trajectory import (
    COMPLETED,
    DIVERGED,
    STATE_LIMIT,
    Trajectory,
    effort_names,
)

DWELL_SHARE = 0.1  # share of the time between disturbances that it must stay settled, if it is less
DWELL = 1.0  # how long a run must stay settled, up to its end, to count as settled [s]


@dataclass(frozen=True, slots=True)
class Judgement:
    """One requirement, and how a run meets it."""

    requirement: str  # one of `asked_of` of the plant
    limit: float
    value: float | None  # None if the run ended too early to decide, or never settles
    margin: float | None  # robustness as in signal temporal logic, as a share of the limit
    graded: float | None = None  # for a search: the margin had it settled at the last instant
    limited: float = 0.0  # of the exerted force: share of the time with the drive at its limit

    @property
    def met(self) -> bool:
        """Whether the run shows that the requirement is met."""
        return self.margin is not None and self.margin >= 0.0


CONTROLLER_FAILED = "controller failed"
"""Ending of a run whose controller raises, takes too long or does not return a force."""


def failure_of(ending: str, requirements: Sequence[Judgement]) -> str:
    """Return how a run failed, the one definition of it; empty if it meets every requirement.

    A run that ended early is named by how it ended, any other by the requirement with the least
    margin, of which it has none where it never settles.
    """
    missed = [one for one in requirements if not one.met]
    if ending == CONTROLLER_FAILED or (missed and ending != COMPLETED):
        return ending
    return min(missed, key=_margin).requirement if missed else ""


def least_margin(requirements: Iterable[Judgement]) -> float | None:
    """Return the least margin of a run over what is measured; None where one has none."""
    margins = [one.margin for one in requirements if one.requirement != "completes"]
    return min((x for x in margins if x is not None), default=None) if None not in margins else None


def _margin(one: Judgement) -> float:
    return -math.inf if one.margin is None else one.margin


def judge(scenario: Scenario, run: Trajectory) -> tuple[Judgement, ...]:
    """Judge a run by the requirements of its scenario, in the order of `asked_of`."""
    required, completed = scenario.required, run.outcome.kind == COMPLETED
    found = []
    if "completes" in required:
        duration = scenario.duration
        reached = duration if completed else run.outcome.time
        left = (reached - duration) / duration
        margin = left if completed or left < 0.0 else None  # it may fall at the very end
        found.append(Judgement("completes", duration, reached, margin))
    if "end_stops" in required:
        judged = []
        for i, (low, high) in stops_of(scenario).items():
            x = run.state[:, i]
            sides = ((-low, float(-x.min())), (high, float(x.max())))
            limit, value = min(sides, key=lambda side: _left(*side))
            judged.append(_peak("end_stops", limit, value, completed))
        found.append(min(judged, key=_margin))
    return (*found, *_judgements(scenario, run))


def ranges_of(plant: Plant) -> Floats:
    """Return the range that the MJCF gives each coordinate, infinite where none, shape (n, 2)."""
    m = plant_model(plant).mj_model
    return np.where(m.jnt_limited[:, None], m.jnt_range, (-np.inf, np.inf))


WRITTEN = {"damping": "damping", "dry_friction": "frictionloss", "armature": "armature"}
"""Imperfections that a plant may write itself, and the field of a joint that each is."""


def written(plant: Plant) -> tuple[str, ...]:
    """Return the paths of imperfections that a plant has of its parameters instead."""
    targets = {str(one) for one in plant_model(plant).targets}
    every = itertools.product(WRITTEN.items(), plant.coordinates)
    return tuple(f"{name}.{x}" for (name, field), x in every if f"joint {x} {field}" in targets)


def require_start(scenario: Scenario) -> None:
    """Raise if a run cannot start as asked.

    Beyond the range of a joint in the MJCF MuJoCo would push it in; what a plant writes cannot be
    an imperfection too.
    """
    plant = scenario.plant
    for path in written(plant):
        if scenario.imperfections.at(path):
            rule = "is written by the plant; change its parameter instead"
            raise InvalidValueError(f"imperfections.{path}", rule)
    starts = zip(plant.coordinates, scenario.initial_state, ranges_of(plant), strict=False)
    for name, x, (low, high) in starts:
        slack = 0.5 * scenario.imperfections.at(f"encoder_step.{name}")  # of a draw
        if not low - slack <= x <= high + slack:
            unit = plant.units[name]
            rule = f"must lie within its range in the MJCF, {low:.4g} to {high:.4g} {unit}"
            raise InvalidValueError(f"initial_state {name}", rule, f"{x:g} {unit}")


def kept_within(scenario: Scenario) -> dict[str, tuple[float, float]]:
    """Return between what each coordinate is kept, by its end stops or its range if nearer."""
    stops, kept = scenario.imperfections.end_stops, {}
    ranges = zip(scenario.plant.coordinates, ranges_of(scenario.plant).tolist(), strict=True)
    for name, (low, high) in ranges:
        stop = stops.get(name, math.inf)
        kept[name] = max(low, -stop), min(high, stop)
    return kept


def stops_of(scenario: Scenario) -> dict[int, tuple[float, float]]:
    """Return between what each coordinate with end stops is kept, by its place."""
    stops, kept = scenario.imperfections.end_stops, kept_within(scenario)
    return {i: kept[name] for i, name in enumerate(kept) if name in stops}


def reached_ranges(plant: Plant, run: Trajectory) -> Iterator[tuple[str, float]]:
    """Yield in words what range in the MJCF a run reaches, where MuJoCo stops it, and when [s]."""
    for i, (name, (low, high)) in enumerate(zip(plant.coordinates, ranges_of(plant), strict=True)):
        outside = (run.state[:, i] <= low) | (run.state[:, i] >= high)
        if outside.any():
            span = f"{low:.4g} to {high:.4g} {plant.units[name]}"
            yield f"{name} reaches its range in the MJCF, {span}", run.time[np.argmax(outside)]


def judge_failure(scenario: Scenario) -> tuple[Judgement, ...]:
    """Judge a run whose controller failed: it misses every requirement, and completing."""
    limits = {"completes": scenario.duration, **scenario.required}
    return tuple(Judgement(name, limit, None, None) for name, limit in limits.items())


def _judgements(scenario: Scenario, run: Trajectory) -> Iterator[Judgement]:
    asked, completed = scenario.requirements, run.outcome.kind == COMPLETED
    metrics = run.metrics if asked.max else {}
    known = asked_of(scenario.plant) if asked.max else {}
    inputs = scenario.plant.inputs
    for name, limit in asked.max.items():
        share = metrics[effort_names(inputs, name)[-1]] if name in inputs else 0.0
        peak = metrics[known[f"max.{name}"].metric]
        yield replace(_peak(f"max.{name}", limit, peak, completed), limited=share or 0.0)
    for name, limit in asked.min.items():
        yield _least(f"min.{name}", limit, float(_course(scenario, run, name).min()), completed)
    outside = _outside(scenario, run)
    if asked.settling_time is not None:
        first = [(0.0, calm(scenario.duration, scenario.disturbances))]
        yield _rest("settling_time", asked.settling_time, run, outside, first)
    if asked.recover_within is not None:
        after = recoveries(scenario.duration, scenario.disturbances)
        yield _rest("recover_within", asked.recover_within, run, outside, after)


def _course(scenario: Scenario, run: Trajectory, name: str) -> Floats:
    """Return a signal or a state over a run; one that wraps within half a turn of its target."""
    if name in run.signals:
        return run.signals[name]
    i = scenario.plant.states.index(name)
    wraps = name in scenario.plant.wraps
    return scenario.about(name) + run.away[:, i] if wraps else run.state[:, i]


def _outside(scenario: Scenario, run: Trajectory) -> NDArray[np.bool_]:
    names = scenario.plant.coordinates
    bands = np.array([scenario.band(name) for name in names])
    return np.asarray((np.abs(run.away[:, : len(names)]) > bands).any(axis=1))


def settling_time(scenario: Scenario, run: Trajectory) -> float | None:
    """Return from when a run stayed within the bands of rest, `DWELL` before its end or earlier."""
    outside = np.flatnonzero(_outside(scenario, run))
    settled = int(outside[-1]) + 1 if len(outside) else 0
    if run.outcome.kind != COMPLETED or settled == len(run.time):
        return None
    dwelled = run.time[-1] - run.time[settled] >= DWELL - 1e-9
    return float(run.time[settled]) if dwelled else None


def _peak(name: str, limit: float, value: float | None, completed: bool) -> Judgement:
    """Judge the largest absolute value of a signal; a run cut short can only break the limit."""
    if value is None or (not completed and value <= limit):
        return Judgement(name, limit, value, None)
    return Judgement(name, limit, value, _left(limit, value))


def _left(limit: float, value: float) -> float:
    return (limit - value) / (abs(limit) or 1.0)


def _least(name: str, limit: float, value: float, completed: bool) -> Judgement:
    """Judge the least value of a signal; a run cut short can only break the limit."""
    unknown = not completed and value >= limit
    return Judgement(name, limit, value, None if unknown else -_left(limit, value))


def _rest(name: str, limit: float, run: Trajectory, outside: Any, windows: Any) -> Judgement:
    """Judge the longest time, over some windows, until the state stays within its bands."""
    time, slowest, ever = run.time, 0.0, True
    for begin, end in windows:
        last = np.flatnonzero(outside & (time >= begin) & (time <= end))
        rest = end
        if run.outcome.kind == COMPLETED or run.outcome.time > end:
            rest = begin
            if len(last):
                rest = time[last[-1] + 1] if last[-1] + 1 < len(time) else end
        lasted = round(float(min(rest, end)) - begin, 9)  # a nanosecond is less than any step
        shown = min(DWELL, DWELL_SHARE * (end - begin))  # a passage through the bands is no rest
        stays = end - rest >= (shown - 1e-9 if lasted <= limit else 1e-9)
        slowest, ever = max(slowest, lasted), ever and bool(stays)
    margin = (limit - slowest) / limit
    if ever:
        return Judgement(name, limit, slowest, margin)
    return Judgement(name, limit, None, None, graded=margin)


FIRM = 0.99  # least impedance of a constraint of dry friction that holds

MOVED = 0.05  # share of a limit that half the physics step may move without a remark

LONG_WAIT, LONG = 0.05, 0.1
"""Share of a run that nobody means as a delay or a control period, if it is so long [s]."""


def remarks_on(
    run: Trajectory, scenario: Scenario, controller: Controller, which: str = ""
) -> list[str]:
    """Return remarks on a run that no requirement makes, one sentence each; `which` says of what.

    What is so of every run of the scenario goes without.
    """
    ours = scenario.is_cart_pole
    of_plants = controller.remarks(scenario) if ours else beyond(scenario.plant, scenario.spans)
    own = scenario.imperfections
    idle = [path for path in own.departing() if own.without_effect(path)]
    of_run = itertools.chain(
        _ended(scenario, run), _stopped(scenario, run), _limited(scenario, run),
        _idle(run), _stepped(scenario, run, controller),
    )  # fmt: skip
    return [
        *of_plants,
        *_prescribed(scenario),
        *(f"{path} has no effect, because velocities are differentiated" for path in idle),
        *unit_remarks(scenario, run.control_period),
        *_outliving(controller),
        *_creeping(scenario),
        *_of_every_run(scenario, run),
        *(which + remark for remark in of_run),
    ]


def _outliving(controller: Controller) -> Iterator[str]:
    """Remark on what a controller keeps where no run makes it anew."""
    if isinstance(controller, PythonController) and controller.outlives:
        yield f"{controller.memory}: a run depends on those before it in the same process"


def beyond(plant: Plant, spans: Mapping[str, tuple[float, float]]) -> Iterator[str]:
    """Remark on parameters that go beyond the bounds within which a plant was checked."""
    for name, one in plant.parameters.items():
        least, most = spans.get(name, (one.value, one.value))
        if least < (one.low or 0.0) or most > (one.high or 0.0):
            checked = f"but is checked in {one.low:g} to {one.high:g}"
            found = f"is {least:g}" if least == most else f"goes from {least:g} to {most:g}"
            yield f"{name} {found} {one.unit}, {checked}"


def _prescribed(scenario: Scenario) -> Iterator[str]:
    """Remark on parameters that jump though their rates act, or change after the end."""
    end, events, plant = scenario.duration, scenario.events, scenario.plant
    for i, (name, enters) in enumerate(zip(plant.parameters, plant.entering, strict=True)):
        schedule = scenario.schedule[name]
        for time in schedule.breakpoints:
            jumps = 0.0 < time < end and schedule.at(time) != schedule.before(time)
            event = events.get(time)
            joins = event is not None and event.before[i] != event.after[i]
            if enters and jumps and not joins:
                why = "which only a ramp can make do work: velocities stay"
                yield f"{name} jumps at {time:g} s, {why}"
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
    for words, time in reached_ranges(scenario.plant, run):
        yield f"{words}, first at {time:.3g} s: MuJoCo stops it there, the equations do not"


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
        asked = f"asks for up to {_digits(most, 3)}{unit}"
        if limit is not None and most <= limit:
            asked = f"asks for all of {limit:g}{unit}"
        often = f"for {_digits(100.0 * share, 2)} % of the run"
        yield f"{drive} is at its limit {often}: the controller {asked}"


def _creeping(scenario: Scenario) -> Iterator[str]:
    """Remark on dry friction of the MJCF, which holds nothing by MuJoCo's defaults."""
    m = plant_model(scenario.plant).mj_model
    soft = (m.dof_frictionloss > 0.0) & (m.dof_solimp[:, 0] < FIRM)
    for name, creeps in zip(scenario.plant.coordinates, soft, strict=True):
        if creeps and not scenario.imperfections.at(f"dry_friction.{name}"):
            under = "the frictionloss of the MJCF, whose solimpfriction is soft"
            yield f"{symbol(name)} creeps under {under}: dry_friction.{name} holds it"


def _digits(x: float, count: int) -> str:
    """Return a number to some digits, without an exponent up to a million."""
    return f"{float(f'{x:.{count}g}'):g}"


def _of_every_run(scenario: Scenario, run: Trajectory) -> Iterator[str]:
    """Remark on a finer step, and on nothing that can fail."""
    settings = run.provenance.get("settings", {})
    if (asked := settings.get("asked_timestep")) is not None:
        why = "RK4 is unstable or inaccurate with these dampers and springs"
        step = f"{1e3 * settings['timestep']:.3g} ms"
        yield f"the physics step is {step}: at {1e3 * asked:.3g} ms {why}"
    if not scenario.required:
        yield "completes = false and nothing else is required: no run of this scenario can fail"


def _idle(run: Trajectory) -> Iterator[str]:
    """Remark on a controller that does nothing."""
    if len(run.time) > 1 and not run.command.any():
        names = run.layout.inputs
        said = f"{' and '.join(names)} {'is' if len(names) == 1 else 'are'} 0 throughout"
        still = not np.ptp(run.state, axis=0).any()
        yield said + " and nothing moves: the run tests no controller" * still


def _stepped(scenario: Scenario, run: Trajectory, controller: Controller) -> Iterator[str]:
    """Remark on requirements that depend on the physics step: the same run at half of it."""
    simulator, _, mode = run.simulator.partition(" ")
    if simulator != "mujoco" or mode == "exact":
        return
    from afl_mujoco.simulation.sampled.runs import simulate_sampled

    ran, own = run.provenance["settings"], bound(controller, scenario)
    step = 0.5 * ran["timestep"]
    with suppress(AflMujocoError):  # more steps than there may be, or no force
        if mode == "sampled":
            how = Deployed(ran["integrator"], step, ran["control_period"])
            finer = simulate_sampled(scenario, own, how)
        else:
            from afl_mujoco.simulation.mujoco_rollout import simulate_mujoco

            finer = simulate_mujoco(scenario, own, mode, timestep=step)
        for one, then in zip(judge(scenario, run), judge(scenario, finer), strict=True):
            moved = abs((one.margin or 0.0) - (then.margin or 0.0))
            if one.met != then.met or moved > MOVED:
                here, left = (
                    "none" if x.margin is None else f"{_digits(100.0 * x.margin, 2)} %"
                    for x in (one, then)
                )
                margins = f"{here}, at {1e3 * step:.3g} ms {left}; try a finer timestep"
                yield f"{one.requirement} depends on the physics step: its margin is {margins}"


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
        rule = f"a run ends where a command is no number, or {STATE_LIMIT:g} or more"
        name, value = scenario.plant.inputs[beyond[0]], run.commands[-1][beyond[0]]
        yield f"{name} was {value:g} at {run.outcome.time:.3g} s; {rule}"


def unit_remarks(scenario: Scenario, period: float | None) -> Iterator[str]:
    """Remark on values, as the control period [s], that seem meant in another unit."""
    waits = {"delay": scenario.imperfections.longest_delay, "control period": period or 0.0}
    for name, wait in waits.items():  # while a good part of the run is over
        if (share := wait / scenario.duration) >= LONG_WAIT and wait >= LONG:
            much = f"{100.0 * share:.0f} % of the run"
            yield f"the {name}, {wait:g} s, is {much}; it is given in seconds, not in ms or Hz"
    others = {"m": "mm", "rad": "degrees"}
    for field, also in (("encoder_step", "counts"), ("noise", "mrad")):  # of the plant at rest
        for name in scenario.plant.coordinates:
            unit = scenario.plant.units[name]
            value, band = scenario.imperfections.at(f"{field}.{name}"), scenario.band(name)
            if value >= band:
                said = others[unit] + ("" if unit == "m" and also == "mrad" else f" or {also}")
                rest = f"the {band:g} {unit} to either side within which {name} is at rest"
                given = f"it is given in {unit}, not in {said}"
                yield f"{field}.{name}, {value:g} {unit}, is no less than {rest}; {given}"
