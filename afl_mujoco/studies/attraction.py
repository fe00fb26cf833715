"""Map from which starts controllers cope with a scenario."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.controller import Controller
from afl_mujoco.control.names import find_controllers
from afl_mujoco.errors import InvalidValueError, UnknownNameError, require_count
from afl_mujoco.plants.plant import Floats
from afl_mujoco.report.blocks import Cell, Figure, Matrix, Report, fixed, percent, short
from afl_mujoco.scenario.files import find_scenario
from afl_mujoco.scenario.parameters import (
    LARGEST_START_ANGLE,
    LARGEST_STATE,
    from_target,
    require_start_angle,
    symbol,
)
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.time_steps import Deployed
from afl_mujoco.simulation.judgement import CONTROLLER_FAILED, kept_within
from afl_mujoco.simulation.trajectory import COMPLETED, DIVERGED, FELL, deviation
from afl_mujoco.studies.shared.arrays import Array
from afl_mujoco.studies.shared.contract import (
    ControllerNames,
    Progress,
    ScenarioName,
    Study,
    Timestep,
    silent,
)
from afl_mujoco.studies.shared.robustness import map_starts, require_runs
from afl_mujoco.studies.shared.run import Rows, Run
from afl_mujoco.values import require_positive

GRID, QUICK_GRID, MOST_GRID = 41, 11, 1001  # number of starts along each axis, and the most
WORDS = ("ends at rest", "falls or diverges", "survives, but is not at rest at the end",
         "misses a requirement", "controller fails")  # fmt: skip
"""How a run from a start ends; where there are requirements, the first is to pass them."""

COLOURS = ("#56B4E9", "#D55E00", "#F0E442", "#CC79A7", "#000000")
GOOD, FALLEN, UNSETTLED, MISSED, FAILED = range(5)


@dataclass(frozen=True, kw_only=True)
class Options:
    """Map from which starts each controller copes with a scenario as deployed in MuJoCo.

    Example: afl-mujoco attraction my-rig.toml --controllers adaptive lqr --quick

    One run for each start of a grid over two states, by default the last coordinate, of those that
    can end a run if there are any, and its rate, with the scenario's schedules, disturbances and
    imperfections. A start counts if the requirements are met from it or, if there are none, the
    run ends at rest. Writes attraction.json and a figure. A full run takes about five minutes on
    two cores.
    """

    scenario: ScenarioName = "step-step"
    """Scenario by name, or TOML file."""
    controllers: ControllerNames = ()
    grid: int | None = None
    """Starts along each axis; 41 by default."""
    quick: bool = False
    """11 starts along each axis, unless a number is given."""
    axes: tuple[str, ...] = ()
    """The two states that vary, by name: phi phi_dot of the cart-pole."""
    reach: tuple[float, ...] = ()
    """How far the two go from the target; by default 1.55 rad and 10 rad/s of the cart-pole, of
    another plant 20 times the band in which it is at rest."""
    timestep: Timestep = None


class Request(NamedTuple):
    """What is mapped."""

    scenario: Scenario
    controllers: Sequence[Controller]
    axes: tuple[str, str]
    angles: Floats
    rates: Floats
    deployed: Deployed = Deployed()


def prepare(options: Options) -> Request:
    """Return what the options ask for, or raise if a rule is broken."""
    o = options
    scenario = find_scenario(o.scenario)
    count = o.grid if o.grid is not None else QUICK_GRID if o.quick else GRID
    require_count("grid", count, 2, MOST_GRID)
    states, names = scenario.plant.states, scenario.plant.coordinates
    *_, last = [name for name in names if name in scenario.ends_at] or names
    first, second = o.axes if len(o.axes) == 2 else (last, f"{last}_dot")
    if len(o.axes) not in (0, 2) or first == second:
        raise InvalidValueError("axes", "must be two states", " ".join(o.axes))
    axes = first, second
    for name in axes:
        if name not in states:
            raise UnknownNameError.among("axis", name, states)
    deployed = Deployed(timestep=o.timestep)
    controllers = find_controllers(o.controllers, [scenario])
    require_runs(controllers, [scenario], deployed)
    target = dict(zip(scenario.plant.coordinates, scenario.target, strict=True))
    target |= {name: deviation(target[name], 0.0, True) for name in scenario.plant.wraps}
    if len(o.reach) not in (0, 2):
        raise InvalidValueError("reach", "must be two numbers", o.reach)
    asked = zip(axes, o.reach or (None, None), strict=True)
    reach = {
        name: _reach(name, given, scenario, abs(target.get(name, 0.0))) for name, given in asked
    }
    angles, rates = (
        target.get(name, 0.0) + np.linspace(-most, most, count) for name, most in reach.items()
    )
    return Request(scenario, controllers, axes, angles, rates, deployed)


def _reach(name: str, given: float | None, scenario: Scenario, around: float = 0.0) -> float:
    """Return how far a state goes from its target, within its range and what ends a run."""
    unit = scenario.plant.units[name]
    about = scenario.about(name)
    low, high = kept_within(scenario).get(name, (-math.inf, math.inf))
    end = min(high - about, about - low, scenario.ends_at.get(name, math.inf))
    if end <= 0.0:
        rule = "must lie within its end stops and its range in the MJCF, for a map about it"
        raise InvalidValueError(f"target of {name}", rule, f"{about:g} {unit}")
    if given is not None:
        if not require_positive("reach", given) < min(end, LARGEST_STATE):
            rule = f"must be below {min(end, LARGEST_STATE):.4g} {unit} for {name}"
            raise InvalidValueError("reach", rule, given)
        if unit == "rad":
            require_start_angle("reach", given + around)
        return given
    most, share = 20.0 * scenario.band(name.removesuffix("_dot")), 0.95
    if scenario.is_cart_pole and name.startswith("phi"):
        most, share = (10.0 if name.endswith("_dot") else 1.55), 0.99
    turn = min(math.pi, LARGEST_START_ANGLE - around) if unit == "rad" else math.inf
    return require_positive(f"reach of {name}", min(most, share * end, turn))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Result:
    """How runs end by where they start."""

    scenario: Scenario
    controllers: tuple[str, ...]  # their names
    timestep: float | None  # of MuJoCo [s], None for the default
    axes: tuple[str, str] = ("phi", "phi_dot")  # the two states that vary
    angles: Array  # their levels
    rates: Array
    # of each controller: every level of the first for the first of the second, then for the next,
    # and at last from the start of the scenario itself
    rows: Rows

    @property
    def starts(self) -> int:
        """Number of starts of the map."""
        return len(self.angles) * len(self.rates)

    @property
    def words(self) -> tuple[str, ...]:
        """How a run ends, by its kind."""
        return ("passes", *WORDS[1:]) if self.scenario.judged else WORDS

    def runs(self, controller: str) -> list[Run]:
        """Return the runs of a controller, the last from the scenario's own start."""
        first = self.controllers.index(controller) * (self.starts + 1)
        return list(self.rows[first : first + self.starts + 1])

    def kinds(self, controller: str) -> NDArray[np.int_]:
        """Return how the runs of a controller end, indices into `words`, shape (rates, angles)."""
        found = [self.kind(run) for run in self.runs(controller)[:-1]]
        return np.array(found).reshape(len(self.rates), len(self.angles))

    def kind(self, run: Run) -> int:
        """Return how a run ended, an index into `words`."""
        judged = self.scenario.judged
        if run.failure or not (judged or run.outcome == COMPLETED):
            fallen = {FELL: FALLEN, DIVERGED: FALLEN, CONTROLLER_FAILED: FAILED}
            return fallen.get(run.outcome, MISSED)
        return GOOD if judged or run.settled else UNSETTLED


def run(
    request: Request, *, progress: Progress = silent, workers: int = 1, cluster: str | None = None
) -> Result:
    """Run every controller from every start; the result does not depend on the workers."""
    scenario, controllers, axes, angles, rates, deployed = request
    among: Any = {"progress": progress, "workers": workers, "cluster": cluster}
    rows = map_starts(controllers, scenario, axes, (angles, rates), deployed, **among)
    return Result(
        scenario=scenario, controllers=tuple(one.name for one in controllers),
        timestep=deployed.timestep,
        axes=axes, angles=angles, rates=rates, rows=tuple(rows),
    )  # fmt: skip


def report(result: Result) -> Report:
    """Return what is shown of the maps."""
    maps = {name: result.kinds(name) for name in result.controllers}
    shares = {name: float((kinds == GOOD).mean()) for name, kinds in maps.items()}
    present = [k for k in range(len(WORDS)) if any((kinds == k).any() for kinds in maps.values())]
    words, rows = result.words, list[list[Cell | str]]()
    for name, kinds in maps.items():
        own = result.runs(name)[-1]
        word = words[result.kind(own)]
        counts = [fixed(100.0 * float((kinds == k).mean()), 1) for k in present]
        rows.append([name, *counts, Cell(word, "bad" if own.failure else "good")])
    units, axes = result.scenario.plant.units, (result.angles, result.rates)
    away = [from_target(name, result.scenario.about(name)) for name in result.axes]
    reach = " and ".join(
        f"|{one}| up to {short(0.5 * float(axis[-1] - axis[0]))} {units[name]}"
        for one, name, axis in zip(away, result.axes, axes, strict=True)
    )
    said = ", ".join(f"{name} copes with {percent(share, 3)}" for name, share in shares.items())
    return Report(
        headline=f"{result.scenario.name}: of {result.starts} starts, {reach}, {said}.",
        blocks=[
            Figure(
                name="attraction",
                title=f"From which starts each controller copes with {result.scenario.name}",
                caption="One run for each point; the cross is the scenario's own start.",
                draw=partial(_draw, result, maps, present),
            ),
            Matrix(
                caption=f"How the runs end, in % of {result.starts} starts",
                columns=["Controller", *(words[k] for k in present), "From its own start"],
                rows=rows,
            ),
        ],
    )


def _draw(result: Result, maps: Mapping[str, NDArray[np.int_]], present: Sequence[int]) -> Any:
    from matplotlib.colors import to_rgba
    from matplotlib.patches import Patch

    from afl_mujoco.report.figures import new_figure

    columns = min(len(maps), 3)
    rows = -(-len(maps) // columns)
    figure = new_figure(1.0 + 3.4 * columns, 0.9 + 3.0 * rows)
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    colours = np.array([to_rgba(colour) for colour in COLOURS])
    edges: list[float] = []  # the outer ones of the outermost points
    for axis in (result.angles, result.rates):
        half = 0.5 * float(axis[-1] - axis[0]) / (len(axis) - 1)
        edges += [float(axis[0]) - half, float(axis[-1]) + half]
    own = dict(zip(result.scenario.plant.states, result.scenario.initial_state, strict=True))
    for axes, (name, kinds) in zip(panels.flat, maps.items(), strict=False):
        axes.grid(False)
        axes.imshow(
            colours[kinds], extent=edges, origin="lower", aspect="auto", interpolation="nearest"
        )
        start = [own[key] for key in result.axes]
        axes.plot(*start, "X", color="white", markeredgecolor="black", markersize=11)
        axes.set_title(f"{name}: {percent(float((kinds == GOOD).mean()), 3)}")
        axes.set_xlim(edges[:2])
        axes.set_ylim(edges[2:])
    for axes in panels.flat[len(maps) :]:
        axes.set_axis_off()
    for label, name in zip((figure.supxlabel, figure.supylabel), result.axes, strict=True):
        label(f"{symbol(name)} at the start [{result.scenario.plant.units[name]}]", fontsize=9)
    handles = [
        Patch(facecolor=COLOURS[k], edgecolor="#707070", label=result.words[k]) for k in present
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=3)
    return figure


STUDY = Study(module=__name__, name="attraction", title="Region of attraction", order=30, schema=6)
