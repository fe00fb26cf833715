"""Compute gain, phase, disk and delay margins of controllers at upright over a grid of plants."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields, replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.controller import Controller
from afl_mujoco.control.names import INFORMED
from afl_mujoco.errors import AflMujocoError, InvalidValueError, UnknownNameError
from afl_mujoco.pool import compute_all, open_executor
from afl_mujoco.report.blocks import Block, Cell, Figure, Matrix, Report
from afl_mujoco.report.markdown import plain
from afl_mujoco.report.numbers import MISSING, fixed, listed, percent, short
from afl_mujoco.scenario.belief import TRUTH, Belief
from afl_mujoco.scenario.files import find_scenario
from afl_mujoco.scenario.imperfections import IDEAL, Imperfections
from afl_mujoco.scenario.parameters import CART_MASSES, HALF_LENGTHS, NOMINAL, CartPoleParameters
from afl_mujoco.scenario.sampling import whole_steps
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.words import departures_text
from afl_mujoco.simulation.trajectory import COMPLETED, DIVERGED, Trajectory
from afl_mujoco.studies.bisection import find_threshold, scan_levels
from afl_mujoco.studies.contract import Progress, ScenarioIfAny, Study, counted, silent
from afl_mujoco.studies.loop_margins import (
    LINEAR,
    PERIOD,
    REST,
    STEP,
    Margins,
    NotSmoothError,
    delay_margin,
    linear_part,
    linearize,
    loop_margins,
)
from afl_mujoco.values import require_positive

if TYPE_CHECKING:
    import mujoco

LONGEST_PERIOD = 10.0
"""Longest control period [s], longer than any pole of a laboratory takes to fall."""

QUICK = 4  # A quick run studies one in so many M and l
LEVELS = 5  # number of M and l of a scenario that are studied if they change
METRICS = tuple(one.name for one in fields(Margins))  # the margins, in their order
GROWS_WORSE = ("gain_decrease", "crossover")  # the margins whose largest value is the worst


@dataclass(frozen=True, kw_only=True)
class Options:
    """Compute gain, phase, disk and delay margins of controllers at upright over a grid of plants.

    Example: afl-mujoco margins my-rig.toml --controllers adaptive lqr

    The loop is linearised by finite differences in MuJoCo. On some of the plants the study also
    measures the delay at which a small motion in MuJoCo grows; of controllers with a memory or an
    estimator, or without slopes, the gains too. Writes margins.json and a figure.
    """

    scenario: ScenarioIfAny = None
    """Scenario by name, or TOML file, that gives the plants, the control period and the linear
    imperfections; by default the paper's grid of plants, without imperfections."""
    controllers: tuple[str, ...] = INFORMED
    """Controllers by name, or module:attribute of your own."""
    cart_masses: tuple[float, ...] | None = None
    """Cart masses M of the grid [kg]; the paper's 20, or 5 over the scenario's, by default."""
    half_lengths: tuple[float, ...] | None = None
    """Half-lengths l of the grid [m]; the paper's 20, or 5 over the scenario's, by default."""
    pole_mass: float | None = None
    """m of every plant [kg]; the scenario's, or 0.05, by default."""
    gravity: float | None = None
    """g of every plant [m/s^2]; the scenario's, or 9.81, by default."""
    control_period: float | None = None
    """How long the sampled loop holds the force [s]; the scenario's, or 0.001, by default."""
    timestep: float | None = None
    """Physics step of MuJoCo where motions are measured [s]; by default the longest up to 0.001
    that divides the control period."""
    quick: bool = False
    """Every fourth M and l of the paper, unless given otherwise, and two plants measured."""
    measure: bool = True
    """Do not measure the delay that the loop in MuJoCo tolerates on some plants of the grid."""


class Deployment(NamedTuple):
    """How a controller acts in MuJoCo."""

    period: float = PERIOD  # of the held force [s]
    imperfections: Imperfections = IDEAL  # as from `linear_part`
    belief: Belief = TRUTH  # its nominal values known
    timestep: float | None = None  # [s]; None for the longest up to 1 ms that divides the period


USUAL = Deployment()  # perfect hardware and the default control period

Plants = tuple[CartPoleParameters, ...]


class Request(NamedTuple):
    """What is surveyed: controllers on a grid of M [kg] and l [m]."""

    controllers: Sequence[Controller]
    cart_masses: tuple[float, ...] = CART_MASSES
    half_lengths: tuple[float, ...] = HALF_LENGTHS
    deployed: Deployment = USUAL
    nominal: CartPoleParameters = NOMINAL  # of which m and g count
    scenario: Scenario | None = None  # that it comes from
    measured: Sequence[tuple[float, float]] = ()  # M and l of the plants that are measured too

    def plant(self, cart_mass: float, half_length: float) -> CartPoleParameters:
        """Return the plant at a point of the grid."""
        return replace(self.nominal, cart_mass=cart_mass, half_length=half_length)

    def require(self) -> Request:
        """Return it, or raise before anything slow.

        One controller at least must be linearised, or have small motions, on the first plant.
        """
        period = require_positive("control_period", self.deployed.period)
        if period > LONGEST_PERIOD:
            rule = f"must be at most {LONGEST_PERIOD:g} s"
            raise InvalidValueError("control_period", rule, f"{period:g}")
        for thing in ("controllers", "cart_masses", "half_lengths"):
            items = [getattr(one, "name", one) for one in getattr(self, thing)]
            if not items or len(set(items)) < len(items):
                raise InvalidValueError(thing, "must hold at least one, each once", items)
        plants = [self.plant(*x) for x in itertools.product(self.cart_masses, self.half_lengths)]
        refused = [refusal(one, plants[0], self.deployed) for one in self.controllers]
        if refused[0] is not None and None not in refused:
            raise refused[0]
        if self.deployed.timestep is not None:
            whole_steps("control_period", period, "timestep", self.deployed.timestep)
        return self


def prepare(options: Options) -> Request:
    """Return what the options ask for, or raise if a rule is broken."""
    from afl_mujoco.control.catalogue import find_controller

    o = options
    scenario = None if o.scenario is None else find_scenario(o.scenario)
    masses, lengths = (grid[:: QUICK if o.quick else 1] for grid in (CART_MASSES, HALF_LENGTHS))
    nominal, deployed = NOMINAL, USUAL
    if scenario is not None:
        scenario.require_cart_pole("margins")
        (mass, length, *_), varied = scenario.plants, scenario.ranges.varied
        masses = _levels(varied.get("cart_mass", mass))
        lengths = _levels(varied.get("half_length", length))
        linear = linear_part(scenario.imperfections)
        nominal = scenario.parameters_at(0.0)
        known = scenario.belief.known(scenario.nominal)
        deployed = Deployment(linear.control_period or PERIOD, linear, known)
    masses = masses if o.cart_masses is None else tuple(map(float, o.cart_masses))
    lengths = lengths if o.half_lengths is None else tuple(map(float, o.half_lengths))
    period = deployed.period if o.control_period is None else o.control_period
    given = {n: x for n in ("pole_mass", "gravity") if (x := getattr(o, n)) is not None}
    request = Request(
        [find_controller(name) for name in o.controllers],
        masses,
        lengths,
        deployed._replace(period=period, timestep=o.timestep),
        replace(nominal, **given),
        scenario,
    ).require()
    measured = measured_plants(masses, lengths, few=o.quick) if o.measure else ()
    return request._replace(measured=measured)


def _levels(bounds: tuple[float, float]) -> tuple[float, ...]:
    """Return levels of a scenario's M or l, from the least to the largest."""
    low, high = bounds
    return (low,) if low == high else tuple(np.linspace(low, high, LEVELS).tolist())


def measured_plants(
    masses: Sequence[float], lengths: Sequence[float], *, few: bool = False
) -> list[tuple[float, float]]:
    """Return the plants of a grid on which delays are measured, M [kg] and l [m].

    They are the lightest and the heaviest cart, each with the shortest pole, the longest, and the
    one nearest to their geometric mean; only the two ends of the grid if ``few``.
    """
    ends = (min(masses), max(masses)), (min(lengths), max(lengths))
    if few:
        return list(dict.fromkeys(zip(*ends, strict=True)))
    mean = math.sqrt(ends[1][0] * ends[1][1])
    middle = min(lengths, key=lambda length: abs(math.log(length / mean)))
    return list(dict.fromkeys(itertools.product(ends[0], (ends[1][0], middle, ends[1][1]))))


# --- what is found ------------------------------------------------------------------------------

Loop = dict[str, tuple[tuple[bool | float | None, ...], ...]]
"""Margins of one loop by cart mass and half-length, as in `Margins`, and whether it is "stable".

None where a margin is infinite, or the loop is not stable.
"""


@dataclass(frozen=True, slots=True)
class DelayComparison:
    """The delay that one controller tolerates on one plant, linearised and in MuJoCo."""

    controller: str
    cart_mass: float  # [kg]
    half_length: float  # [m]
    margin: float | None  # of the loop with a held force [s]; None if it is not stable
    measured: float | None  # from which a small motion no longer decays [s]; None if none was found

    @property
    def difference(self) -> float | None:
        """Relative difference of the measurement from the margin [1]; None without both."""
        if self.margin is None or self.measured is None:
            return None
        return self.measured / self.margin - 1.0

    @property
    def agrees(self) -> bool:
        """Whether they differ by no more than `REACH`, or are both missing."""
        if self.difference is None:
            return self.margin is self.measured
        return abs(self.difference) <= REACH


@dataclass(frozen=True, slots=True)
class SmallMotions:
    """What a loop in MuJoCo tolerates, one controller on one plant, before small motions grow."""

    controller: str
    cart_mass: float  # [kg]
    half_length: float  # [m]
    decays: bool  # whether a small motion decays as the loop is
    gain_decrease: float | None = None  # factors on the force; None beyond the last of `GAINS`,
    gain_increase: float | None = None  # or if none decays
    delay: float | None = None  # [s]; 0 below the first of `DELAYS`, None beyond the last


class Worst(NamedTuple):
    """The worst value of a margin on the grid, and its plant, M [kg] and l [m]."""

    value: float
    cart_mass: float
    half_length: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """Margins by controller and plant."""

    control_period: float  # how long the sampled loop holds its force [s]
    cart_masses: tuple[float, ...]  # the grid, M [kg] and l [m]
    half_lengths: tuple[float, ...]
    pole_mass: float  # m [kg] and g [m/s^2]
    gravity: float
    imperfections: str  # those of the linear loop, by their keys; "none" for the ideal loop
    linearisation_step: float  # of the central differences [m, rad, m/s, rad/s, N]
    # by controller, those of the "continuous" and those of the "sampled" loop
    margins: dict[str, dict[str, Loop]]
    measured: tuple[DelayComparison, ...] = ()  # on some of the plants; empty if none was measured
    scenario: str | None = None  # its name, if any; and its imperfections that are not modelled
    left_out: tuple[str, ...] = ()
    # why each of the other controllers has no linear margins, by its name; what small motions of
    # those tolerate on some of the plants
    not_linear: dict[str, str] = field(default_factory=dict)
    small_motions: tuple[SmallMotions, ...] = ()

    @property
    def plants(self) -> int:
        """Number of plants."""
        return len(self.cart_masses) * len(self.half_lengths)

    def loop(self, controller: str, *, sampled: bool = False) -> Loop:
        """Return the margins of one controller, by its name."""
        if controller not in self.margins:
            raise UnknownNameError.among("controller", controller, self.margins)
        return self.margins[controller]["sampled" if sampled else "continuous"]

    def unstable(self, controller: str, *, sampled: bool = False) -> int:
        """Return the number of plants on which a loop is not stable."""
        return sum(not x for row in self.loop(controller, sampled=sampled)["stable"] for x in row)

    def values(self, controller: str, metric: str, *, sampled: bool = False) -> NDArray[np.float64]:
        """Return one of `METRICS`, shape (masses, lengths); NaN where the loop is not stable."""
        loop = self.loop(controller, sampled=sampled)
        if metric not in METRICS:
            raise UnknownNameError.among("margin", metric, METRICS)
        rows = [[math.inf if x is None else x for x in row] for row in loop[metric]]
        return np.where(np.array(loop["stable"]), np.array(rows, dtype=np.float64), np.nan)

    def worst(self, controller: str, metric: str, *, sampled: bool = False) -> Worst | None:
        """Return the worst value of a margin over the stable plants; None if there is none."""
        values = self.values(controller, metric, sampled=sampled)
        if np.isnan(values).all():
            return None
        pick = np.nanargmax if metric in GROWS_WORSE else np.nanargmin
        row, column = np.unravel_index(int(pick(values)), values.shape)
        return Worst(float(values[row, column]), self.cart_masses[row], self.half_lengths[column])


# --- margins of the linearised loops ------------------------------------------------------------


def run(request: Request, *, progress: Progress = silent, workers: int = 1) -> Result:
    """Survey the margins and measure delays; the result does not depend on the workers."""
    r = request
    reasons = {one.name: why_not_linear(one) for one in r.controllers}
    not_linear = {name: reason for name, reason in reasons.items() if reason is not None}
    rows = [
        (one, tuple(r.plant(mass, length) for length in r.half_lengths), r.deployed)
        for one in r.controllers
        if one.name not in not_linear
        for mass in r.cart_masses
    ]
    tables: dict[str, list[NDArray[np.float64]]] = {}
    found = _computed(margins_of_row, rows, "linearising", progress, workers)
    for (controller, *_), row in zip(rows, found, strict=True):
        if isinstance(row, AflMujocoError):
            not_linear.setdefault(controller.name, str(row))
        else:
            tables.setdefault(controller.name, []).append(row)
    units = [
        (one, r.plant(*pair), r.deployed, one.name not in not_linear)
        for one in sorted(r.controllers, key=lambda one: one.name in not_linear)
        for pair in r.measured
    ]
    measured = _computed(measure, units, "measuring", progress, workers) if units else []
    for (controller, *_), motion in zip(units, measured, strict=True):
        if isinstance(motion, AflMujocoError):
            not_linear[controller.name] = str(motion)
    own = {} if r.scenario is None else r.scenario.imperfections.departing()
    return Result(
        control_period=r.deployed.period,
        cart_masses=r.cart_masses,
        half_lengths=r.half_lengths,
        pole_mass=r.nominal.pole_mass,
        gravity=r.nominal.gravity,
        imperfections=departures_text(replace(r.deployed.imperfections, control_period=None)),
        linearisation_step=STEP,
        margins={
            name: {
                kind: _as_loop(np.stack(table)[:, :, k])
                for k, kind in enumerate(("continuous", "sampled"))
            }
            for name, table in tables.items()
            if name not in not_linear
        },
        measured=tuple(one for one in measured if isinstance(one, DelayComparison)),
        scenario=None if r.scenario is None else r.scenario.name,
        left_out=tuple(name for name in own if name not in (*LINEAR, "seed")),
        not_linear=not_linear,
        small_motions=tuple(one for one in measured if isinstance(one, SmallMotions)),
    )


def _computed(
    function: Callable[[Any], Any], units: Sequence[Any], doing: str, progress: Progress,
    workers: int,
) -> list[Any]:  # fmt: skip
    """Return what a function finds of units, shared among processes."""
    progress(doing, 0, len(units))
    with open_executor(min(workers, max(1, len(units)))) as executor:
        return compute_all(function, units, executor, counted(progress, doing, len(units)))


def why_not_linear(controller: Controller) -> str | None:
    """Return what a linearisation of a controller would leave out; None if nothing."""
    if controller.estimates:
        return "has an estimator, which a linearisation leaves out"
    if controller.interpreted and controller.stateful:
        return "has a memory, which a linearisation leaves out"
    return None


def refusal(
    controller: Controller, plant: CartPoleParameters, deployed: Deployment
) -> AflMujocoError | None:
    """Return why a controller has neither linear margins nor small motions; None if it has."""
    try:
        if why_not_linear(controller) is None:
            with suppress(NotSmoothError):
                linearize(controller, plant, deployed.imperfections, deployed.belief)
                return None
        require_equilibrium(controller, plant, deployed)
    except AflMujocoError as error:
        return error
    return None


def margins_of_row(
    unit: tuple[Controller, Plants, Deployment],
) -> NDArray[np.float64] | AflMujocoError:
    """Return the margins of a controller on some plants, shape (plants, 2, margins).

    Those of the continuous loop come before those of the sampled one. Where the controller has no
    linearisation, return why.
    """
    controller, plants, (period, imperfections, belief, _) = unit
    row = np.full((len(plants), 2, len(METRICS)), np.nan)
    for place, plant in enumerate(plants):
        try:
            loop = linearize(controller, plant, imperfections, belief)
        except AflMujocoError as error:
            return error
        for kind, held in enumerate((None, period)):
            found = loop_margins(loop, held, imperfections)
            if found is not None:
                row[place, kind] = list(asdict(found).values())
    return row


def _as_loop(table: NDArray[np.float64]) -> Loop:
    """Return margins of shape (masses, lengths, margins), NaN where unstable, as plain data."""
    plain = np.where(np.isfinite(table), table, None)  # type: ignore[call-overload]
    named = {"stable": ~np.isnan(table[..., METRICS.index("disk")])}
    named |= {name: plain[..., k] for k, name in enumerate(METRICS)}
    return {name: tuple(map(tuple, rows.tolist())) for name, rows in named.items()}


# --- small motions in MuJoCo --------------------------------------------------------------------

START = 1e-3  # pole angle at the start of a measurement [rad], small enough for the linearisation

DURATION, PARTS = 20.0, 5
"""Length of a run [s], and the number of parts into which it is cut. A motion decays if it is no
larger in the last part than in the first and in the one before the last."""

SMALL = 10.0 * START
"""Largest pole angle in the last part [rad]: the motion may have grown into a limit cycle, which
no longer grows."""

TOLERANCE = 1e-3  # relative tolerance of the delay that is compared with a margin [1]
DELAY = 0.05  # delay around which a threshold is sought if there is no margin [s]
REACH = 0.05  # relative difference up to which margin and measurement agree [1]

GAINS = scan_levels(1.0, 100.0, 13)
"""Factors on the force that are tried, and their inverses, before the bisection [1]."""

DELAYS = scan_levels(1e-4, 1.0, 13)  # delays that are tried before the bisection [s]
ROUGHLY = 1e-2  # relative tolerance of what is measured of a controller without linear margins [1]
AT_REST = 1.0  # length of the run that shows whether upright is an equilibrium [s]


def measure(
    unit: tuple[Controller, CartPoleParameters, Deployment, bool],
) -> DelayComparison | SmallMotions | AflMujocoError:
    """Return what one loop tolerates in MuJoCo; its delay beside the margin if it is linear.

    Where that cannot be measured of one that is not, return why.
    """
    controller, plant, deployed, linear = unit
    place = controller.name, plant.cart_mass, plant.half_length
    decays = partial(motion_decays, controller, plant, deployed=deployed)
    if linear:
        margin = delay_margin(controller, plant, *deployed[:3])
        about = DELAY if margin is None else margin
        measured = _least(decays, scan_levels(about / 5.0, about * 5.0, 7), TOLERANCE)
        return DelayComparison(*place, margin, measured or None)
    try:
        require_equilibrium(controller, plant, deployed)
        if not decays(0.0):
            return SmallMotions(*place, decays=False)
        return SmallMotions(
            *place,
            decays=True,
            gain_decrease=_least(lambda x: decays(0.0, gain=x), [1.0 / x for x in GAINS]),
            gain_increase=_least(lambda x: decays(0.0, gain=x), GAINS),
            delay=_least(decays, DELAYS),
        )
    except AflMujocoError as error:
        return error


def _least(
    holds: Callable[[float], bool], scan: list[float], tolerance: float = ROUGHLY
) -> float | None:
    """Return where a motion no longer decays; 0 before the first level, None beyond the last."""
    found = find_threshold(holds, scan, tolerance)
    if found.fails_at is None:
        return None
    return 0.0 if found.holds_at is None else math.sqrt(found.holds_at * found.fails_at)


def require_equilibrium(
    controller: Controller, plant: CartPoleParameters, deployed: Deployment
) -> None:
    """Raise if a controller does not keep a pole that stands upright at rest.

    What small motions do says nothing of a loop that has its equilibrium elsewhere.
    """
    thing = f"small motions of {controller.name!r} at M = {plant.cart_mass:g} kg"
    thing += f", l = {plant.half_length:g} m"
    run = small_motion(controller, plant, deployed, 0.0, AT_REST)
    moved = np.flatnonzero(~(np.abs(run.force) <= REST))
    if moved.size:
        rule = "must be about an equilibrium: no force at upright"
        raise InvalidValueError(thing, rule, f"{run.force[moved[0]]:g} N")
    run = small_motion(controller, plant, deployed, START, AT_REST)
    if run.outcome.kind == DIVERGED:
        raise InvalidValueError(thing, "must have finite forces", f"diverged {run.outcome.time} s")


def motion_decays(
    controller: Controller,
    plant: CartPoleParameters,
    delay: float,
    deployed: Deployment = USUAL,
    gain: float = 1.0,
) -> bool:
    """Return whether a small motion about upright decays in MuJoCo.

    A transport delay [s] comes on top of that of the imperfections, and a gain on the force.
    """
    hardware = replace(
        deployed.imperfections, delay=deployed.imperfections.delay + delay, control_period=None
    )
    deployed = deployed._replace(imperfections=hardware)
    run = small_motion(controller, plant, deployed, START, DURATION, gain)
    if run.outcome.kind != COMPLETED:
        return False
    peaks = np.array([part.max(axis=0) for part in np.array_split(np.abs(run.state), PARTS)])
    decayed = (peaks[-1] <= np.minimum(peaks[0], peaks[-2])).all()
    return bool(decayed and peaks[-1, 1] <= SMALL)


def small_motion(
    controller: Controller,
    plant: CartPoleParameters,
    deployed: Deployment,
    start: float,
    duration: float,
    gain: float = 1.0,
) -> Trajectory:
    """Return a run from an angle [rad] near upright in sampled mode, of whole control periods."""
    from afl_mujoco.simulation.mujoco_model import CartPoleModel
    from afl_mujoco.simulation.sampled.runs import simulate_sampled

    period, imperfections, belief, timestep = deployed
    scenario = Scenario(
        name="small motion",
        duration=max(1, round(duration / period)) * period,
        schedule=asdict(plant),
        initial_state={"phi": start},
        imperfections=replace(imperfections, control_period=None),
        belief=belief,
    )

    def amplify(spec: mujoco.MjSpec) -> None:
        motor = spec.actuator("force")
        motor.gear = gain * motor.gear

    model = CartPoleModel(plant, edit=amplify, imperfections=scenario.imperfections)
    model.compute_only()
    return simulate_sampled(
        scenario, controller, timestep=timestep, control_period=period, model=model
    )


# --- what is shown ------------------------------------------------------------------------------

SHORT, LONG = 0.005, 0.02
"""Delays [s] that a loop should tolerate: that of a slow bus, and one that few drives exceed."""

GRADES = ("unstable", "less than 5 ms", "5 to 20 ms", "20 ms or more", "not measured")
"""What a delay margin is worth, worst first."""

SHOWN = (
    ("Gain down to", "gain_decrease", 2, 1.0),
    ("Gain up to", "gain_increase", 1, 1.0),
    ("Phase [°]", "phase", 1, 1.0),
    ("Disk", "disk", 2, 1.0),
    ("Delay [ms]", "delay", 2, 1e3),
)
"""Column, margin, decimals and factor for each margin in the table."""


def report(result: Result) -> Report:
    """Return what is shown of margins."""
    held = f"force held {short(1e3 * result.control_period)} ms"
    blocks: list[Block] = []
    if result.scenario is not None:
        left = listed(result.left_out, "and") or "none"
        blocks.append(
            plain(
                f"Imperfections of {result.scenario} that count: {result.imperfections}; "
                f"that a linear loop cannot have: {left}."
            )
        )
    if result.margins or result.small_motions:
        blocks.append(
            Figure(
                name="margins-delay",
                title=f"Delay margin [ms], {held}",
                caption="Lightest and heaviest cart with the shortest pole, a middle and the "
                "longest.",
                draw=partial(_draw, result),
            )
        )
    if result.margins or result.not_linear:
        blocks.append(_worst_matrix(result, held))
    if result.not_linear:
        reasons = (plain(f"{name}: {reason}") for name, reason in result.not_linear.items())
        blocks.append("\n".join(f"- {reason}" for reason in reasons))
    if result.measured:
        blocks.append(_measured_matrix(result))
    said = [*(_said(result, name) for name in result.margins)]
    said += [f"{name} {_tolerated(result, name)}" for name in result.not_linear]
    return Report(headline=f"Least delay margin: {' · '.join(said)}", blocks=blocks)


def _said(result: Result, name: str) -> str:
    """Say how much delay a controller tolerates on its worst plant."""
    if unstable := result.unstable(name, sampled=True):
        return f"{name} unstable on {unstable} of {result.plants} plants"
    worst = result.worst(name, "delay", sampled=True)
    return f"{name} {_ms(None if worst is None else worst.value)} ms"


def _tolerated(result: Result, name: str) -> str:
    """Say the same of a controller whose small motions were measured."""
    motions = _motions(result, name)
    grow = sum(not one.decays for one in motions)
    if not motions:
        return "has none"
    return f"unstable on {grow} of {len(motions)} plants" if grow else f"{_delay(motions)} ms"


def _ms(delay: float | None) -> str:
    return "∞" if delay is not None and math.isinf(delay) else fixed(delay and 1e3 * delay, 1)


def _draw(result: Result) -> Any:
    """Draw the delay margins of controllers on the corners of the grid."""
    from afl_mujoco.report.figures import heat

    plants = measured_plants(result.cart_masses, result.half_lengths)
    cells = {
        name: [_graded(result, name, plant) for plant in plants]
        for name in (*result.margins, *dict.fromkeys(x.controller for x in result.small_motions))
    }
    grades = np.array([[grade for grade, _ in row] for row in cells.values()])
    texts = [[text for _, text in row] for row in cells.values()]
    columns = [f"{mass:g} kg\n{length:.3g} m" for mass, length in plants]
    return heat([*cells], columns, grades, texts, GRADES)


def _graded(result: Result, name: str, plant: tuple[float, float]) -> tuple[int, str]:
    """Return the grade of a delay margin on a plant, and its text."""
    if name in result.margins:
        row, column = result.cart_masses.index(plant[0]), result.half_lengths.index(plant[1])
        delay = float(result.values(name, "delay", sampled=True)[row, column])
        text = _ms(delay)
    else:
        one = next(
            (x for x in _motions(result, name) if (x.cart_mass, x.half_length) == plant), None
        )
        if one is None:
            return 4, MISSING
        delay = math.nan if not one.decays else math.inf if one.delay is None else one.delay
        text = _delay([one])
    if math.isnan(delay):
        return 0, "unstable"
    return 1 + sum(delay >= least for least in (SHORT, LONG)), text


def _worst_matrix(result: Result, held: str) -> Matrix:
    """Return the worst margins of each controller, continuous, held and measured."""
    rows: list[list[Cell | str]] = []
    for name, sampled in itertools.product(result.margins, (False, True)):
        unstable = result.unstable(name, sampled=sampled)
        least = result.worst(name, "delay", sampled=sampled)
        cells = []
        for _, metric, decimals, factor in SHOWN:
            worst = result.worst(name, metric, sampled=sampled)
            value = math.nan if worst is None else worst.value
            cells.append("∞" if math.isinf(value) else fixed(factor * value, decimals))
        rows.append(
            [
                name,
                "held" if sampled else "continuous",
                Cell(str(unstable), "bad" if unstable else ""),
                *cells,
                "" if least is None else f"{least.cart_mass:g} kg, {least.half_length:g} m",
            ]
        )
    for name in result.not_linear:
        motions = _motions(result, name)
        decaying = [one for one in motions if one.decays]
        lows, highs = (
            [x for one in decaying if (x := getattr(one, key)) is not None]
            for key in ("gain_decrease", "gain_increase")
        )
        cells = [
            fixed(max(lows), 2) if lows else f"< {1.0 / GAINS[-1]:.2g}",
            fixed(min(highs), 1) if highs else f"> {GAINS[-1]:g}",
            MISSING,
            MISSING,
            _delay(motions),
        ]
        grow = len(motions) - len(decaying)
        count = Cell(f"{grow} of {len(motions)}" if motions else MISSING, "bad" if grow else "")
        rows.append([name, "measured", count, *(cells if decaying else [MISSING] * 5), ""])
    return Matrix(
        caption=f"Worst margins over {result.plants} plants, {held}, and where the delay margin is "
        f"least; measured: by motions of {short(1e3 * START)} mrad in MuJoCo",
        columns=["Controller", "Force", "Unstable", *(name for name, *_ in SHOWN), "At M, l"],
        rows=rows,
    )


def _measured_matrix(result: Result) -> Matrix:
    """Return the delay margins on some plants, and how far the measured delays are from them."""
    cells: dict[str, dict[str, Cell | str]] = {}
    for one in result.measured:
        text = "unstable" if one.margin is None else _ms(one.margin)
        if one.difference is not None:
            text += f" ({'+' if one.difference > 0 else ''}{percent(one.difference, 2)})"
        elif one.margin is not one.measured:
            text += f" ({_ms(one.measured)})"
        plant = f"{one.cart_mass:g} kg, {one.half_length:g} m"
        cells.setdefault(plant, {})[one.controller] = Cell(text, "" if one.agrees else "bad")
    names = [*dict.fromkeys(one.controller for one in result.measured)]
    return Matrix(
        caption=f"Delay margin [ms], and how far from it the delay is from which a motion of "
        f"{short(1e3 * START)} mrad grows in MuJoCo",
        columns=["M, l", *names],
        rows=[[plant, *(row.get(name, MISSING) for name in names)] for plant, row in cells.items()],
        folded="Margins and delays measured in MuJoCo",
    )


def _motions(result: Result, name: str) -> list[SmallMotions]:
    return [one for one in result.small_motions if one.controller == name]


def _delay(motions: Sequence[SmallMotions]) -> str:
    """Return the least delay that some motions tolerate [ms]."""
    found = [one.delay for one in motions if one.decays and one.delay is not None]
    if not found:
        return f"> {1e3 * DELAYS[-1]:g}"
    return _ms(min(found)) if min(found) > 0.0 else f"< {1e3 * DELAYS[0]:g}"


STUDY = Study(
    name="margins",
    title="Stability margins",
    order=40,
    schema=4,
    configuration=Options,
    prepare=prepare,
    run=run,
)
