"""Check a loop in MuJoCo against the equations of its plant."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from operator import call
from typing import Any, Literal, NamedTuple

from afl_mujoco.control.controller import Controller
from afl_mujoco.control.names import PAPER, find_controllers
from afl_mujoco.scenario.catalogue import SCENARIOS, is_published
from afl_mujoco.scenario.files import find_scenario
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.mujoco_rollout import simulate_mujoco
from afl_mujoco.studies.shared.arrays import Array
from afl_mujoco.studies.shared.contract import Progress, ScenarioNames, Study, compute, silent
from afl_mujoco.studies.shared.run import Rows, Run, run_of
from afl_mujoco.studies.verify import any_plant
from afl_mujoco.studies.verify.cases import (
    DECISIVE,
    DEPLOYED,
    Case,
    Settings,
    Simulated,
    closed_loop_runs,
    reported_runs,
    require_runnable,
)
from afl_mujoco.studies.verify.checks import (
    Check,
    closed_loop_checks,
    equation_checks,
    reference_checks,
)
from afl_mujoco.studies.verify.claims import (
    Claim,
    Comparison,
    decidable,
    judge_claims,
    nominal_scales,
    shipped,
    with_objective,
)
from afl_mujoco.studies.verify.explanation import (
    ErrorBudget,
    Growth,
    Judged,
    Omission,
    explain,
    moving,
    plateau_check,
)
from afl_mujoco.studies.verify.report import report as report
from afl_mujoco.values import require_positive


@dataclass(frozen=True, kw_only=True)
class Options:
    """Compare MuJoCo with the analytic model and give a verdict.

    Example: afl-mujoco validate step-step my-scenario.toml --controllers fixed adaptive

    Writes report.html, which needs no other file, report.json, report.md, report.npz and a figure.
    The exit code is 0 if every check holds and every requirement is met, else 1.
    """

    scenarios: ScenarioNames = ()
    """Scenarios by name, or TOML files; all nine of the paper by default."""
    controllers: tuple[str, ...] = ()
    """Controllers by name, as in `afl-mujoco simulate --help` except -estimated ones; or your own,
    module:attribute. The paper's by default, lqr for another plant."""
    full: bool = False
    """Add refinement studies, ledgers, a second method, and the effect of what the paper omits."""
    timestep: float = 1e-3
    """Physics step of MuJoCo [s]."""
    control_period: float | None = None
    """How long sampled mode holds the force [s], a multiple of the timestep; by default one
    step."""


class Request(NamedTuple):
    """What is judged."""

    scenarios: Sequence[Scenario]
    controllers: Sequence[Controller]
    settings: Settings = Settings()


def prepare(options: Options) -> Request:
    """Return what the options ask for, or raise if a rule is broken."""
    scenarios = [find_scenario(name) for name in options.scenarios or SCENARIOS]
    controllers = find_controllers(options.controllers, scenarios, PAPER)
    require_positive("timestep", options.timestep)
    period = options.timestep if options.control_period is None else options.control_period
    settings = Settings(timestep=options.timestep, control_period=period, full=options.full)
    require_runnable(scenarios, controllers, settings)
    for scenario in scenarios:
        if not scenario.is_cart_pole:
            any_plant.require_comparable(scenario.ideal)
    return Request(scenarios, controllers, settings)


def verdict_of(checks: Sequence[Check], rows: Sequence[Run] = ()) -> Literal["pass", "fail"]:
    """Return whether every check holds, and there is one, and every requirement is met."""
    missed = any(run.missed for run in rows)
    holds = bool(checks) and all(check.passed for check in checks)
    return "pass" if holds and not missed else "fail"


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """What a verification found."""

    # "pass" if every check holds, and there is one, and every requirement is met, else "fail"
    verdict: Literal["pass", "fail"]
    checks: tuple[Check, ...]  # every judged value
    runs: tuple[Simulated, ...]  # each case in each simulator
    rows: Rows = ()  # each case as deployed and judged
    # the paper's claims C1 to C12; empty unless all runs that they need were made
    claims: tuple[Claim, ...] = ()
    # adaptive against fixed gains over random schedules, published and retuned: behind C9
    random_schedules: Mapping[str, Comparison] = field(default_factory=dict)
    # why the codes differ, and what the paper's frozen M and l leave out if it was asked in full
    error_budgets: tuple[ErrorBudget, ...] = ()
    omissions: tuple[Omission, ...] = ()
    # of another plant: how far the codes are apart over a whole run, which is not judged
    growths: tuple[Growth, ...] = ()
    settings: Settings = field(default_factory=Settings)  # what was run
    scenarios: tuple[Scenario, ...]
    # every case as deployed, by `scenario/controller`: some instants [s], and states
    curves: Mapping[str, tuple[Array, Array]]

    def __post_init__(self) -> None:
        expected = verdict_of(self.checks, self.rows)
        if self.verdict != expected:
            raise ValueError(f"verdict must be {expected!r}, as judged, got {self.verdict!r}")
        if {scenario.name for scenario in self.scenarios} != {run.scenario for run in self.runs}:
            raise ValueError("scenarios must be those of the runs")
        cases = {f"{run.scenario}/{run.controller}" for run in self.runs}
        if missing := cases - self.curves.keys():
            raise ValueError(f"curves must hold {min(missing)}, a run's")

    @property
    def model_verified(self) -> bool:
        """Whether the plant has equations, so that MuJoCo was held against them."""
        return not {"A1", "A1e"}.isdisjoint(check.id for check in self.checks)

    @property
    def passed(self) -> bool:
        """Whether every check holds and every requirement is met."""
        return self.verdict == "pass"

    @property
    def failed_checks(self) -> list[Check]:
        """The checks that do not hold."""
        return [check for check in self.checks if not check.passed]


def run(request: Request, *, workers: int = 1, progress: Progress = silent) -> Result:
    """Judge every scenario with every controller; the result does not depend on the workers."""
    scenarios, controllers, settings = request
    paper = scenarios[0].is_cart_pole
    published = {s.name for s in scenarios if is_published(s)}
    claimed = decidable({(name, c.name) for name in published for c in controllers})
    parts: list[Callable[[], Any]] = [partial(any_plant.of_plant, one) for one in scenarios]
    if paper:
        parts = [partial(_of_equations, settings.full)]
    whole, of_case = len(parts), judge if paper else any_plant.judge
    parts += [partial(of_case, (s, c, settings)) for s in scenarios for c in controllers]
    done = compute(call, parts, "checking", progress, workers)
    judged: list[Judged] = done[whole:]
    groups = [*done[:whole], *(case.checks for case in judged)]
    checks = tuple(check for group in groups for check in group)
    runs = tuple(run for case in judged for run in case.runs)
    if paper:
        scales = nominal_scales(settings.timestep)
        runs = tuple(replace(one, metrics=with_objective(one.metrics, scales)) for one in runs)
    decisive = {
        (run.scenario, run.controller): run.metrics
        for run in runs
        if run.simulator == DECISIVE and run.scenario in published
    }
    known = shipped() if claimed else None
    rows = tuple(case.row for case in judged)
    return Result(
        verdict=verdict_of(checks, rows),
        checks=checks,
        runs=runs,
        rows=rows,
        claims=judge_claims(decisive, known) if known else (),
        random_schedules=known.random_schedules if known else {},
        error_budgets=tuple(case.budget for case in judged if case.budget),
        omissions=tuple(case.omission for case in judged if case.omission),
        growths=tuple(case.growth for case in judged if case.growth),
        settings=settings,
        scenarios=tuple(scenarios),
        curves={f"{case.row.scenario}/{case.row.controller}": case.moving for case in judged},
    )


def _of_equations(full: bool) -> list[Check]:
    more = (*reference_checks(), plateau_check()) if full else ()
    return [*equation_checks(), *more]


def judge(case: Case) -> Judged:
    """Compare the codes on the ideal loop of a case; judge requirements by the run as deployed."""
    scenario, controller, settings = case
    ideal = scenario.ideal
    runs = closed_loop_runs(ideal, controller, settings)
    deployed = runs[DEPLOYED] if scenario == ideal else simulate_mujoco(scenario, controller)
    explained, budget, omission = explain(ideal, controller, runs, full=settings.full)
    return Judged(
        (*closed_loop_checks(ideal, controller, runs), *explained),
        reported_runs(ideal, controller, runs),
        run_of(scenario, controller, deployed),
        moving(runs[DEPLOYED]),
        budget,
        omission,
    )


STUDY = Study(
    module=__name__,
    name="validate",
    title="MuJoCo against the equations",
    order=2,
    schema=1,
    stem="report",
)
