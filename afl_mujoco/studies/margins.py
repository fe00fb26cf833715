"""Compute gain, phase, disk and delay margins of controllers."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import NamedTuple

import numpy as np

from afl_mujoco.control.controller import Controller
from afl_mujoco.control.names import INFORMED, find_controllers
from afl_mujoco.errors import AflMujocoError, InvalidValueError, require_count
from afl_mujoco.report.blocks import (
    MISSING,
    Block,
    Cell,
    Matrix,
    Report,
    fixed,
    listed,
    plain,
    short,
)
from afl_mujoco.scenario.files import find_scenario
from afl_mujoco.scenario.parameters import CART_MASSES, HALF_LENGTHS
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.bound_controllers import bound
from afl_mujoco.simulation.mujoco_model import SimulatedModel
from afl_mujoco.studies.shared.contract import Progress, ScenarioIfAny, Study, compute, silent
from afl_mujoco.studies.shared.loop_margins import (
    LINEAR,
    STEP,
    linear_part,
    linearize,
    loop_margins,
)
from afl_mujoco.studies.shared.tables import graded
from afl_mujoco.values import require_distinct, require_positive

PERIOD, LONGEST_PERIOD = 1e-3, 10.0
"""Default control period, and the longest [s]: no plant of a laboratory takes longer to fall."""

LEVELS, QUICK_LEVELS = 5, 2  # of each parameter that varies
MOST_PLANTS = 10_000
CONTINUOUS, HELD = "continuous", "held"  # how the inputs of a loop act

GROWS_WORSE = ("gain_decrease", "crossover")  # the margins whose largest value is the worst


@dataclass(frozen=True, kw_only=True)
class Options:
    """Compute gain, phase, disk and delay margins of controllers about the target of a plant.

    Example: afl-mujoco margins my-rig.toml --controllers lqr my_controller:control

    The loop is linearised by finite differences in MuJoCo and broken at each input, over the plants
    that the scenario's schedules and ranges allow. Controllers with a memory or an estimator, or
    without slopes, have none. A coordinate that nothing depends on, such as the angle of a wheel
    that only spins, is left out. Writes margins.json and a figure.
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
    quick: bool = False
    """Only the least and the largest of each parameter."""


class Request(NamedTuple):
    """What is surveyed: controllers on a grid of parameters."""

    scenario: Scenario
    controllers: Sequence[Controller]
    axes: Mapping[str, tuple[float, ...]]  # the levels of each parameter that varies
    period: float = PERIOD  # of the held inputs [s]

    @property
    def plants(self) -> list[tuple[float, ...]]:
        """The values of the parameters that vary, of each plant."""
        return list(itertools.product(*self.axes.values()))

    def at(self, plant: Iterable[float]) -> Scenario:
        """Return the scenario with the constant parameters of a plant, about which to linearise."""
        s, asked = self.scenario, self.scenario.requirements
        return replace(
            s,
            schedule={**s.nominal, **dict(zip(self.axes, plant, strict=True))},
            disturbances=(),
            requirements=replace(asked, completes=False, settling_time=None, recover_within=None),
            ranges={},
            belief=s.belief.known(s.nominal),
        )

    def require(self) -> Request:
        """Return it, or raise unless one controller has margins on the first plant."""
        if require_positive("control_period", self.period) > LONGEST_PERIOD:
            rule = f"must be at most {LONGEST_PERIOD:g} s"
            raise InvalidValueError("control_period", rule, f"{self.period:g}")
        if not self.scenario.plant.inputs:
            rule = "must have an input at which a loop is broken"
            raise InvalidValueError(f"plant {self.scenario.plant.name!r}", rule)
        require_distinct("controller", [one.name for one in self.controllers])
        found = [self.margins_of((one, self.plants[0])) for one in self.controllers]
        if isinstance(found[0], AflMujocoError) and not any(isinstance(x, list) for x in found):
            raise found[0]
        return self

    def margins_of(self, case: tuple[Controller, tuple[float, ...]]) -> list[Row] | AflMujocoError:
        """Return margins of the continuous and the held loop, or why there is no linearisation."""
        scenario = self.at(case[1])
        try:
            controller = bound(case[0], scenario)
            if controller.estimates or (controller.interpreted and controller.stateful):
                thing = "an estimator" if controller.estimates else "a memory"
                rule = f"must not have {thing}, which a linearisation leaves out"
                raise InvalidValueError(f"controller {controller.name!r}", rule)
            loop = linearize(controller, scenario)
        except AflMujocoError as error:
            return error
        rows = []
        for kind, period in ((CONTINUOUS, None), (HELD, self.period)):
            found = loop_margins(loop, period, scenario.imperfections)
            for i, name in enumerate(loop.inputs):
                own = {} if found is None else asdict(found[i])
                finite = {key: x if math.isfinite(x) else None for key, x in own.items()}
                parameters = {key: scenario.nominal[key] for key in self.axes}
                rows.append(
                    Row(
                        controller=controller.name, loop=kind, input=name, parameters=parameters,
                        stable=found is not None, **finite,
                    )
                )  # fmt: skip
        return rows


def prepare(options: Options) -> Request:
    """Return what the options ask for, or raise if a rule is broken."""
    o = options
    scenario = PAPER if o.scenario is None else find_scenario(o.scenario)
    levels = o.levels if o.levels is not None else QUICK_LEVELS if o.quick else LEVELS
    require_count("levels", levels, 2, MOST_PLANTS)
    spans: dict[str, tuple[float, float]] = {**scenario.spans, **scenario.ranges}
    varied = [name for name in scenario.plant.parameters if spans[name][0] < spans[name][1]]
    axes = {name: tuple(np.linspace(*spans[name], levels).tolist()) for name in varied}
    if (count := levels ** len(axes)) > MOST_PLANTS:
        rule = f"must make at most {MOST_PLANTS} plants of {', '.join(axes)}"
        raise InvalidValueError("levels", rule, f"{levels}, which makes {count}")
    own = scenario.imperfections.control_period
    period = o.control_period if o.control_period is not None else own or PERIOD
    controllers = find_controllers(o.controllers, [scenario], INFORMED)
    return Request(scenario, controllers, axes, period).require()


_ENDS = {"cart_mass": CART_MASSES, "half_length": HALF_LENGTHS}
PAPER = Scenario(
    name="the paper's cart-poles",
    ranges={name: (some[0], some[-1]) for name, some in _ENDS.items()},
)


# --- what is found ------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """What a loop tolerates at one input; None for what is infinite, or of an unstable loop."""

    controller: str
    loop: str  # `CONTINUOUS` or `HELD`
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
    """Survey the margins; the result does not depend on the workers."""
    r, s = request, request.scenario
    cases = list(itertools.product(r.controllers, r.plants))
    rows: list[Row] = []
    not_linear: dict[str, str] = {}
    found = compute(r.margins_of, cases, "linearising", progress, workers)
    for (controller, _), some in zip(cases, found, strict=True):
        if isinstance(some, AflMujocoError):
            not_linear.setdefault(controller.name, str(some))
        else:
            rows += some
    departing = s.imperfections.departing()
    left_out = [x for x in departing if x.partition(".")[0] not in (*LINEAR, "seed")]
    model = SimulatedModel(s.plant)
    model.write(s.values_at(0.0))
    rubs = zip(s.plant.coordinates, model.mj_model.dof_frictionloss, strict=True)
    left_out += [f"frictionloss of {name}" for name, loss in rubs if loss > 0.0]
    counting = replace(linear_part(s.imperfections), control_period=None).departing()
    counting |= {f"belief.{name}": value for name, value in s.belief.table.items()}
    text = "; ".join(f"{name} = {json.dumps(value)}" for name, value in counting.items())
    return Result(
        scenario=s.name,
        control_period=r.period,
        imperfections=text or "none",
        left_out=tuple(left_out),
        linearisation_step=STEP,
        units={name: s.plant.units[name] for name in r.axes},
        plants=len(r.plants),
        rows=tuple(x for x in rows if x.controller not in not_linear),
        not_linear=not_linear,
    )


# --- what is shown ------------------------------------------------------------------------------

SHORT, LONG = 0.005, 0.02
"""Delays [s] that a loop should tolerate: that of a slow bus, and one that few drives exceed."""

GRADES = ("unstable", "less than 5 ms", "5 to 20 ms", "20 ms or more")
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
        only = [x for x in ("delay", "differentiated", "velocity_filter") if x in r.imperfections]
        said += f"{' and '.join(only)} in held loops only; " * bool(only)
        blocks.append(plain(f"{said}that a linear loop cannot have: {left}."))
    if r.rows:
        plants, cells = _delays(r)
        title = f"Delay margin [ms] on the plants at the ends of the ranges, {held}"
        better = f"Columns: {', '.join(r.units)}. " * bool(r.units) + "The larger the better."
        figure, _ = graded("margins-delay", title, better, ["", *plants], cells, GRADES)
        blocks += [figure, _table(r, held)]
    if r.not_linear:
        reasons = (plain(f"{name}: {reason}") for name, reason in r.not_linear.items())
        blocks.append("\n".join(f"- {reason}" for reason in reasons))
    least = [f"{name} {_said(r, name)}" for name in (*r.controllers, *r.not_linear)]
    return Report(headline=f"Least delay margin: {' · '.join(least)}", blocks=blocks)


def _said(result: Result, name: str) -> str:
    if not (rows := result.of(name, HELD)):
        return "has none"
    if unstable := sum(not row.stable for row in rows):
        count, of = unstable // len(result.inputs), len(rows) // len(result.inputs)
        return f"unstable on {count} of {of} plant{'s' * (of != 1)}"
    return f"{_text(min(rows, key=lambda row: value_of(row, 'delay')))} ms"


def _text(row: Row, metric: str = "delay", decimals: int = 1, factor: float = 1e3) -> str:
    value: float | None = getattr(row, metric)
    return "∞" if value is None else fixed(factor * value, decimals)


def _place(result: Result, parameters: Mapping[str, float], between: str = ", ") -> str:
    return between.join(f"{x:.3g} {result.units[name]}" for name, x in parameters.items())


def _delays(result: Result) -> tuple[list[str], dict[str, list[tuple[int, str]]]]:
    """Return the plants at the corners of the grid, and graded delay margins on them."""
    plants = list(dict.fromkeys(tuple(row.parameters.values()) for row in result.rows))
    ends = [(min(values), max(values)) for values in zip(*plants, strict=True)]
    corners = [plant for plant in itertools.product(*ends) if plant in plants]
    if len(corners) > 4:
        corners = [corners[0], corners[-1]]
    cells: dict[str, list[tuple[int, str]]] = {}
    for controller, name in itertools.product(result.controllers, result.inputs):
        known = {tuple(row.parameters.values()): row for row in result.of(controller, HELD, name)}
        label = controller if len(result.inputs) == 1 else f"{controller}, {name}"
        cells[label] = [_graded(known[corner]) for corner in corners]
    named = [dict(zip(result.units, corner, strict=True)) for corner in corners]
    return [_place(result, plant, "\n") for plant in named], cells


def _graded(row: Row) -> tuple[int, str]:
    if not row.stable:
        return 0, "unstable"
    return 1 + sum(value_of(row, "delay") >= least for least in (SHORT, LONG)), _text(row)


def _table(result: Result, held: str) -> Matrix:
    r, several = result, len(result.inputs) > 1
    rows: list[list[Cell | str]] = []
    for name, kind, one in itertools.product(r.controllers, (CONTINUOUS, HELD), r.inputs):
        some = r.of(name, kind, one)
        unstable = sum(not row.stable for row in some)
        worst = [r.worst(name, kind, metric, one) for metric, *_ in SHOWN.values()]
        cells = [MISSING if row is None else _text(row, *how)
                 for row, how in zip(worst, SHOWN.values(), strict=True)]  # fmt: skip
        place = "" if worst[-1] is None else _place(r, worst[-1].parameters)
        count = Cell(f"{unstable} of {len(some)}", "bad" if unstable else "")
        rows.append([name, *[one] * several, kind, count, *cells, place])
    return Matrix(
        caption=f"Worst margins over {r.plants} plant{'s' * (r.plants != 1)}, {held}, and where "
        "the delay margin is least",
        columns=[
            *("Controller", "Input")[: 1 + several], "Loop", "Unstable",
            *SHOWN, f"At {', '.join(r.units)}".strip(),
        ],
        rows=rows,
    )  # fmt: skip


STUDY = Study(module=__name__, name="margins", title="Stability margins", order=40, schema=5)
