"""Compute gain, phase, disk and delay margins of controllers."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields, replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.controller import Controller
from afl_mujoco.control.names import INFORMED, chosen
from afl_mujoco.errors import AflMujocoError, InvalidValueError, require_count
from afl_mujoco.report.blocks import Block, Cell, Figure, Matrix, Report
from afl_mujoco.report.markdown import plain
from afl_mujoco.report.numbers import MISSING, fixed, listed, percent, short
from afl_mujoco.scenario.files import find_scenario
from afl_mujoco.scenario.parameters import CART_MASSES, HALF_LENGTHS
from afl_mujoco.scenario.ranges import FIXED, Ranges
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.time_steps import Deployed, whole_steps
from afl_mujoco.simulation.bound_controllers import bound
from afl_mujoco.simulation.mujoco_model import SimulatedModel
from afl_mujoco.simulation.sampled.runs import simulate_sampled
from afl_mujoco.simulation.trajectory import COMPLETED, DIVERGED, Trajectory
from afl_mujoco.studies.shared.contract import Progress, ScenarioIfAny, Study, compute, silent
from afl_mujoco.studies.shared.loop_margins import (
    LINEAR,
    STEP,
    Margins,
    NotSmoothError,
    linear_part,
    linearize,
    loop_margins,
    require_rest,
    target_of,
)
from afl_mujoco.studies.shared.search import find_threshold, scan_levels
from afl_mujoco.studies.shared.tables import heat
from afl_mujoco.values import require_distinct, require_positive

if TYPE_CHECKING:
    import mujoco

PERIOD, LONGEST_PERIOD = 1e-3, 10.0
"""Default control period, and the longest [s]: no plant of a laboratory takes longer to fall."""

LEVELS, QUICK_LEVELS = 5, 2  # of each parameter that varies
MOST_PLANTS = 10_000
CONTINUOUS, HELD, MEASURED = "continuous", "held", "measured"
"""Loops: linear and continuous, linear with held inputs, and small motions in MuJoCo."""

METRICS = tuple(one.name for one in fields(Margins))  # the margins, in their order
GROWS_WORSE = ("gain_decrease", "crossover")  # the margins whose largest value is the worst


@dataclass(frozen=True, kw_only=True)
class Options:
    """Compute gain, phase, disk and delay margins of controllers about the target of a plant.

    Example: afl-mujoco margins my-rig.toml --controllers lqr my_controller:control

    The loop is linearised by finite differences in MuJoCo and broken at each input, over the plants
    that the scenario's schedules and ranges allow. On some of the plants the study also measures
    the delay at which a small motion in MuJoCo grows; of controllers with a memory or an estimator,
    or without slopes, the gains too. A coordinate that nothing depends on, such as the angle of a
    wheel that only spins, is left out. Writes margins.json and a figure.
    """

    scenario: ScenarioIfAny = None
    """Scenario by name, or TOML file, that gives the plants, the control period and the linear
    imperfections; by default the paper's range of cart-poles, without imperfections."""
    controllers: tuple[str, ...] = ()
    """Controllers by name, or module:attribute of your own; by default all that are compiled and
    know the true M and l, of another plant lqr."""
    levels: int | None = None
    """Levels of each parameter that varies, from its least to its largest; 5 by default."""
    control_period: float | None = None
    """How long the sampled loop holds its inputs [s]; the scenario's, or 0.001, by default."""
    timestep: float | None = None
    """Physics step of MuJoCo where motions are measured [s]; by default the longest up to 0.001
    that divides the control period."""
    quick: bool = False
    """Only the least and the largest of each parameter, and two plants measured."""
    measure: bool = True
    """Do not measure the delay that the loop in MuJoCo tolerates on some of the plants."""


class Point(NamedTuple):
    """A controller on one plant at rest."""

    controller: Controller
    scenario: Scenario  # of constant parameters
    period: float = PERIOD  # of the held inputs [s]
    timestep: float | None = None  # [s]; None for the longest up to 1 ms that divides the period
    varied: tuple[str, ...] = ()  # the parameters in which it differs from others

    @property
    def linear(self) -> Point:
        """The same with what a linear loop can have, and the controller designed for the plant."""
        own, r = bound(self.controller, self.scenario), self.scenario.imperfections
        linear = replace(linear_part(r), input_limit=r.input_limit)  # what holds it is within
        return self._replace(controller=own, scenario=replace(self.scenario, imperfections=linear))

    def row(self, loop: str, name: str, stable: bool, **found: float | None) -> Row:
        """Return what was found at an input."""
        nominal = self.scenario.nominal
        return Row(
            controller=self.controller.name, loop=loop, input=name,
            parameters={key: nominal[key] for key in self.varied}, stable=stable, **found,
        )  # fmt: skip


class Request(NamedTuple):
    """What is surveyed: controllers on a grid of parameters."""

    scenario: Scenario
    controllers: Sequence[Controller]
    axes: Mapping[str, tuple[float, ...]]  # the levels of each parameter that varies
    period: float = PERIOD
    timestep: float | None = None
    measured: Sequence[tuple[float, ...]] = ()  # the plants that are measured too

    @property
    def plants(self) -> list[tuple[float, ...]]:
        """The values of the parameters that vary, of each plant."""
        return list(itertools.product(*self.axes.values()))

    def point(self, controller: Controller, plant: Iterable[float]) -> Point:
        """Return a controller on a plant."""
        s, asked = self.scenario, self.scenario.requirements
        here = replace(
            s,
            schedule={**s.nominal, **dict(zip(self.axes, plant, strict=True))},
            disturbances=(),
            requirements=replace(asked, completes=False, settling_time=None, recover_within=None),
            ranges=FIXED,
            belief=s.belief.known(s.nominal),
        )
        return Point(controller, here, self.period, self.timestep, tuple(self.axes))

    def require(self) -> Request:
        """Raise unless one controller has slopes, or small motions, on the first plant."""
        if require_positive("control_period", self.period) > LONGEST_PERIOD:
            rule = f"must be at most {LONGEST_PERIOD:g} s"
            raise InvalidValueError("control_period", rule, f"{self.period:g}")
        if not self.scenario.plant.inputs:
            rule = "must have an input at which a loop is broken"
            raise InvalidValueError(f"plant {self.scenario.plant.name!r}", rule)
        require_distinct("controller", [one.name for one in self.controllers])
        refused = [refusal(self.point(one, self.plants[0])) for one in self.controllers]
        if refused[0] is not None and None not in refused:
            raise refused[0]
        if self.timestep is not None:
            whole_steps("control_period", self.period, "timestep", self.timestep)
        return self


def prepare(options: Options) -> Request:
    """Return what the options ask for, or raise if a rule is broken."""
    from afl_mujoco.control.catalogue import find_controller

    o = options
    scenario = PAPER if o.scenario is None else find_scenario(o.scenario)
    levels = o.levels if o.levels is not None else QUICK_LEVELS if o.quick else LEVELS
    require_count("levels", levels, 2, MOST_PLANTS)
    spans = {**scenario.spans, **scenario.ranges.varied}
    varied = [name for name in scenario.plant.parameters if spans[name][0] < spans[name][1]]
    axes = {name: tuple(np.linspace(*spans[name], levels).tolist()) for name in varied}
    if (count := levels ** len(axes)) > MOST_PLANTS:
        rule = f"must make at most {MOST_PLANTS} plants of {', '.join(axes)}"
        raise InvalidValueError("levels", rule, f"{levels}, which makes {count}")
    own = scenario.imperfections.control_period
    period = o.control_period if o.control_period is not None else own or PERIOD
    controllers = [find_controller(name) for name in chosen(o.controllers, [scenario], INFORMED)]
    request = Request(scenario, controllers, axes, period, o.timestep).require()
    measured = measured_plants(axes, few=o.quick) if o.measure else ()
    return request._replace(measured=measured)


_ENDS = {"cart_mass": CART_MASSES, "half_length": HALF_LENGTHS}
PAPER = Scenario(
    name="the paper's cart-poles",
    ranges=Ranges(varied={name: (some[0], some[-1]) for name, some in _ENDS.items()}),
)


def measured_plants(
    axes: Mapping[str, tuple[float, ...]], *, few: bool = False
) -> list[tuple[float, ...]]:
    """Return both ends of a grid; of two parameters, unless `few`, corners and two middles."""
    ends = [(values[0], values[-1]) for values in axes.values()]
    if few or len(axes) != 2:
        return list(dict.fromkeys(zip(*ends, strict=True))) if axes else [()]
    low, high = ends[1]
    middle = math.sqrt(low * high) if low > 0.0 else 0.5 * (low + high)
    near = min(list(axes.values())[1], key=lambda x: abs(x - middle))
    return list(dict.fromkeys(itertools.product(ends[0], (low, near, high))))


# --- what is found ------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """What a loop tolerates at one input; a delay is 0 below `DELAYS`, None beyond or unsought."""

    controller: str
    loop: str  # `CONTINUOUS`, `HELD` or `MEASURED`
    input: str
    parameters: dict[str, float]  # those that vary
    stable: bool
    gain_decrease: float | None = None  # as in `Margins`
    gain_increase: float | None = None
    phase: float | None = None
    delay: float | None = None
    crossover: float | None = None
    disk: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """Margins by controller, loop, input and plant."""

    scenario: str
    control_period: float  # how long the sampled loop holds its inputs [s]
    imperfections: str  # those of the linear loop, by their keys; "none" for the ideal loop
    left_out: tuple[str, ...]  # those that it cannot have
    linearisation_step: float  # of the central differences [m, rad, m/s, rad/s, N]
    units: dict[str, str]  # of the parameters that vary
    plants: int
    rows: tuple[Row, ...]
    # why each of the other controllers has no linear margins, by its name
    not_linear: dict[str, str] = field(default_factory=dict)

    @property
    def controllers(self) -> tuple[str, ...]:
        """The controllers with linear margins."""
        return tuple(dict.fromkeys(row.controller for row in self.rows if row.loop == HELD))

    @property
    def inputs(self) -> tuple[str, ...]:
        """The inputs of the plant."""
        return tuple(dict.fromkeys(row.input for row in self.rows))

    def of(self, controller: str, loop: str, name: str | None = None) -> list[Row]:
        """Return the rows of one loop of a controller, of one input or of all."""
        rows = [x for x in self.rows if (x.controller, x.loop) == (controller, loop)]
        return [row for row in rows if name in (None, row.input)]

    def worst(self, controller: str, loop: str, metric: str, name: str | None = None) -> Row | None:
        """Return the row with the worst value of a margin where the loop is stable, if any."""
        stable = [row for row in self.of(controller, loop, name) if row.stable]
        pick = max if metric in GROWS_WORSE else min
        return pick(stable, key=lambda row: value_of(row, metric), default=None)


def value_of(row: Row, metric: str) -> float:
    """Return a margin, where there is none the most benign value."""
    found: float | None = getattr(row, metric)
    if found is None:
        return -math.inf if metric in GROWS_WORSE else math.inf
    return found


# --- margins of the linearised loops ------------------------------------------------------------


def run(request: Request, *, progress: Progress = silent, workers: int = 1) -> Result:
    """Survey the margins and measure delays; the result does not depend on the workers."""
    r, s = request, request.scenario
    reasons = ((one.name, why_not_linear(one)) for one in r.controllers)
    not_linear = {name: reason for name, reason in reasons if reason is not None}
    linear = [one for one in r.controllers if one.name not in not_linear]
    points = [r.point(one, plant) for one in linear for plant in r.plants]
    rows: list[Row] = []
    found = compute(margins_at, points, "linearising", progress, workers)
    for point, some in zip(points, found, strict=True):
        if isinstance(some, AflMujocoError):
            not_linear.setdefault(point.controller.name, str(some))
        else:
            rows += some
    units = [
        (r.point(one, plant), one.name not in not_linear)
        for one in sorted(r.controllers, key=lambda one: one.name in not_linear)
        for plant in r.measured
    ]
    measured = compute(measure, units, "measuring", progress, workers)
    for (point, _), some in zip(units, measured, strict=True):
        if isinstance(some, AflMujocoError):
            not_linear[point.controller.name] = str(some)
        else:
            rows += some
    departing = s.imperfections.departing()
    left_out = [x for x in departing if x.partition(".")[0] not in (*LINEAR, "seed")]
    counting = replace(linear_part(s.imperfections), control_period=None).departing()
    text = "; ".join(f"{name} = {json.dumps(value)}" for name, value in counting.items())
    return Result(
        scenario=s.name,
        control_period=r.period,
        imperfections=text or "none",
        left_out=tuple(left_out),
        linearisation_step=STEP,
        units={name: s.plant.units[name] for name in r.axes},
        plants=len(r.plants),
        rows=tuple(x for x in rows if x.loop == MEASURED or x.controller not in not_linear),
        not_linear=not_linear,
    )


def why_not_linear(controller: Controller) -> str | None:
    """Return what a linearisation of a controller would leave out; None if nothing."""
    if controller.estimates:
        return "has an estimator, which a linearisation leaves out"
    if controller.interpreted and controller.stateful:
        return "has a memory, which a linearisation leaves out"
    return None


def refusal(point: Point) -> AflMujocoError | None:
    """Return why a controller has neither linear margins nor small motions; None if it has."""
    try:
        here = point.linear
        if why_not_linear(here.controller) is None:
            with suppress(NotSmoothError):
                linearize(here.controller, here.scenario)
                return None
        inputs_at_rest(here)
    except AflMujocoError as error:
        return error
    return None


def margins_at(point: Point) -> list[Row] | AflMujocoError:
    """Return margins of the continuous and of the held loop, or why there is no linearisation."""
    try:
        point = point.linear
        loop = linearize(point.controller, point.scenario)
    except AflMujocoError as error:
        return error
    rows = []
    for kind, period in ((CONTINUOUS, None), (HELD, point.period)):
        found = loop_margins(loop, period, point.scenario.imperfections)
        for i, name in enumerate(loop.inputs):
            own = {} if found is None else asdict(found[i])
            finite = {key: x if math.isfinite(x) else None for key, x in own.items()}
            rows.append(point.row(kind, name, found is not None, **finite))
    return rows


# --- small motions in MuJoCo --------------------------------------------------------------------

START = 1e-3  # deviation at the start of a measurement [rad, m], small for the linearisation

DURATION, PARTS = 20.0, 5
"""Length of a run [s], and the number of parts into which it is cut. A motion decays if it is no
larger in the last part than in the first and in the one before the last."""

DECAYED = 1e-6
"""Share of the deviation at the start below which what is left may be round-off."""

SMALL = 10.0 * START
"""Largest deviation in the last part [rad, m]: the motion may have grown into a limit cycle, which
no longer grows."""

TOLERANCE = 1e-3  # relative tolerance of the delay that is compared with a margin [1]
DELAY = 0.05  # delay around which a threshold is sought if there is no margin [s]
REACH = 5e-3  # relative difference up to which margin and measurement agree [1]

GAINS = scan_levels(1.0, 100.0, 13)
"""Factors on an input that are tried, and their inverses, before the bisection [1]."""

DELAYS = scan_levels(1e-4, 1.0, 13)  # delays that are tried before the bisection [s]
ROUGHLY = 1e-2  # relative tolerance of what is measured of a controller without linear margins [1]
AT_REST = 1.0  # length of the run that shows whether the target is an equilibrium [s]
STILL = 1e-6  # how far inputs may stray in it [N, N m] and the state end from its target [m, rad]


def measure(unit: tuple[Point, bool]) -> list[Row] | AflMujocoError:
    """Return what one loop tolerates in MuJoCo, gains too if it is not linear; or why not."""
    (point, linear), rows = unit, []
    try:
        point = point.linear
        if linear:
            loop = linearize(point.controller, point.scenario)
            found = loop_margins(loop, point.period, point.scenario.imperfections)
            held: Sequence[float] = loop.held
        else:
            held = inputs_at_rest(point)
        stable = motion_decays(point, Change(held=held))
        for i, name in enumerate(point.scenario.plant.inputs):
            least = partial(_least, point, i, held)
            tolerated: dict[str, float | None] = {}
            if linear:
                about = found[i].delay if found is not None else math.inf
                about = about if math.isfinite(about) else DELAY
                scan = scan_levels(about / 5.0, min(about * 5.0, 0.9 * DURATION), 7)
                tolerated["delay"] = least("delay", scan, TOLERANCE) or None
            elif stable:
                tolerated["gain_decrease"] = least("gain", [1.0 / x for x in GAINS])
                tolerated["gain_increase"] = least("gain", GAINS)
                tolerated["delay"] = least("delay", DELAYS)
            rows.append(point.row(MEASURED, name, stable, **tolerated))
    except AflMujocoError as error:
        return error
    return rows


class Change(NamedTuple):
    """What is changed of a loop at one of its inputs."""

    place: int = 0  # which of them
    held: Sequence[float] = ()  # the inputs at rest, which act until the first command does
    delay: float = 0.0  # a transport delay on top of that of the imperfections [s]
    gain: float = 1.0  # a factor on its deviation from rest


def _least(
    point: Point, place: int, held: Sequence[float], what: str, scan: list[float],
    tolerance: float = ROUGHLY,
) -> float | None:  # fmt: skip
    """Return the delay or gain from which a small motion grows; 0 below the scan, None beyond."""

    def holds(level: float) -> bool:
        changed: Any = {what: level}
        return motion_decays(point, Change(place, held, **changed))

    found = find_threshold(holds, scan, tolerance)
    if found.fails_at is None:
        return None
    return 0.0 if found.holds_at is None else math.sqrt(found.holds_at * found.fails_at)


def inputs_at_rest(point: Point) -> list[float]:
    """Raise where the loop has its equilibrium elsewhere: small motions say nothing of it."""
    thing = f"small motions of {point.controller.name!r}"
    r = replace(point.scenario.imperfections, delay=0.0, lag=0.0)  # before them nothing is exerted
    prompt = point._replace(scenario=replace(point.scenario, imperfections=r))
    run = small_motion(prompt, Change(), 0.0, AT_REST)
    inputs = run.input.reshape(len(run.time), -1)
    model = SimulatedModel(point.scenario.plant, imperfections=r)
    model.write(point.scenario.values_at(0.0))
    strayed = np.flatnonzero(~(np.abs(inputs - inputs[0]).max(axis=1) <= STILL))
    for at in (0, *strayed[:1].tolist()):
        require_rest(thing, point.scenario, inputs[at], model)
    if not np.abs(run.state[-1] - run.state[0]).max() <= STILL:
        rule = "must be about an equilibrium: its inputs must hold the plant at its target"
        raise InvalidValueError(thing, rule)
    run = small_motion(point, Change(), START, AT_REST)
    if run.outcome.kind == DIVERGED:
        raise InvalidValueError(thing, "must have finite inputs", f"diverged {run.outcome.time} s")
    return [float(x) for x in inputs[0]]


def motion_decays(point: Point, change: Change) -> bool:
    """Return whether a small motion about the target decays in MuJoCo."""
    run = small_motion(point, change, START, DURATION)
    if run.outcome.kind != COMPLETED:
        return False
    return decays(np.abs(run.state - target_of(point.scenario)))


def decays(away: NDArray[np.float64]) -> bool:
    """Return whether deviations along a motion decay, those of coordinates to something small."""
    peaks = np.array([part.max(axis=0) for part in np.array_split(away, PARTS)])
    least = np.maximum(np.minimum(peaks[0], peaks[-2]), DECAYED * START)
    return bool((peaks[-1] <= least).all() and (peaks[-1, : away.shape[1] // 2] <= SMALL).all())


def small_motion(point: Point, change: Change, start: float, duration: float) -> Trajectory:
    """Return a run from a deviation [m, rad] in sampled mode, of whole control periods."""
    controller, s, period, timestep, _ = point
    r, plant, i = s.imperfections, s.plant, change.place
    name = plant.inputs[i]
    delays = {one: r.of_input("delay", one) + change.delay * (one == name) for one in plant.inputs}
    scenario = replace(
        s,
        name="small motion",
        duration=max(1, round(duration / period)) * period,
        initial_state=target_of(s) + np.repeat([start, 0.0], len(s.target)),
        imperfections=replace(r, control_period=None, delay=delays, input_limit=None),
    )

    def amplify(spec: mujoco.MjSpec) -> None:
        from mujoco import mjtBias

        if change.gain != 1.0:
            motor = spec.actuators[i]
            motor.biastype = mjtBias.mjBIAS_AFFINE
            motor.biasprm[0] = (1.0 - change.gain) * change.held[i] * motor.gainprm[0]
            motor.gainprm[0] *= change.gain

    model = SimulatedModel(plant, edit=amplify, imperfections=scenario.imperfections)
    model.compute_only()
    deployed = Deployed(timestep=timestep, control_period=period)
    return simulate_sampled(scenario, controller, deployed, model=model, held=change.held)


# --- what is shown ------------------------------------------------------------------------------

SHORT, LONG = 0.005, 0.02
"""Delays [s] that a loop should tolerate: that of a slow bus, and one that few drives exceed."""

GRADES = ("unstable", "less than 5 ms", "5 to 20 ms", "20 ms or more", "not measured")
"""What a delay margin is worth, worst first."""

SHOWN = {
    "Gain down to": ("gain_decrease", 2, 1.0),
    "Gain up to": ("gain_increase", 1, 1.0),
    "Phase [°]": ("phase", 1, 1.0),
    "Disk": ("disk", 2, 1.0),
    "Delay [ms]": ("delay", 2, 1e3),
}
"""Margin, decimals and factor of each column of the table."""


def report(result: Result) -> Report:
    """Return what is shown of margins."""
    r = result
    held = f"inputs held {short(1e3 * r.control_period)} ms"
    blocks: list[Block] = []
    if r.imperfections != "none" or r.left_out:
        said = f"Imperfections of {r.scenario} that count: {r.imperfections}; "
        left = listed(r.left_out, "and") or "none"
        said += "a delay counts in held loops only; " * ("delay" in r.imperfections)
        blocks.append(plain(f"{said}that a linear loop cannot have: {left}."))
    if r.rows:
        plants, cells = _delays(r)
        grades, texts = ([[one[k] for one in row] for row in cells.values()] for k in (0, 1))
        blocks += [
            Figure(
                name="margins-delay",
                title=f"Delay margin [ms], {held}",
                caption="On the plants at the ends of the ranges, and a middle.",
                draw=partial(heat, [*cells], plants, grades, texts, GRADES),
            ),
            _table(r, held),
        ]
    if r.not_linear:
        reasons = (plain(f"{name}: {reason}") for name, reason in r.not_linear.items())
        blocks.append("\n".join(f"- {reason}" for reason in reasons))
    least = [f"{name} {_said(r, name)}" for name in (*r.controllers, *r.not_linear)]
    return Report(headline=f"Least delay margin: {' · '.join(least)}", blocks=blocks)


def _said(result: Result, name: str) -> str:
    rows = result.of(name, HELD if name in result.controllers else MEASURED)
    if not rows:
        return "has none"
    if unstable := sum(not row.stable for row in rows):
        count, of = unstable // len(result.inputs), len(rows) // len(result.inputs)
        return f"unstable on {count} of {of} plant{'s' * (of != 1)}"
    return f"{_text(min(rows, key=lambda row: value_of(row, 'delay')))} ms"


def _text(row: Row, metric: str = "delay", decimals: int = 1, factor: float = 1e3) -> str:
    """Return a margin; of a small motion that it is beyond all that was tried."""
    value: float | None = getattr(row, metric)
    if row.loop == MEASURED and not value:
        delay = f"> {1e3 * DELAYS[-1]:g}" if value is None else f"< {1e3 * DELAYS[0]:g}"
        beyond = {"gain_decrease": f"< {1 / GAINS[-1]:.2g}", "gain_increase": f"> {GAINS[-1]:g}"}
        return {**beyond, "delay": delay}.get(metric, MISSING)
    return "∞" if value is None else fixed(factor * value, decimals)


def _place(result: Result, parameters: Mapping[str, float], between: str = ", ") -> str:
    return between.join(f"{x:.3g} {result.units[name]}" for name, x in parameters.items())


def _delays(result: Result) -> tuple[list[str], dict[str, list[tuple[int, str]]]]:
    """Return the plants that were measured, or the ends, and graded delay margins on them."""
    rows = [row for row in result.rows if row.loop == MEASURED]
    rows = rows or [row for row in result.rows if row.loop == HELD]
    plants = list({tuple(row.parameters.items()): None for row in rows})
    if len(plants) > 6:
        plants = [plants[0], plants[-1]]
    cells: dict[str, list[tuple[int, str]]] = {}
    names = dict.fromkeys(row.controller for row in result.rows)
    for controller, name in itertools.product(names, result.inputs):
        kind = HELD if controller in result.controllers else MEASURED
        known = {tuple(x.parameters.items()): x for x in result.of(controller, kind, name)}
        label = controller if len(result.inputs) == 1 else f"{controller}, {name}"
        cells[label] = [_graded(known.get(plant)) for plant in plants]
    return [_place(result, dict(plant), "\n") for plant in plants], cells


def _graded(row: Row | None) -> tuple[int, str]:
    if row is None:
        return 4, MISSING
    if not row.stable:
        return 0, "unstable"
    return 1 + sum(value_of(row, "delay") >= least for least in (SHORT, LONG)), _text(row)


def _table(result: Result, held: str) -> Matrix:
    r, several = result, len(result.inputs) > 1
    shown = [(name, kind) for name in r.controllers for kind in (CONTINUOUS, HELD)]
    shown += [(name, MEASURED) for name in r.not_linear]
    rows: list[list[Cell | str]] = []
    for (name, kind), one in itertools.product(shown, r.inputs):
        some = r.of(name, kind, one)
        unstable = sum(not row.stable for row in some)
        worst = [r.worst(name, kind, metric, one) for metric, *_ in SHOWN.values()]
        cells = [MISSING if row is None else _text(row, *how)
                 for row, how in zip(worst, SHOWN.values(), strict=True)]  # fmt: skip
        place = "" if worst[-1] is None else _place(r, worst[-1].parameters)
        count = Cell(f"{unstable} of {len(some)}" if some else MISSING, "bad" if unstable else "")
        measured = _measured(r, name, one) if kind == HELD else MISSING
        rows.append([name, *[one] * several, kind, count, *cells, place, measured])
    return Matrix(
        caption=f"Worst margins over {r.plants} plant{'s' * (r.plants != 1)}, {held}, where the "
        "delay margin is least, "
        f"and how far from it the delay is from which a motion of {short(1e3 * START)} mrad grows "
        "in MuJoCo",
        columns=[
            *("Controller", "Input")[: 1 + several], "Loop", "Unstable",
            *SHOWN, f"At {', '.join(r.units)}".strip(), "Measured",
        ],
        rows=rows,
    )  # fmt: skip


def _measured(result: Result, name: str, one: str) -> Cell:
    """Return the largest difference of the delays measured on some plants from the margins."""
    linear = {str(row.parameters): row for row in result.of(name, HELD, one)}
    pairs = [(linear[str(row.parameters)], row) for row in result.of(name, MEASURED, one)]
    away = [x for pair in pairs if (x := difference(*pair)) is not None]
    most = max(away, key=abs, default=None)
    text = "+" * (most is not None and most > 0.0) + percent(most, 2)
    return Cell(text, "" if all(agree(*pair) for pair in pairs) else "bad")


def difference(linear: Row, measured: Row) -> float | None:
    """Return the relative difference of a measured delay from the margin [1]; None without both."""
    if not linear.stable or linear.delay is None or measured.delay is None:
        return None
    return measured.delay / linear.delay - 1.0


def agree(linear: Row, measured: Row) -> bool:
    """Return whether they differ by no more than `REACH`, or neither has a delay."""
    away = difference(linear, measured)
    if away is None:
        return (linear.delay, linear.stable) == (measured.delay, measured.stable)
    return abs(away) <= REACH


STUDY = Study(module=__name__, name="margins", title="Stability margins", order=40, schema=5)
