"""Find how much delay, noise or friction controllers survive."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple

import tyro

from afl_mujoco.control.controller import Controller
from afl_mujoco.control.names import SWEPT, find_controllers, subject_of
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.plants.plant import Plant
from afl_mujoco.report.blocks import MISSING, Block, Report, listed, percent, plain, short
from afl_mujoco.scenario.files import find_scenario
from afl_mujoco.scenario.imperfections import Imperfection
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.studies.shared.contract import (
    Progress,
    ScenarioNames,
    Study,
    Timestep,
    compute,
    named_controllers,
    silent,
)
from afl_mujoco.studies.shared.robustness import (
    COMBINED,
    KNOWN,
    Settings,
    SweepUnit,
    all_settled,
    find_imperfection,
    known_of,
    left_out,
    referred,
    require_runs,
    run_on,
    survived,
    sweep,
    times_reference,
)
from afl_mujoco.studies.shared.run import Rows, Run
from afl_mujoco.studies.shared.search import Threshold
from afl_mujoco.studies.shared.tables import graded, how
from afl_mujoco.values import require_distinct

DEFAULT, QUICK = (4, 13, 0.02), (2, 7, 0.2)
"""Seeds, levels of the scan and tolerance, unless given otherwise."""

GRADES = (
    "fails on the reference hardware or milder",
    "less than 3 × to spare",
    "3 to 10 × to spare",
    "more than 10 ×, or all that was tried",
    "the force does not depend on it",
)
"""Grades of a threshold, by how it compares with the reference hardware."""

FAILS, LITTLE, SOME, MUCH, IDLE = range(5)


@dataclass(frozen=True, kw_only=True)
class Options:
    """Find how much delay, noise, friction and so on each controller survives in MuJoCo.

    Example: afl-mujoco thresholds step-step --controllers adaptive lqr --imperfections delay noise

    Each imperfection is one departure from the ideal loop. For each of them the study runs the
    level of the reference hardware (good but ordinary laboratory equipment), and finds by
    bisection the level from which the pole falls, the run diverges or the cart reaches an end
    stop or, where a scenario has requirements, one of these is missed. It then does the same with
    all imperfections combined. Writes thresholds.json and figures. A full run takes about ten
    minutes on two cores.
    """

    scenarios: ScenarioNames = ()
    """Scenarios by name, or TOML files: each level must be survived in all of them; step-step by
    default."""
    controllers: Annotated[tuple[str, ...], named_controllers(", ".join(SWEPT))] = ()
    imperfections: Annotated[
        tuple[str, ...],
        tyro.conf.arg(
            help=f"Imperfections by name, all by default; of the cart-pole: {', '.join(KNOWN)}. "
            "Those of another plant have the names of its own coordinates, inputs and parameters."
        ),
    ] = ()
    seeds: int | None = None
    """Number of noise seeds, all of which must be survived; 4 by default."""
    scan: int | None = None
    """Number of levels in the scan before bisection; 13 by default."""
    tolerance: float | None = None
    """Relative width to which bisection narrows a threshold; 0.02 by default."""
    quick: bool = False
    """2 seeds, 7 levels and a tolerance of 0.2, unless given otherwise."""
    timestep: Timestep = None


class Request(NamedTuple):
    """What is studied."""

    controllers: Sequence[Controller]
    scenarios: tuple[Scenario, ...]
    settings: Settings = Settings()
    names: Sequence[str] = tuple(KNOWN)  # of imperfections
    left_out: Mapping[str, str] = MappingProxyType({})  # why others cannot be swept, by title

    @property
    def plant(self) -> Plant:
        """The plant of all scenarios."""
        return self.scenarios[0].plant

    def require(self) -> Request:
        """Return it, or raise if a rule is broken."""
        if any(scenario.plant is not self.plant for scenario in self.scenarios):
            raise InvalidValueError("scenarios", "must be of one plant")
        named = [find_imperfection(name, self.plant) for name in self.names]
        require_distinct("imperfection", [one.name for one in named])
        self.settings.require()
        require_runs(self.controllers, self.scenarios, self.settings.deployed)
        why = [(one, left_out(self.scenarios, one, self.settings.timestep)) for one in named]
        out = {one.title: reason for one, reason in why if reason}
        if len(out) == len(named):
            rule = "must leave one that can be swept"
            raise InvalidValueError("imperfections", f"{rule} ({next(iter(out.values()))})")
        return self._replace(names=[one.name for one, reason in why if not reason], left_out=out)


def prepare(options: Options) -> Request:
    """Return what the options ask for."""
    o = options
    usual = dict(zip(("seeds", "scan", "tolerance"), QUICK if o.quick else DEFAULT, strict=True))
    searched: Any = usual | {name: x for name in usual if (x := getattr(o, name)) is not None}
    settings = Settings(**searched, timestep=o.timestep)
    scenarios = tuple(find_scenario(name) for name in o.scenarios or ("step-step",))
    controllers = find_controllers(o.controllers, scenarios, SWEPT)
    names = o.imperfections or tuple(known_of(scenarios[0].plant))
    return Request(controllers, scenarios, settings, names).require()


@dataclass(frozen=True, slots=True, kw_only=True)
class Sweep:
    """One controller under one imperfection; as in `Swept`, runs as places among the rows."""

    imperfection: str  # their names
    controller: str
    reference: tuple[int, ...]
    failure: tuple[int, ...]
    survives: Threshold
    settles: Threshold
    applies: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """Thresholds of every controller under every imperfection."""

    settings: Settings  # how they were searched
    scenarios: tuple[Scenario, ...]  # each level must be survived in all of them
    imperfections: tuple[Imperfection, ...]  # that were swept, with the level of the reference
    rows: Rows  # the runs that the sweeps name, and those with nothing added
    # by controller, its runs with nothing added, as places among the rows; one that fails there has
    # no sweeps
    bare: Mapping[str, tuple[int, ...]]
    sweeps: tuple[Sweep, ...] = ()  # by imperfection and then by controller
    left_out: Mapping[str, str] = field(default_factory=dict)  # why others were not swept, by title

    def runs(self, places: Sequence[int]) -> list[Run]:
        """Return some of the runs."""
        return [self.rows[place] for place in places]

    @property
    def controllers(self) -> list[str]:
        """The controllers that survive with nothing added."""
        return [name for name, places in self.bare.items() if survived(self.runs(places))]

    def sweep(self, imperfection: str, controller: str) -> Sweep:
        """Return one controller under one imperfection, by their names."""
        asked = (imperfection, controller)
        return next(one for one in self.sweeps if (one.imperfection, one.controller) == asked)


def run(
    request: Request, *, progress: Progress = silent, workers: int = 1, cluster: str | None = None
) -> Result:
    """Find the thresholds; workers and cluster do not change a bit of them."""
    controllers, scenarios, settings, names, out = request
    asked = [SweepUnit("", one, scenarios, settings) for one in controllers]
    as_it_is = partial(run_on, hardware={})
    bare = compute(as_it_is, asked, "as it is", progress, workers, cluster=cluster)
    sound = [unit for unit, runs in zip(asked, bare, strict=True) if survived(runs)]
    units = [unit._replace(name=name) for name in names for unit in sound]
    swept = [find_imperfection(name, request.plant) for name in names]
    told = [f"{unit.controller.name}, {one.title}" for one in swept for unit in sound]
    found = compute(sweep, units, "sweeping", progress, workers, told, cluster)
    rows: list[Run] = []

    def kept(runs: Sequence[Run]) -> tuple[int, ...]:
        rows.extend(runs)
        return tuple(range(len(rows) - len(runs), len(rows)))

    first = {one.name: kept(runs) for one, runs in zip(controllers, bare, strict=True)}
    sweeps = []
    for unit, one in zip(units, (x._asdict() for x in found), strict=True):
        one |= {key: kept(one[key]) for key in ("reference", "failure")}
        sweeps.append(Sweep(imperfection=unit.name, controller=unit.controller.name, **one))
    return Result(
        settings=settings,
        scenarios=scenarios,
        imperfections=tuple(referred(one, scenarios) for one in swept),
        rows=tuple(rows),
        bare=first,
        sweeps=tuple(sweeps),
        left_out=dict(out),
    )


# --- what is shown ------------------------------------------------------------------------------


def _with_unit(one: Imperfection, text: str) -> str:
    return f"{text} {one.unit}".rstrip()


def level_text(one: Imperfection, level: float) -> str:
    """Return a level [SI] in the unit of its imperfection, with two digits."""
    digits = 3 if one.name == COMBINED.name else 2  # near 1 a third digit matters
    return short(one.scale * level, digits)


def threshold_text(one: Imperfection, threshold: Threshold) -> str:
    """Return a threshold: the level of the failure, or that all levels hold or none."""
    past, before = ("<", ">") if one.less_is_worse else (">", "<")
    if threshold.fails_at is None:
        return f"{past} {level_text(one, threshold.holds_at or 0.0)}"
    return f"{before} " * (threshold.holds_at is None) + level_text(one, threshold.fails_at)


def grade_of(result: Result, one: Imperfection, found: Sweep) -> int:
    """Return the grade of a sweep, an index into `GRADES`."""
    if not found.applies:
        return IDLE
    fails_at = found.survives.fails_at  # past a level that fails, others may hold by chance
    milder = fails_at is not None and times_reference(one, fails_at) < 1.0
    if milder or not survived(result.runs(found.reference)):
        return FAILS
    ratio = _spare(one, found)
    if found.survives.fails_at is None or ratio >= 10.0:
        return MUCH
    return SOME if ratio >= 3.0 else LITTLE


def _spare(one: Imperfection, found: Sweep) -> float:
    held = found.survives.holds_at
    return times_reference(one, held) if held else 0.0


def report(result: Result) -> Report:
    """Return what is shown of thresholds."""
    names = result.controllers
    on = listed([scenario.name for scenario in result.scenarios], "and")
    failing, own = [], {scenario.name: scenario for scenario in result.scenarios}
    for name in (name for name in result.bare if name not in names):
        run = next(one for one in result.runs(result.bare[name]) if one.failure)
        words = how(run.failure, own[run.scenario])
        failing.append(f"{name} {words}" + f" ({run.message})" * bool(run.message))
    passes = "passes" if any(one.judged for one in result.scenarios) else "survives"
    none = f"No controller {passes} {on} as it is."
    headline = _headline(result, names, passes) if names else none
    blocks: list[Block] = []
    if failing:
        blocks.append(f"With nothing added: {'; '.join(failing)}.")
    blocks += [f"Not swept: {title}: {plain(why)}." for title, why in result.left_out.items()]
    if names:
        cells = {
            _label(result, one): [_cell(result, one, name) for name in names]
            for one in result.imperfections
        }
        title = f"Level at which each controller fails on {on}"
        width = percent(result.settings.tolerance, 3)
        caption = f"In brackets: the reference level. Found to {width}. "
        caption += "The higher the better, but of limits and rails the lower."
        if any(text.endswith("~") for row in cells.values() for _, text in row):
            caption += " ~: not at rest at the end on the reference hardware."
        blocks += graded("thresholds", title, caption, ["Imperfection", *names], cells, GRADES)
    return Report(headline=headline, blocks=blocks)


def _headline(result: Result, names: Sequence[str], passes: str) -> str:
    """Say what the study's own controller survives, and what has the least to spare."""
    ours = subject_of(names)
    single = [one for one in result.imperfections if one.name != COMBINED.name]
    swept = [(one, result.sweep(one.name, ours)) for one in single]
    acting = [(grade, *pair) for pair in swept if (grade := grade_of(result, *pair)) != IDLE]
    if not acting:
        return f"{ours}: no single imperfection was tried that acts on it."
    survives = sum(grade > FAILS for grade, *_ in acting)
    _, least, found = min(acting, key=lambda x: (x[0] == MUCH, _spare(*x[1:])))
    at = _with_unit(least, threshold_text(least, found.survives))
    at = "none that was tried" if found.survives.fails_at is None else at
    reference = _with_unit(least, level_text(least, least.reference))
    return (
        f"{ours} {passes} the reference level of {survives} of {len(acting)} imperfections; least "
        f"to spare: {least.title} (reference {reference}, fails at {at})."
    )


def _label(result: Result, one: Imperfection) -> str:
    """Return an imperfection with its reference, and what a level is where the scenario has one."""
    own = [s.hardware(key) for s in result.scenarios for key in one.fields]
    kind = "" if not any(own) else ", added" if one.adds else ", total"
    return f"{one.title} ({_with_unit(one, level_text(one, one.reference))}{kind})"


def _cell(result: Result, one: Imperfection, name: str) -> tuple[int, str]:
    found = result.sweep(one.name, name)
    if not found.applies:
        return IDLE, MISSING
    reference = result.runs(found.reference)
    unsettled = survived(reference) and not all_settled(reference)
    return grade_of(result, one, found), threshold_text(one, found.survives) + " ~" * unsettled


STUDY = Study(
    module=__name__, name="thresholds", title="Imperfection thresholds", order=10, schema=7
)
