"""Compare controllers by the requirements of a scenario."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from afl_mujoco.control.controller import Controller
from afl_mujoco.control.names import find_controllers
from afl_mujoco.control.own import calls_limited_to
from afl_mujoco.control.plant_feedback import LinearFeedback
from afl_mujoco.errors import AflMujocoError, UnknownNameError, require_count
from afl_mujoco.graphics import require_backend
from afl_mujoco.report.blocks import Block, Figure, Report, Section, plain, to_markdown
from afl_mujoco.scenario.files import as_scenarios, find_scenario
from afl_mujoco.scenario.parameters import labelled
from afl_mujoco.scenario.sample_space import draws_of
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.time_steps import Deployed
from afl_mujoco.simulation.bound_controllers import bound
from afl_mujoco.simulation.judgement import remarks_on
from afl_mujoco.simulation.metrics import in_order, metrics
from afl_mujoco.simulation.trajectory import Layout, Trajectory
from afl_mujoco.studies.shared.arrays import Array
from afl_mujoco.studies.shared.contract import (
    ControllerNames,
    Progress,
    ScenarioNames,
    Study,
    Timestep,
    counted,
    silent,
)  # fmt: skip
from afl_mujoco.studies.shared.loop_margins import linearize, stable_as_held
from afl_mujoco.studies.shared.robustness import require_runs
from afl_mujoco.studies.shared.run import Rows, Run, numbered, require_alike, run_kept
from afl_mujoco.studies.shared.tables import (
    ENDINGS,
    as_file,
    grouped,
    metrics_matrix,
    replay,
    requirements_matrix,
)

if TYPE_CHECKING:
    from afl_mujoco.films.video import Film

MOST_DRAWS = 1000

Figures = Mapping[str, float | None]


@dataclass(frozen=True, kw_only=True)
class Options:
    """Compare controllers as deployed in MuJoCo, on any plant, by the requirements of a scenario.

    Example: afl-mujoco compare my-scenario.toml --controllers lqr adaptive my_module:MyController

    Writes compare.json, curves over time, and the page. The exit code is 0 if every controller
    meets every requirement of its scenario, and 1 if one does not.
    """

    scenarios: ScenarioNames = ("step-step",)
    """Scenarios by name, or TOML files, with their imperfections and requirements."""
    controllers: ControllerNames = ()
    timestep: Timestep = None
    control_period: float | None = None
    """How long the force is held [s], a multiple of the timestep; by default that of the
    scenario's imperfections, else one step."""
    integrator: str = "RK4"
    """MuJoCo's integrator: RK4, Euler, implicit, implicitfast."""
    draws: int | None = None
    """Number of draws of noise, and of the start within an encoder's step; by default 10 where
    noise or encoders act, else 1."""
    film: bool = False
    """Film the first four controllers side by side, one MP4 for each scenario."""


class Request(NamedTuple):
    """What is compared."""

    scenarios: Sequence[Scenario]
    controllers: Sequence[Controller]
    deployed: Deployed = Deployed()
    draws: int | None = None
    film: bool = False

    def require(self) -> Request:
        """Return it, or raise if anything would break the comparison, before it begins."""
        require_runs(self.controllers, self.scenarios, self.deployed)
        if self.draws is not None:
            require_count("draws", self.draws, 1, MOST_DRAWS)
        return self


def prepare(options: Options) -> Request:
    """Return what the options ask for, or raise if a rule is broken."""
    o = options
    scenarios = [find_scenario(name) for name in o.scenarios]  # before what is slow to import
    if o.film:
        require_backend()  # before MuJoCo

    controllers = find_controllers(o.controllers, scenarios)
    deployed = Deployed(o.integrator, o.timestep, o.control_period)
    request = Request(scenarios, controllers, deployed, o.draws, o.film).require()
    if o.film:
        films(request)  # raises if a scenario does not last a frame
    return request


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Curves:
    """A run over time: instants [s], states, exerted inputs and commands as of `Trajectory`."""

    time: Array
    state: Array
    force: Array
    command: Array
    signals: Mapping[str, Array] = field(default_factory=dict)

    def of(self, k: int, inputs: Array) -> Array:
        """Return what concerns one input."""
        return inputs.reshape(len(self.time), -1)[:, k]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Result:
    """Controllers compared.

    Attributes
    ----------
    scenarios
        The scenarios.
    rows
        Runs of every scenario with every controller, draw by draw.
    metrics
        All figures of each of these runs, as in `simulation.metrics`; none if its controller
        failed.
    remarks
        What a reader should know about the first draw of each, by ``scenario/controller``.
    curves
        The first draw of each over time, by ``scenario/controller``; none if the controller failed.
    timestep, control_period, integrator
        How they were deployed; a period of None means that of the scenario, else one step.
    """

    scenarios: tuple[Scenario, ...]
    rows: Rows
    metrics: tuple[Mapping[str, float | None], ...]
    remarks: Mapping[str, tuple[str, ...]]
    curves: Mapping[str, Curves]
    timestep: float | None
    control_period: float | None
    integrator: str

    def __post_init__(self) -> None:
        names = {scenario.name for scenario in self.scenarios}
        if not self.rows or {run.scenario for run in self.rows} != names:
            raise ValueError("rows must be runs of the scenarios")
        if len(self.metrics) != len(self.rows):
            raise ValueError("metrics must be those of the rows")
        known = {f"{run.scenario}/{run.controller}" for run in self.rows}
        if unknown := self.curves.keys() - known:
            raise ValueError(f"curves must be those of the rows, got {min(unknown)!r}")

    @property
    def passed(self) -> bool:
        """Whether every run meets every requirement."""
        return not any(run.missed for run in self.rows)

    @property
    def table(self) -> list[dict[str, Any]]:
        """How each run ended and its metrics, one row each, ready for pandas."""
        rows = [run.row for run in self.rows]
        for row, figures in zip(rows, self.metrics, strict=True):
            del row["requirements"]
            row |= {name: x for name, x in figures.items() if name not in row}
        return rows

    @property
    def requirements(self) -> list[dict[str, Any]]:
        """Each run judged by each requirement, one row each, ready for pandas."""
        known = {scenario.name: scenario for scenario in self.scenarios}
        return [
            {"scenario": run.scenario, "controller": run.controller, "draw": run.draw}
            | asdict(one)
            | {"unit": known[run.scenario].unit_of(one.requirement), "met": one.met}
            for run in self.rows
            for one in run.requirements
        ]

    def plot(self, scenario: str | None = None) -> Any:
        """Draw the runs of a scenario, the first by default; return the matplotlib figure."""
        known = {one.name: one for one in self.scenarios}
        name = self.scenarios[0].name if scenario is None else scenario
        if name not in known:
            raise UnknownNameError.among("scenario", name, known)
        from afl_mujoco.report.figures import styled

        with styled():
            return draw_responses(known[name], self.curves_on(known[name]))

    def __repr__(self) -> str:
        return f"<{report(self).headline}>"

    def __str__(self) -> str:
        """Return who meets the requirements, and how much of each is left, as text."""
        from afl_mujoco.report.terminal import to_text

        return to_text(self._told)

    def _repr_markdown_(self) -> str:
        """Return the same as Markdown, for a notebook."""
        return to_markdown(self._told)

    @property
    def _told(self) -> list[Block]:
        return [block for one in self.scenarios for block in _answer(self, one)]

    def draws_of(self, scenario: Scenario) -> tuple[dict[str, list[Run]], dict[str, list[Figures]]]:
        """Return the draws of each controller on a scenario, and all their figures."""
        draws: dict[str, list[Run]] = {}
        found: dict[str, list[Figures]] = {}
        for run, figures in zip(self.rows, self.metrics, strict=True):
            if run.scenario == scenario.name:
                draws.setdefault(run.controller, []).append(run)
                found.setdefault(run.controller, []).append(figures)
        return draws, found

    def curves_on(self, scenario: Scenario) -> dict[str, Curves]:
        """Return the curves of a scenario by controller."""
        keys = {run.controller: f"{scenario.name}/{run.controller}" for run in self.rows}
        return {name: self.curves[key] for name, key in keys.items() if key in self.curves}


def compare(
    scenarios: Scenario | str | Path | Sequence[Scenario | str | Path],
    controllers: Any,
    *,
    timestep: float | None = None,
    control_period: float | None = None,
    integrator: str = "RK4",
    draws: int | None = None,
    call_limit: float | None = None,
) -> Result:
    """Run controllers on scenarios as deployed in MuJoCo; one that fails does not stop the others.

    Parameters
    ----------
    scenarios
        One or several: scenarios, names or TOML files.
    controllers
        One or several, each as for `simulate_mujoco`.
    timestep, control_period, integrator
        As for `simulate_mujoco`.
    draws
        Number of draws of noise and of the start within an encoder's step, the first the scenario
        itself; by default ten where noise or encoders act, else one.
    call_limit
        How long one call of a controller in Python may take [s]; 1 by default. Its first in a run
        may take 60, for a library to compile.

    Returns
    -------
    Result
        Every run with its metrics and requirements: `table`, `requirements`, `plot`. Printed, or
        shown by a notebook, it says who meets which requirement, and how much of it is left.

    Raises
    ------
    UnknownNameError
        If there is no scenario, controller or integrator of that name.
    InvalidValueError
        If two controllers have one name, `draws` is not from 1 to 1000, or the step is not positive
        or does not divide the control period. All of this is said before the first run.

    Examples
    --------
    >>> import afl_mujoco as afl
    >>> result = afl.compare("step-step", ["lqr", "adaptive"])
    >>> result.passed
    True
    """
    from afl_mujoco.control.catalogue import as_controller

    several = isinstance(controllers, Sequence) and not isinstance(controllers, str)
    with calls_limited_to(call_limit):
        used = [as_controller(x) for x in (controllers if several else (controllers,))]
    deployed = Deployed(integrator, timestep, control_period)
    return run(Request(as_scenarios(scenarios), used, deployed, draws).require())


def run(request: Request, *, progress: Progress = silent, workers: int = 1) -> Result:
    """Run every controller on every draw of every scenario, whose bits no worker changes."""
    scenarios, controllers, deployed, draws, _ = request
    rows: list[Run] = []
    figures: list[Figures] = []
    remarks: dict[str, tuple[str, ...]] = {}
    curves: dict[str, Curves] = {}
    advance = counted(progress, "simulating", len(scenarios) * len(controllers))
    for scenario, controller in itertools.product(scenarios, controllers):
        drawn = draws_of(scenario, draws)
        runs, kept = zip(*run_kept(controller, drawn, deployed, workers), strict=True)
        if len(scenarios) > 1 or len(drawn) > 1:
            require_alike(controller, drawn[0], runs[0], deployed)
        rows += numbered(runs)
        ran = bound(controller, scenario)
        figures += [{} if run is None else metrics(one, ran, run)
                    for one, run in zip(drawn, kept, strict=True)]  # fmt: skip
        key, first = f"{scenario.name}/{controller.name}", kept[0]
        if first is not None:
            told = remarks_on(first, scenario, controller, "in draw 1, " * (len(drawn) > 1))
            if said := (*told, *_held(scenario, controller, first)):
                remarks[key] = said
            curves[key] = Curves(
                time=first.time, state=first.state, force=first.input, command=first.command,
                signals=dict(first.signals),
            )  # fmt: skip
        advance(controller.name)
    return Result(
        scenarios=tuple(scenarios), rows=tuple(rows), metrics=tuple(figures), remarks=remarks,
        curves=curves, **asdict(deployed),
    )  # fmt: skip


def _held(scenario: Scenario, controller: Controller, run: Trajectory) -> Iterator[str]:
    """Remark on an LQR, which is designed for continuous time, where the hardware is too slow."""
    own, period = bound(controller, scenario), run.control_period
    if not isinstance(own, LinearFeedback) or period is None:
        return
    with suppress(AflMujocoError):  # it has no linear loop where its drive cannot hold it
        if not stable_as_held(linearize(own, scenario), period, scenario.imperfections):
            held = f"inputs held for {1e3 * period:.3g} ms and the delays of the scenario"
            why = "it is designed for continuous time, with weights from the requirements"
            yield f"its linear loop is unstable with {held}: {why}"


# --- what is shown ------------------------------------------------------------------------------


def report(result: Result) -> Report:
    """Return what is shown of a comparison."""
    cases = grouped(result.rows)
    said = [
        (f"{scenario}: " if len(result.scenarios) > 1 else "") + f"{controller} {_score(draws)}"
        for (scenario, controller), draws in cases.items()
    ]
    names = dict.fromkeys(controller for _, controller in cases)
    passing = len(names) - len({run.controller for run in result.rows if run.missed})
    on = ", ".join(scenario.name for scenario in result.scenarios)
    each = enumerate(result.scenarios, 1)
    return Report(
        title=f"{on}: {', '.join(names)}",
        headline=" · ".join(said),
        passed=result.passed,
        verdict=f"{passing} OF {len(names)} PASS" if 0 < passing < len(names) else "",
        blocks=[block for number, one in each for block in _shown(result, number, one)],
    )


def _score(draws: Sequence[Run]) -> str:
    """Return how many requirements a controller meets or, of several draws, how many it passes."""
    if len(draws) > 1:
        passing = sum(not run.failure for run in draws)
        ended = [run.failure for run in draws if run.failure in ENDINGS]
        how_ended = f" ({ENDINGS[max(ended, key=ended.count)]})" if ended else ""
        return f"{passing} of {len(draws)} draws{how_ended}"
    (run,) = draws
    return f"{len(run.requirements) - len(run.missed)} of {len(run.requirements)}"


def _answer(result: Result, scenario: Scenario) -> list[Block]:
    draws, figures = result.draws_of(scenario)
    told_of: dict[str, list[str]] = {}
    for name in draws:
        for remark in result.remarks.get(f"{scenario.name}/{name}", ()):
            told_of.setdefault(remark, []).append(name)
    lines = [f"{', '.join(names)}: {remark}" for remark, names in told_of.items()]
    lines += [f"{name} {first.ending}" for name, (first, *_) in draws.items() if first.message]
    told = ["\n".join(f"- {plain(line)}" for line in lines)] if lines else []
    return [requirements_matrix(scenario, draws, figures), *told]


def _shown(result: Result, number: int, scenario: Scenario) -> list[Block]:
    (draws, figures), blocks = result.draws_of(scenario), _answer(result, scenario)
    if curves := result.curves_on(scenario):
        endings = {name: some[0].ending for name, some in draws.items()}
        moving = {name: (one.time, one.state) for name, one in curves.items()}
        first = " The first of the draws." * any(len(some) > 1 for some in draws.values())
        blocks += [
            replay(f"compare-{number}", scenario, moving, endings, first),
            Figure(
                name=f"compare-{number}",
                title=f"{scenario.name} over time",
                caption="Dashed: limits; grey along the curves: bands of rest; grey across: "
                f"disturbances; pale: the command.{first}",
                draw=partial(draw_responses, scenario, curves),
            ),
        ]
    shown = in_order(name for some in figures.values() for found in some for name in found)
    return [
        *blocks,
        metrics_matrix(figures, shown, folded="All metrics", layout=Layout.of(scenario)),
        Section("The scenario", f"compare-{number}-scenario", [as_file(scenario)], folded=True),
    ]


def draw_responses(scenario: Scenario, runs: Mapping[str, Curves]) -> Any:
    """Draw coordinates, inputs, signals that are required, and parameters, by controller."""
    from afl_mujoco.report.figures import Panel, curves

    asked, plant = scenario.requirements, scenario.plant
    rests = asked.settling_time is not None or asked.recover_within is not None

    def panel(name: str, values: Mapping[str, Array], **more: Any) -> Panel:
        return Panel(
            label=labelled(name, plant.units.get(name, "")),
            curves={one: (runs[one].time, x) for one, x in values.items()},
            limits=[*scenario.required_of(name), *scenario.required_of(f"{name}_command")],
            **more,
        )

    panels = []
    for k, name in enumerate(plant.states):
        states = {one: run.state[:, k] for one, run in runs.items()}
        if name in plant.coordinates:
            band = scenario.band(name) if rests else None
            panels.append(panel(name, states, about=scenario.about(name), band=band))
        elif scenario.required_of(name):
            panels.append(panel(name, states))
    for k, name in enumerate(plant.inputs):
        force = {one: run.of(k, run.force) for one, run in runs.items()}
        pale = {one: (run.time, command) for one, run in runs.items()
                if not np.array_equal(command := run.of(k, run.command), force[one])}  # fmt: skip
        panels.append(panel(name, force, pale=pale))
    for name in filter(scenario.required_of, plant.signals):
        panels.append(panel(name, {one: run.signals[name] for one, run in runs.items()}))
    if shown := [name for name, (low, high) in scenario.spans.items() if low < high]:
        instants = np.array(scenario.breakpoints)
        around = np.concatenate([np.nextafter(instants, 0.0), instants])
        time = np.unique([*np.linspace(0.0, scenario.duration, 500), *around])
        table = {
            labelled(name, plant.units.get(name, "")): (time, scenario.schedule[name](time))
            for name in shown
        }
        panels.append(Panel(label="plant", curves=table, black=True))
    pushes = [(min(d.breakpoints), max(d.breakpoints)) for d in scenario.disturbances]
    return curves(panels, scenario.duration, shaded=pushes)


def films(request: Request, result: Result | None = None, command: str = "") -> list[Film]:
    """Return a film of the controllers side by side for each scenario; those that ran of a result.

    They are made by the command line, after the figures.
    """
    from afl_mujoco.films.video import side_by_side

    found = []
    for scenario in request.scenarios:
        there = None if result is None else result.curves_on(scenario)
        shown = [one for one in request.controllers if there is None or one.name in there]
        if shown:
            found.append(side_by_side(scenario, shown, request.deployed, command=command))
    return found


STUDY = Study(module=__name__, name="compare", title="Controllers compared", order=0, schema=4)
