"""Check a loop in MuJoCo against the equations of its plant."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from operator import call
from pathlib import Path
from typing import Any, Literal, NamedTuple
from xml.etree import ElementTree

from afl_mujoco.control.controller import Controller
from afl_mujoco.control.names import PAPER
from afl_mujoco.files import require_no_folder, write_text
from afl_mujoco.scenario.catalogue import SCENARIOS, is_published
from afl_mujoco.scenario.files import find_scenario
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.metrics import UNITS
from afl_mujoco.simulation.mujoco_rollout import simulate_mujoco
from afl_mujoco.simulation.scoring import nominal_scales, with_objective
from afl_mujoco.studies.arrays import Array
from afl_mujoco.studies.cases import (
    DECISIVE,
    DEPLOYED,
    REPORTED,
    Case,
    Run,
    Settings,
    closed_loop_runs,
    reported_runs,
    require_runnable,
)
from afl_mujoco.studies.contract import Progress, ScenarioNames, Study, compute, silent
from afl_mujoco.studies.run import Rows, run_of
from afl_mujoco.studies.run import Run as Row
from afl_mujoco.studies.tables import asked, how
from afl_mujoco.studies.verify import any_plant
from afl_mujoco.studies.verify.checks import (
    closed_loop_checks,
    equation_checks,
    reference_checks,
)
from afl_mujoco.studies.verify.claims import (
    Claim,
    Comparison,
    decidable,
    judge_claims,
    shipped,
)
from afl_mujoco.studies.verify.criteria import Check
from afl_mujoco.studies.verify.explanation import (
    ErrorBudget,
    Judged,
    Omission,
    explain,
    moving,
    plateau_check,
)
from afl_mujoco.studies.verify.report import report as report

JUNIT = "junit.xml"


@dataclass(frozen=True, kw_only=True)
class Options:
    """Compare MuJoCo with the analytic model and give a verdict.

    Example: afl-mujoco validate step-step my-scenario.toml --controllers fixed adaptive

    Writes report.html, which needs no other file, report.json, report.md, report.npz, junit.xml
    and figures. The exit code is 0 if every check holds and every requirement is met, else 1.
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

    from afl_mujoco.control.catalogue import find_controller

    paper = any(scenario.is_cart_pole for scenario in scenarios)
    names = options.controllers or (PAPER if paper else ("lqr",))
    controllers = [find_controller(name) for name in names]
    period = options.timestep if options.control_period is None else options.control_period
    settings = Settings(timestep=options.timestep, control_period=period, full=options.full)
    require_runnable(scenarios, controllers, settings)
    if not paper:
        for scenario in scenarios:
            any_plant.require_comparable(scenario.ideal)
    return Request(scenarios, controllers, settings)


def verdict_of(checks: Sequence[Check], rows: Sequence[Row] = ()) -> Literal["pass", "fail"]:
    """Return whether every check holds, and there is one, and every requirement is met."""
    missed = any(run.missed for run in rows)
    holds = bool(checks) and all(check.passed for check in checks)
    return "pass" if holds and not missed else "fail"


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """What a verification found.

    Attributes
    ----------
    verdict
        "pass" if every check holds, and there is one, and every requirement is met, else "fail".
    checks, runs, rows
        Every judged value; each case in each simulator; each case as deployed and judged.
    claims
        The paper's claims C1 to C12; empty unless all runs that they need were made.
    random_schedules
        Adaptive against fixed gains over random schedules, published and retuned: behind C9.
    error_budgets, omissions
        Why the codes differ, and what the paper's frozen M and l leave out if it was asked in full.
    settings, scenarios
        What was run.
    curves
        Every case as deployed, by ``scenario/controller``: some instants [s], and states.
    """

    verdict: Literal["pass", "fail"]
    checks: tuple[Check, ...]
    runs: tuple[Run, ...]
    rows: Rows = ()
    claims: tuple[Claim, ...] = ()
    random_schedules: Mapping[str, Comparison] = field(default_factory=dict)
    error_budgets: tuple[ErrorBudget, ...] = ()
    omissions: tuple[Omission, ...] = ()
    settings: Settings = field(default_factory=Settings)
    scenarios: tuple[Scenario, ...]
    curves: Mapping[str, tuple[Array, Array]]

    def __post_init__(self) -> None:
        """Raise if the parts contradict each other."""
        expected = verdict_of(self.checks, self.rows)
        if self.verdict != expected:
            raise ValueError(f"verdict must be {expected!r}, as judged, got {self.verdict!r}")
        if self.random_schedules and "published" not in self.random_schedules:
            raise ValueError("random_schedules must hold the published gains")
        simulated: dict[tuple[str, str], list[str]] = {}
        for run in self.runs:
            simulated.setdefault((run.scenario, run.controller), []).append(run.simulator)
            if self.of_paper and (missing := UNITS.keys() - run.metrics.keys()):
                raise ValueError(f"metrics of a run must hold {min(missing)}")
        shown = REPORTED if self.model_verified else REPORTED[1:]
        for case, simulators in simulated.items():
            if sorted(simulators) != sorted(shown):
                raise ValueError(f"runs must hold each simulator once, {'/'.join(case)} does not")
            if "/".join(case) not in self.curves:
                raise ValueError(f"curves must hold {'/'.join(case)}, a run's")
        if {scenario.name for scenario in self.scenarios} != {name for name, _ in simulated}:
            raise ValueError("scenarios must be those of the runs")
        self._require_states()

    def _require_states(self) -> None:
        """Raise if a budget is of no state of its plant."""
        states = {one.name: one.plant.states for one in self.scenarios}
        for budget in self.error_budgets:
            known = states.get(budget.scenario, ())
            if (state := budget.at_worst.state) not in known:
                raise ValueError(f"state must be one of {', '.join(known)}, got {state!r}")

    @property
    def of_paper(self) -> bool:
        """Whether it is of the cart-pole."""
        return all(scenario.is_cart_pole for scenario in self.scenarios)

    @property
    def model_verified(self) -> bool:
        """Whether the plant has equations, so that MuJoCo was held against them."""
        return self.of_paper or any(check.id == "A1e" for check in self.checks)

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
    parts: list[Callable[[], Any]] = (
        [partial(_of_equations, settings.full)]
        if paper
        else [partial(any_plant.of_plant, one) for one in scenarios]
    )
    whole, of_case = len(parts), judge if paper else any_plant.judge
    parts += [partial(of_case, (s, c, settings)) for s in scenarios for c in controllers]
    done = compute(call, parts, "checking", progress, workers)
    checks = [check for found in done[:whole] for check in found]
    judged: list[Judged] = done[whole:]
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
    for case in judged:
        checks += [*case.checks, *case.explanation.checks]
    rows = tuple(case.row for case in judged)
    explained = [case.explanation for case in judged]
    return Result(
        verdict=verdict_of(checks, rows),
        checks=tuple(checks),
        runs=runs,
        rows=rows,
        claims=judge_claims(decisive, known) if known else (),
        random_schedules=known.random_schedules if known else {},
        error_budgets=tuple(e.budget for e in explained if e.budget),
        omissions=tuple(e.omission for e in explained if e.omission),
        settings=settings,
        scenarios=tuple(scenarios),
        curves={f"{case.row.scenario}/{case.row.controller}": case.moving for case in judged},
    )


def _of_equations(full: bool) -> list[Check]:
    """Return the checks that need no case."""
    more = (*reference_checks(), plateau_check()) if full else ()
    return [*equation_checks(), *more]


def judge(case: Case) -> Judged:
    """Run and judge one scenario with one controller.

    The codes are compared on the ideal loop; requirements are of the run as deployed.
    """
    scenario, controller, settings = case
    ideal = scenario.ideal
    runs = closed_loop_runs(ideal, controller, settings)
    deployed = runs[DEPLOYED] if scenario == ideal else simulate_mujoco(scenario, controller)
    return Judged(
        closed_loop_checks(ideal, controller, runs),
        reported_runs(ideal, controller, runs),
        run_of(scenario, controller, deployed),
        explain(ideal, controller, runs, full=settings.full),
        moving(runs[DEPLOYED]),
    )


def require_files(folder: Path) -> None:
    """Raise if a folder is in the way of the file."""
    require_no_folder(folder, (JUNIT,))


def write_files(result: Result, folder: Path) -> list[Path]:
    """Write every check and every requirement as a test case, for what reads test results."""
    write_text(folder / JUNIT, junit(result))
    return [folder / JUNIT]


def junit(result: Result) -> str:
    """Return checks and requirements as JUnit XML."""
    judged = [
        (c.id, f"{c.scenario}/{c.controller}", "" if c.passed else _failure(c))
        for c in result.checks
    ]
    scenarios = {scenario.name: scenario for scenario in result.scenarios}
    judged += [
        (
            one.requirement,
            f"{run.scenario}/{run.controller}",
            ""
            if one.met
            else f"{run.controller} {how(run.failure)}: {asked(one, scenarios[run.scenario])}, "
            f"got {one.value}",
        )
        for run in result.rows
        for one in run.requirements
    ]
    failures = str(sum(bool(failure) for *_, failure in judged))
    suite = ElementTree.Element(
        "testsuite", name="afl-mujoco validate", tests=str(len(judged)), failures=failures
    )
    for what, place, failure in judged:
        case = ElementTree.SubElement(suite, "testcase", classname=what, name=place)
        if failure:
            ElementTree.SubElement(case, "failure", message=failure)
    ElementTree.indent(suite)
    return ElementTree.tostring(suite, encoding="unicode", xml_declaration=True) + "\n"


def _failure(check: Check) -> str:
    """Describe a failed check."""
    value = "none" if check.value is None else f"{check.value:.1e}"
    return (
        f"{check.id} {check.scenario}/{check.controller}: {check.quantity} is {value}, "
        f"must be {check.comparison} {check.limit:g} {check.unit}"
    )


STUDY = Study(
    name="validate",
    title="MuJoCo against the equations",
    order=2,
    schema=1,
    configuration=Options,
    prepare=prepare,
    run=run,
    stem="report",
)
