"""The sweep of each imperfection: what each controller survives, and from where it fails."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from afl_mujoco.control.catalogue import GainError, find_controller
from afl_mujoco.control.controller import Controller
from afl_mujoco.control.own.python_controller import ControllerError
from afl_mujoco.errors import InvalidValueError, require_count
from afl_mujoco.execution.executors import compute_all, open_executor
from afl_mujoco.scenario.belief import ERRORS
from afl_mujoco.scenario.files import find_scenario
from afl_mujoco.scenario.imperfections import (
    IDEAL,
    IMPERFECTIONS,
    Imperfection,
)
from afl_mujoco.scenario.parameters import require_distinct
from afl_mujoco.scenario.requirements import NONE
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.judgement import CONTROLLER_FAILED
from afl_mujoco.simulation.mujoco_model import require_integrator
from afl_mujoco.simulation.sampled.rollouts import run_rollouts
from afl_mujoco.simulation.sampled.runs import ticks_of
from afl_mujoco.simulation.trajectory import DIVERGED, FELL
from afl_mujoco.studies.bisection import LOWER, Threshold, find_threshold, scan_levels
from afl_mujoco.studies.contract import Interrupted, Progress, counted, silent
from afl_mujoco.studies.delay_margin import LeastMargin, least_margin
from afl_mujoco.studies.thresholds.classes import times_reference
from afl_mujoco.studies.thresholds.imperfections import (
    COMBINED,
    Hardware,
    added,
    combined,
    find_imperfection,
    hardware_at,
)
from afl_mujoco.studies.thresholds.result import (
    Result,
    Settings,
    Sweep,
    Verdict,
)
from afl_mujoco.studies.thresholds.study import DEFAULT, QUICK, Thresholds

SCENARIO, DELAY = "step-step", "delay"

METRICS = (
    "settling_time", "peak_z", "peak_phi", "max_command", "max_force", "iae_z", "iae_phi",
)  # fmt: skip
"""Metrics of a run, in SI units, as in `Rollouts`."""

TIMED = (FELL, DIVERGED, "end_stops")
"""Failures that have an instant."""

LESS_IS_WORSE = {name for one in IMPERFECTIONS if one.less_is_worse for name in one.fields}
"""Imperfections whose smaller levels are the harsher ones."""

Scenarios = tuple[Scenario, ...]
Unit = tuple[str, Controller, Scenarios, Settings]


def sweep(unit: Unit) -> Sweep:
    """Return the thresholds of one controller under one imperfection, with some settings."""
    name, controller, scenarios, settings = unit
    imperfection = referred(find_imperfection(name), scenarios)

    @functools.cache
    def at(level: float) -> Verdict:
        chance = seeds(imperfection.seeded, scenarios, settings)
        hardware = [hardware_at(imperfection, level, seed) for seed in chance]
        runs = on_hardware(scenarios, hardware)
        return judge(level, runs, controller, settings)

    if imperfection.of_belief and not _depends(at, imperfection, unit):
        level, reference = imperfection.harsh, at(imperfection.reference)
        all_hold = Threshold(bound=LOWER, holds_at=level, fails_at=None, islands=0)
        return Sweep(
            imperfection=imperfection.name,
            controller=controller.name,
            reference=reference,
            survives=all_hold,
            settles=all_hold,
            failure=None,
            applies=False,
        )

    def threshold(holds: Callable[[float], bool], closer: int = 0) -> Threshold:
        scan = scan_levels(imperfection.benign, imperfection.harsh, settings.scan)
        return find_threshold(holds, scan, settings.tolerance, imperfection.snapped, closer=closer)

    def harshness(found: Threshold) -> float:
        level = found.fails_at
        return math.inf if level is None else times_reference(imperfection, level)

    survives = threshold(lambda level: at(level).survives, settings.scan)
    settles = threshold(lambda level: at(level).settles)
    return Sweep(
        imperfection=imperfection.name,
        controller=controller.name,
        reference=at(imperfection.reference),
        survives=survives,
        settles=min(settles, survives, key=harshness),  # what is not survived is not settled
        failure=None if survives.fails_at is None else at(survives.fails_at),
    )


def _depends(at: Callable[[float], Verdict], imperfection: Imperfection, unit: Unit) -> bool:
    """Return whether a run changes by any bit where what the controller believes does."""
    bare = run_bare(unit[1:])
    return any(
        at(level).metrics != bare.metrics or at(level).message
        for level in (imperfection.reference, imperfection.harsh)
    )


def run_bare(unit: tuple[Controller, Scenarios, Settings]) -> Verdict:
    """Return the verdict on one controller with nothing added to the scenarios."""
    controller, scenarios, settings = unit
    chance = seeds(False, scenarios, settings)
    runs = on_hardware(scenarios, [{"seed": seed} for seed in chance])
    return judge(0.0, runs, controller, settings)


def sweep_combined(unit: tuple[Controller, Scenarios, Settings]) -> tuple[Verdict, ...]:
    """Return the verdicts on one controller as the imperfections of `added` are added in turn.

    The n-th verdict is with the first n of them; its level is n.
    """
    controller, scenarios, settings = unit
    found = []
    for count in range(1, len(added()) + 1):
        present = added()[:count]
        chance = seeds(any(one.seeded for one in present), scenarios, settings)
        runs = on_hardware(scenarios, [combined(1.0, present, seed) for seed in chance])
        found.append(judge(float(count), runs, controller, settings))
    return tuple(found)


def seeds(seeded: bool, scenarios: Scenarios, settings: Settings) -> range:
    """Return the seeds that must be survived; one where nothing is random."""
    noisy = seeded or any(scenario.imperfections.noisy for scenario in scenarios)
    return range(settings.seeds if noisy else 1)


def on_hardware(scenarios: Scenarios, hardware: Sequence[Hardware]) -> list[Scenario]:
    """Return every scenario with each of some imperfections on top of its own."""
    return [one.changed(**_on_top(one, added)) for one in scenarios for added in hardware]


def _on_top(scenario: Scenario, added: Hardware) -> dict[str, Any]:
    """Return imperfections on top of those of a scenario, by name.

    The harsher of each counts: what is milder than the scenario's own level would not come on top
    of it, and could even be worse, as a control period where velocities are differences of
    quantised positions. Errors of the belief are added to its own, in the direction of the sweep;
    seeds add up.
    """
    found = {}
    for name, level in added.items():
        own = scenario.hardware(name)
        summed = name in (*ERRORS, "seed")
        found[name] = own + level if summed else _harsher(name, own, level)
    return found


def _harsher(name: str, own: Any, level: Any) -> Any:
    """Return the harsher of two levels; None is ideal."""
    if own is None:
        return level
    return min(own, level) if name in LESS_IS_WORSE else max(own, level)


def referred(one: Imperfection, scenarios: Scenarios) -> Imperfection:
    """Return an imperfection whose reference is no milder than what a scenario has itself."""
    first = list(one.fields.items())[:1]  # all combined has none
    if one.adds:
        return one
    own = [(s.hardware(key), factor) for s in scenarios for key, factor in first]
    levels = [one.reference, *(x / factor for x, factor in own if x and x / factor > 0.0)]
    return replace(one, reference=min(levels) if one.less_is_worse else max(levels))


def judge(
    level: float, scenarios: Sequence[Scenario], controller: Controller, settings: Settings
) -> Verdict:
    """Return the verdict on a controller at a level, over the scenarios of that level."""
    timestep, integrator = settings.timestep, settings.integrator
    try:
        runs = run_rollouts(scenarios, controller, timestep=timestep, integrator=integrator)
    except (ControllerError, GainError) as error:
        return _refused(level, str(error))
    failures = [runs.failure(i) for i in range(len(runs))]
    settled = [runs.settled(i) or one.requirements != NONE for i, one in enumerate(scenarios)]
    worst = min(range(len(runs)), key=lambda i: (not failures[i], settled[i]))
    failure = failures[worst]
    ended = runs.stop_time if failure == "end_stops" else runs.end_time
    return Verdict(
        level=level,
        survives=not any(failures),
        settles=not any(failures) and all(settled),
        failure=failure,
        scenario=None if not failure and settled[worst] else scenarios[worst].name,
        time=float(ended[worst]) if failure in TIMED else None,
        metrics={name: _largest(getattr(runs, name).tolist()) for name in METRICS},
    )


def _refused(level: float, message: str) -> Verdict:
    """Return the verdict on a controller that computes no force."""
    nothing: dict[str, float | None] = dict.fromkeys(METRICS)
    return Verdict(
        level=level, survives=False, settles=False, failure=CONTROLLER_FAILED, scenario=None,
        time=None, metrics=nothing, message=message,
    )  # fmt: skip


def _largest(values: Sequence[float]) -> float | None:
    """Return the largest of some numbers, None if one is not finite."""
    return max(values) if all(math.isfinite(value) for value in values) else None


def names_of(chosen: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the imperfections to study, by default all and all combined."""
    if not chosen:
        return (*(one.name for one in IMPERFECTIONS), COMBINED.name)
    return tuple(find_imperfection(name).name for name in chosen)


MOST_SEEDS, MOST_LEVELS = 1000, 1000
"""Most noise seeds, and most levels of a scan."""


class Request(NamedTuple):
    """What is studied: controllers, scenarios, settings, names of imperfections."""

    controllers: Sequence[Controller]
    scenarios: Scenarios
    settings: Settings
    names: Sequence[str]


def request_of(configuration: Thresholds) -> Request:
    """Return the request of a configuration, or raise."""
    c = configuration
    seeds, scan, tolerance = QUICK if c.quick else DEFAULT
    settings = Settings(
        seeds=seeds if c.seeds is None else c.seeds,
        scan=scan if c.scan is None else c.scan,
        tolerance=tolerance if c.tolerance is None else c.tolerance,
        integrator=c.integrator,
        timestep=c.timestep,
    )
    scenarios = tuple(find_scenario(name) for name in c.scenarios or (SCENARIO,))
    controllers = [find_controller(name) for name in c.controllers]
    names = require(controllers, scenarios, settings, c.imperfections)
    return Request(controllers, scenarios, settings, names)


def require(
    controllers: Sequence[Controller],
    scenarios: Scenarios,
    settings: Settings,
    imperfections: Sequence[str],
) -> tuple[str, ...]:
    """Return the names of the imperfections, or raise if a rule is broken."""
    names = names_of(imperfections)
    require_distinct("controller", [controller.name for controller in controllers])
    require_distinct("scenario", [scenario.name for scenario in scenarios])
    require_distinct("imperfection", names)
    require_count("seeds", settings.seeds, 1, MOST_SEEDS)
    require_count("scan", settings.scan, 2, MOST_LEVELS)
    if not 1e-4 <= settings.tolerance <= 1.0:
        raise InvalidValueError("tolerance", "must lie in 1e-4 to 1", settings.tolerance)
    require_integrator(settings.integrator)
    for scenario in scenarios:
        ticks_of(scenario, settings.timestep)
    return names


def find_thresholds(
    controllers: Sequence[Controller],
    scenarios: Scenarios,
    settings: Settings,
    imperfections: Sequence[str] = (),
    *,
    workers: int = 1,
    cluster: str | None = None,
    progress: Progress = silent,
) -> Result:
    """Find the thresholds of some controllers."""
    names = require(controllers, scenarios, settings, imperfections)
    asked = [(controller, scenarios, settings) for controller in controllers]
    found: dict[int, Sweep] = {}
    combined_found: dict[int, tuple[Verdict, ...]] = {}
    units: list[Unit] = []
    bare: list[Verdict] = []
    margins: list[LeastMargin | None] = []
    try:
        with open_executor(workers, cluster) as executor:
            bare = compute_all(run_bare, asked, executor)
            each = [unit for unit, verdict in zip(asked, bare, strict=True) if verdict.survives]
            units = [(name, *one) for name in names for one in each]
            combine = each if COMBINED.name in names else []
            total = len(units) + len(combine)
            told = [f"{one.name}, {find_imperfection(name).title}" for name, one, *_ in units]
            progress("sweeping", 0, total)
            advance = counted(
                progress, "sweeping", total, [*told, *(f"{one.name}, added" for one, *_ in combine)]
            )
            compute_all(sweep, units, executor, advance, kept=found)
            compute_all(
                sweep_combined, combine, executor, lambda i: advance(len(units) + i),
                kept=combined_found,
            )  # fmt: skip
            linear = [one for one, *_ in each if not one.estimates and not one.interpreted]
            alone = DELAY in names and all(s.imperfections == IDEAL for s in scenarios)
            plants = [(controller, scenarios) for controller in linear if alone]
            margins = compute_all(least_margin, plants, executor)
    except KeyboardInterrupt:
        done = _whole(names, len(units) // max(len(names), 1), found)
        if not done:
            raise
        partial = _result(controllers, scenarios, settings, done, bare, found, {}, ())
        count = f"{len(found)} of {len(units)} sweeps"
        raise Interrupted(partial, f"{count}; whole: {', '.join(done)}") from None
    known = tuple(margin for margin in margins if margin is not None)
    return _result(controllers, scenarios, settings, names, bare, found, combined_found, known)


def _whole(names: Sequence[str], each: int, found: Mapping[int, Sweep]) -> tuple[str, ...]:
    """Return the imperfections of which every controller was swept, by their names."""
    return tuple(
        name
        for row, name in enumerate(names)
        if each and all(row * each + column in found for column in range(each))
    )


def _result(
    controllers: Sequence[Controller],
    scenarios: Scenarios,
    settings: Settings,
    names: Sequence[str],
    bare: Sequence[Verdict],
    found: Mapping[int, Sweep],
    combined_found: Mapping[int, tuple[Verdict, ...]],
    margins: tuple[LeastMargin, ...],
) -> Result:
    """Put together the sweeps of some imperfections, all of them unless it was interrupted."""
    verdicts = dict(zip((one.name for one in controllers), bare, strict=True))
    sound = tuple(name for name, verdict in verdicts.items() if verdict.survives)
    sweeps = {(one.imperfection, one.controller): one for one in found.values()}
    return Result(
        settings=replace(settings, scenarios=tuple(scenario.name for scenario in scenarios)),
        scenarios=tuple(scenarios),
        controllers=sound,
        failing={name: verdict for name, verdict in verdicts.items() if not verdict.survives},
        imperfections=tuple(referred(find_imperfection(name), scenarios) for name in names),
        sweeps=tuple(sweeps[name, controller] for name in names for controller in sound),
        added=tuple(one.name for one in added()),
        combined={sound[index]: verdicts for index, verdicts in sorted(combined_found.items())},
        bare=tuple(verdicts[name] for name in sound),
        delay_margins=margins,
    )
