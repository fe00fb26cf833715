"""Many runs: sweeps of imperfections, samples of a space, the worst of it, maps of starts."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from afl_mujoco.control.controller import Controller
from afl_mujoco.errors import InvalidValueError, UnknownNameError, require_count
from afl_mujoco.plants.cartpole import CART_POLE
from afl_mujoco.plants.plant import Floats, Plant
from afl_mujoco.pool import Executor, compute_all
from afl_mujoco.scenario.belief import is_error
from afl_mujoco.scenario.imperfections import IDEAL_INPUT, Imperfection, imperfections_of
from afl_mujoco.scenario.sample_space import (
    SampleSpace,
    acting,
    draws_of,
    sample_point,
    search_generator,
)
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.time_steps import Deployed, ticks_of
from afl_mujoco.simulation.bound_controllers import bound
from afl_mujoco.simulation.judgement import require_start, written
from afl_mujoco.simulation.trajectory import controller_inputs
from afl_mujoco.studies.shared.contract import Interrupted, Progress, compute, silent
from afl_mujoco.studies.shared.run import Rows, Run, numbered, require_alike, run_all
from afl_mujoco.studies.shared.search import Budget, Threshold, find_threshold, minimise
from afl_mujoco.values import require_distinct

Scenarios = tuple[Scenario, ...]
Samples = dict[str, list[Run]]
"""Runs by controller, in the order of the samples."""

Hardware = dict[str, Any]
"""Imperfections and errors of the belief by name, as `Scenario.changed` takes them."""

TIMESTEP = 1e-3
"""Longest physics step, and unit of a control period that is scaled with all others [s]."""

MOST_SEEDS = MOST_LEVELS = 1000


def require_runs(
    controllers: Sequence[Controller], scenarios: Sequence[Scenario], deployed: Deployed
) -> None:
    """Raise if anything would break runs as deployed, before the first."""
    from afl_mujoco.simulation.mujoco_model import require_integrator

    given = any(c.interpreted and getattr(c, "spec", None) is None for c in controllers)
    hint = "; set __name__ on one of them" if given else ""
    require_distinct("controller", [controller.name for controller in controllers], hint)
    require_distinct("scenario", [scenario.name for scenario in scenarios])
    require_integrator(deployed.integrator)
    for scenario in scenarios:
        require_start(scenario)
        ticks_of(scenario, deployed.timestep, deployed.control_period)
        for controller in controllers:
            own = bound(controller, scenario)  # raises where it is of another plant
            controller_inputs(scenario, own, np.array([0.0, *scenario.breakpoints]))  # or a gain


# --- imperfections at a level -------------------------------------------------------------------

RAIL = "end_stops.z"
"""Not combined with the rest: the rail alone decides for a controller that does not know it."""

COMBINED = Imperfection(
    name="combined", title="all combined but the rail", unit="×", fields={},
    reference=1.0, benign=0.05, harsh=20.0,
)  # fmt: skip
"""All at once: each as many times worse than the reference hardware as the level says."""


def known_of(plant: Plant) -> dict[str, Imperfection]:
    """Return all that can be swept of a plant, by name."""
    return {one.name: one for one in (*imperfections_of(plant), COMBINED)}


KNOWN = known_of(CART_POLE)  # all that can be swept of a cart-pole, by name


def find_imperfection(name: str, plant: Plant = CART_POLE) -> Imperfection:
    """Return an imperfection of a plant by its name."""
    known = known_of(plant)
    if name not in known:
        raise UnknownNameError.among("imperfection", name, known)
    return known[name]


@functools.cache
def added(plant: Plant = CART_POLE) -> tuple[Imperfection, ...]:
    """Leave out imperfections that an earlier one sets too, and those that the plant writes."""
    found, set_before = [], {*written(plant)}
    for one in imperfections_of(plant):
        sets = {*one.fields, *one.switches}
        if not sets <= set_before:
            found.append(one)
        set_before |= sets
    return tuple(found)


def hardware_at(imperfection: Imperfection, level: float, plant: Plant = CART_POLE) -> Hardware:
    """Return one imperfection, or all combined, each so many times worse, at a level."""
    if imperfection.name != COMBINED.name:
        return imperfection.options(level)
    options: Hardware = {}
    for one in (one for one in added(plant) if one.name != RAIL):
        scaled = one.reference / level if one.less_is_worse else one.reference * level
        options |= one.options((max if one.less_is_worse else min)(scaled, one.harsh))
    if "control_period" in options:
        options["control_period"] = max(1, round(options["control_period"] / TIMESTEP)) * TIMESTEP
    return options


def less_is_worse(path: str) -> bool:
    """Return whether a smaller number of an imperfection is the harsher one."""
    return path in ("input_limit", "slew_rate") or path.startswith("end_stops")


def on_hardware(scenario: Scenario, hardware: Hardware) -> Scenario:
    """Return a scenario with imperfections on top of its own, of which the harsher counts.

    A milder control period could be worse than the scenario's own, where velocities are
    differences of quantised positions.
    """

    def on_top(own: Any, name: str, level: Any) -> Any:
        if is_error(name):
            return own + level
        if own is None:  # ideal
            return level
        if isinstance(own, Mapping):  # of inputs: each gets it, also one that the file leaves ideal
            every = {key: own.get(key, IDEAL_INPUT[name]) for key in scenario.plant.inputs}
            return {key: on_top(value, name, level) for key, value in every.items()}
        return min(own, level) if less_is_worse(name) else max(own, level)

    changes = {name: on_top(scenario.hardware(name), name, x) for name, x in hardware.items()}
    return scenario.changed(changes)


def referred(one: Imperfection, scenarios: Scenarios) -> Imperfection:
    """Return an imperfection whose reference is no milder than what a scenario has itself."""
    if one.adds:
        return one
    levels, harshest = [one.reference], min if one.less_is_worse else max
    for key, factor in list(one.fields.items())[:1]:  # all combined has none
        for scenario in scenarios:
            x = scenario.hardware(key)
            if isinstance(x, Mapping):
                units = {scenario.plant.units[name] for name in x}
                # a level in several units is of the mildest, at which nothing changes
                mixed = one.less_is_worse and len(units) > 1
                x = (max if mixed else harshest)(x.values(), default=None)
            levels += [x / factor] if x and x / factor > 0.0 else []
    return replace(one, reference=harshest(levels))


def times_reference(imperfection: Imperfection, level: float) -> float:
    """Return how many times worse than the reference a level is."""
    ratio = level / imperfection.reference
    return round(1.0 / ratio if imperfection.less_is_worse else ratio, 9)  # 10 is 10


def refused(
    scenarios: Scenarios, one: Imperfection, level: float, timestep: float | None = None
) -> str:
    """Return why scenarios cannot have a level, as a delay beyond their end; "" if they can."""
    try:
        for scenario in scenarios:
            asked = on_hardware(scenario, hardware_at(one, level, scenario.plant))
            ticks_of(asked, timestep)
            require_start(asked)
    except InvalidValueError as error:
        return str(error)
    return ""


def left_out(scenarios: Scenarios, one: Imperfection, timestep: float | None = None) -> str:
    """Return why an imperfection cannot be swept on top of what scenarios have; "" if it can."""
    own = referred(one, scenarios)
    if times_reference(own, one.harsh) <= 1.0:
        return "a scenario has it harsher than all that is tried"
    return refused(scenarios, own, own.reference, timestep)


# --- sweeps -------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """How thresholds are searched."""

    seeds: int = 4  # draws of noise and start, all of which must be survived
    scan: int = 13  # levels of the scan, and levels beside the threshold that must be survived
    tolerance: float = 0.02  # relative width to which bisection narrows a threshold [1]
    timestep: float | None = None  # [s]

    @property
    def deployed(self) -> Deployed:
        """How MuJoCo runs."""
        return Deployed(timestep=self.timestep)

    def require(self) -> None:
        """Raise if a number breaks its rule."""
        require_count("seeds", self.seeds, 1, MOST_SEEDS)
        require_count("scan", self.scan, 2, MOST_LEVELS)
        if not 1e-4 <= self.tolerance <= 1.0:
            raise InvalidValueError("tolerance", "must lie in 1e-4 to 1", self.tolerance)


class Swept(NamedTuple):
    """One controller under one imperfection: runs and thresholds."""

    reference: tuple[Run, ...]  # at the level of the reference hardware
    survives: Threshold
    settles: Threshold
    failure: tuple[Run, ...]  # at the mildest level found that is not survived; empty if none is
    applies: bool  # whether it acts on the controller: an error of a belief that it reads


class SweepUnit(NamedTuple):
    """What a worker sweeps: an imperfection by name, or "" for nothing added."""

    name: str
    controller: Controller
    scenarios: Scenarios
    settings: Settings


def survived(runs: Sequence[Run]) -> bool:
    """Return whether every run met its requirements."""
    return not any(run.failure for run in runs)


def all_settled(runs: Sequence[Run]) -> bool:
    """Return whether every run survived and was at rest at its end, required or not."""
    return survived(runs) and all(run.settled for run in runs)


def run_on(unit: SweepUnit, hardware: Hardware) -> tuple[Run, ...]:
    """Run a controller on every draw of the scenarios with imperfections on top of theirs."""
    _, controller, scenarios, settings = unit
    on_top = [on_hardware(one, hardware) for one in scenarios]
    draws = [draws_of(one, random=settings.seeds) for one in on_top]
    runs = iter(run_all(controller, [*itertools.chain(*draws)], settings.deployed))
    return tuple(run for each in draws for run in numbered(itertools.islice(runs, len(each))))


def sweep(unit: SweepUnit) -> Swept:
    """Find the levels up to which a controller survives an imperfection, and settles under it."""
    name, controller, scenarios, settings = unit
    plant = scenarios[0].plant
    one = referred(find_imperfection(name, plant), scenarios)
    if one.quantum and (h := settings.timestep):  # levels are whole numbers of steps, too
        one = replace(one, quantum=math.ceil(one.quantum / h - 1e-9) * h)

    @functools.cache
    def at(level: float) -> tuple[Run, ...]:
        return run_on(unit, hardware_at(one, level, plant))

    scan = np.geomspace(one.benign, one.harsh, settings.scan).tolist()
    scan = [x for x in map(one.snapped, scan) if not refused(scenarios, one, x, settings.timestep)]

    def threshold(holds: Callable[[float], bool], closer: int = 0) -> Threshold:
        return find_threshold(holds, scan, settings.tolerance, one.snapped, closer=closer)

    def harshness(found: Threshold) -> float:
        return math.inf if found.fails_at is None else times_reference(one, found.fails_at)

    if one.of_belief:  # nothing is to be found where it does not change a bit of any run
        runs = [(a, b) for x in (one.reference, scan[-1])
                for a, b in zip(run_on(unit, {}), at(x), strict=True)]  # fmt: skip
        if all(a.metrics == b.metrics and a.time == b.time and not b.message for a, b in runs):
            holds = Threshold(holds_at=scan[-1], fails_at=None)
            return Swept(at(one.reference), holds, holds, (), False)
    survives = threshold(lambda level: survived(at(level)), settings.scan)
    settles = threshold(lambda level: all_settled(at(level)))
    first = on_hardware(scenarios[0], hardware_at(one, one.reference, plant))
    (drawn, *_) = draws_of(first, random=settings.seeds)
    require_alike(controller, drawn, at(one.reference)[0], settings.deployed)
    return Swept(
        reference=at(one.reference),
        survives=survives,
        settles=min(settles, survives, key=harshness),  # what is not survived is not settled
        failure=() if survives.fails_at is None else at(survives.fails_at),
        applies=True,
    )


# --- samples, and the worst of them -------------------------------------------------------------

CHUNK, PIECE = 20, 4
"""Number of samples, and of points of a generation, that a worker runs at a time."""

HARDEST, NEAREST = "hardest", "nearest"
"""What is searched: the hardest sample, and the failure nearest to the scenario itself."""

STEP = {HARDEST: 0.3, NEAREST: 0.1}
"""Standard deviation at the start of a search, as a share of the cube's edge."""


def _run_points(
    controller: Controller, space: SampleSpace, seed: int, deployed: Deployed, unit: Any
) -> list[Run]:
    """Run a controller at points of the cube, each with the number of a sample, for its noise."""
    points, numbers = unit
    scenarios = [space.scenario_of(x, i, seed) for x, i in zip(points, numbers, strict=True)]
    runs = run_all(controller, scenarios, deployed)
    return [replace(run, draw=i) for run, i in zip(runs, numbers, strict=True)]


def _run_samples(space: SampleSpace, seed: int, deployed: Deployed, unit: Any) -> list[Run]:
    """Run a controller on samples by their numbers; their points are drawn by the worker."""
    controller, numbers = unit
    points = [sample_point(space, i, seed) for i in numbers]
    runs = _run_points(controller, space, seed, deployed, (points, numbers))
    require_alike(controller, space.scenario_of(points[0], numbers[0], seed), runs[0], deployed)
    return runs


def sample(
    controllers: Sequence[Controller],
    space: SampleSpace,
    count: int,
    seed: int,
    deployed: Deployed,
    progress: Progress = silent,
    workers: int = 1,
    cluster: str | None = None,
) -> Samples:
    """Run controllers on the same samples; sample i depends on neither workers nor count.

    A Ctrl-C raises `Interrupted` with the samples that every controller has done.
    """
    chunks = [range(i, min(i + CHUNK, count)) for i in range(0, count, CHUNK)]
    units = [(one, chunk) for chunk in chunks for one in controllers]
    names = [one.name for one, _ in units]
    run = partial(_run_samples, space, seed, deployed)
    kept: dict[int, list[Run]] = {}
    try:
        compute(run, units, "sampling", progress, workers, names, cluster, kept)
    except KeyboardInterrupt:
        each = len(controllers)  # a chunk counts where each of them has done it
        places = (range(i, i + each) for i in range(0, len(units), each))
        whole = list(itertools.takewhile(lambda chunk: kept.keys() >= set(chunk), places))
        if not whole:
            raise
        done = _in_order(names[: each * len(whole)], kept)
        raise Interrupted(done, f"{len(done[names[0]])} of {count} samples") from None
    return _in_order(names, kept)


def _in_order(names: Sequence[str], kept: Mapping[int, list[Run]]) -> Samples:
    runs: Samples = {name: [] for name in names}
    for place, name in enumerate(names):
        runs[name] += kept[place]
    return runs


@dataclass(frozen=True, slots=True, kw_only=True)
class Worst:
    """What a search found for one controller."""

    controller: str
    question: str  # HARDEST or NEAREST
    run: Rows  # one; its draw is the number of the sample whose noise it has
    point: tuple[float, ...]  # in the cube
    distance: float  # from the scenario itself, as a share of the cube's diagonal
    tried: int  # runs that the search took
    file: str = ""  # its scenario file beside the result


def search_worst(
    controller: Controller,
    space: SampleSpace,
    runs: Sequence[Run],
    seed: int,
    budget: Budget,
    deployed: Deployed,
    executor: Executor,
    progress: Callable[[int], None] = lambda runs: None,
) -> list[Worst]:
    """Search for a controller's hardest sample, then for its failure nearest to the scenario.

    The second starts from the nearest failure known, which may be the scenario itself. Each keeps
    the noise of the sample that it starts from, so that its cost function does not change and it
    finds nothing milder than what was known. There is no second search if nothing fails, and none
    at all if nothing passes.
    """
    rng, spent = search_generator(seed), 0

    def at(points: Sequence[Floats], noise: int) -> list[Run]:
        pieces = [points[i : i + PIECE] for i in range(0, len(points), PIECE)]
        units = [(piece, [noise] * len(piece)) for piece in pieces]
        run = partial(_run_points, controller, space, seed, deployed)
        return [one for some in compute_all(run, units, executor) for one in some]

    def cost(question: str, point: Floats, run: Run) -> float:
        severity = run.severity(space.scenario)
        if question == HARDEST:
            return -severity
        # every failure ranks before every run that passes; of those the most severe ranks first
        return distance_of(space, point) if run.failure else 2.0 - severity

    def search(question: str, start: Floats, noise: int) -> Worst:
        def costs(points: list[Floats]) -> list[float]:
            nonlocal spent
            found = at(points, noise)
            spent += len(points)
            progress(spent)
            return [cost(question, x, run) for x, run in zip(points, found, strict=True)]

        point, tried = minimise(costs, start, STEP[question], rng, budget)
        return Worst(
            controller=controller.name,
            question=question,
            run=tuple(at([point], noise)),
            point=tuple(point.tolist()),
            distance=distance_of(space, point),
            tried=tried,
        )

    if all(run.failure for run in runs):
        return []
    points = [sample_point(space, i, seed) for i in range(len(runs))]
    worst = int(np.argmax([run.severity(space.scenario) for run in runs]))
    hardest = search(HARDEST, points[worst], worst)
    known = [(points[i], i) for i, run in enumerate(runs) if run.failure]
    known += [(np.array(hardest.point), run.draw) for run in hardest.run if run.failure]
    itself = space.reference
    known += [(itself, run.draw) for run in at([itself], worst) if run.failure]
    if not known:
        return [hardest]
    return [hardest, search(NEAREST, *min(known, key=lambda one: distance_of(space, one[0])))]


def worst_scenario(space: SampleSpace, worst: Worst, seed: int) -> Scenario:
    """Return the scenario that a search found."""
    scenario = space.scenario_of(worst.point, worst.run[0].draw, seed)
    return replace(scenario, name=f"{scenario.name}-{worst.question}")


def changes_of(space: SampleSpace, point: ArrayLike) -> dict[str, float]:
    """Return how far acting coordinates are from the scenario, as shares of their ranges."""
    away = np.asarray(point) - space.reference
    moved = acting(dict(zip(space.coordinates, away.tolist(), strict=True)))
    return dict(sorted(moved.items(), key=lambda item: (-abs(item[1]), item[0])))


def distance_of(space: SampleSpace, point: ArrayLike) -> float:
    """Return how far a point is from the scenario, as a share of the cube's diagonal."""
    away = np.asarray(point) - space.reference
    moved = acting(dict(zip(space.coordinates, away.tolist(), strict=True)))
    return float(np.linalg.norm(list(moved.values())) / np.sqrt(space.dimension))


# --- starts -------------------------------------------------------------------------------------


def _run_row(deployed: Deployed, unit: tuple[Controller, list[Scenario]]) -> list[Run]:
    controller, scenarios = unit
    runs = run_all(controller, scenarios, deployed)
    require_alike(controller, scenarios[0], runs[0], deployed)
    return runs


def map_starts(
    controllers: Sequence[Controller],
    scenario: Scenario,
    axes: tuple[str, str],
    levels: tuple[Floats, Floats],
    deployed: Deployed,
    progress: Progress = silent,
    workers: int = 1,
    cluster: str | None = None,
) -> list[Run]:
    """Run controllers from every level of two states, row by row, and last from its own start."""
    across, along = (scenario.plant.states.index(name) for name in axes)

    def start(x: float, y: float) -> Scenario:
        state = list(scenario.initial_state)
        state[across], state[along] = x, y
        return replace(scenario, initial_state=tuple(state))

    rows = [[start(x, y) for x in levels[0].tolist()] for y in levels[1].tolist()]
    units = [(one, row) for one in controllers for row in (*rows, [scenario])]
    names = [one.name for one, _ in units]
    row = partial(_run_row, deployed)
    found = compute(row, units, "mapping", progress, workers, names, cluster)
    each = len(levels[0]) * len(levels[1]) + 1
    runs = [run for some in found for run in some]
    return [replace(run, draw=k % each) for k, run in enumerate(runs)]
