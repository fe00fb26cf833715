"""Compare MuJoCo with the analytic model and give a verdict."""

from __future__ import annotations

import math
import re
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
from afl_mujoco.pool import compute_all, open_executor
from afl_mujoco.report.blocks import Block, Cell, Chart, Figure, Matrix, Report, Section
from afl_mujoco.report.markdown import plain
from afl_mujoco.report.numbers import fixed, interval, limit, percent, scientific, short, size
from afl_mujoco.scenario.catalogue import SCENARIOS, is_published
from afl_mujoco.scenario.files import find_scenario
from afl_mujoco.scenario.requirements import NONE as NOTHING
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.words import describe
from afl_mujoco.simulation.metrics import STATE_UNITS, SYMBOLS, UNITS
from afl_mujoco.simulation.mujoco_rollout import simulate_mujoco
from afl_mujoco.simulation.scoring import nominal_scales, with_objective
from afl_mujoco.simulation.trajectory import COMPLETED
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
from afl_mujoco.studies.contract import Progress, ScenarioNames, Study, counted, silent
from afl_mujoco.studies.run import Rows, run_of
from afl_mujoco.studies.run import Run as Row
from afl_mujoco.studies.tables import asked, grouped, how, metrics_matrix, requirements_matrix
from afl_mujoco.studies.verify.checks import (
    closed_loop_checks,
    equation_checks,
    free_swings,
    reference_checks,
)
from afl_mujoco.studies.verify.claims import (
    DECISIONS,
    GROUPS,
    Claim,
    Comparison,
    decidable,
    judge_claims,
    kind,
    shipped,
)
from afl_mujoco.studies.verify.convergence import Refinement
from afl_mujoco.studies.verify.criteria import ANY, CRITERIA, Check
from afl_mujoco.studies.verify.curves import QUANTITIES, Curves, chart_data, select_curves
from afl_mujoco.studies.verify.explanation import (
    SOURCES,
    ErrorBudget,
    Explanation,
    Ledger,
    Omission,
    explain,
    plateau_check,
)

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
    controllers: tuple[str, ...] = PAPER
    """Controllers by name, as in `afl-mujoco simulate --help` except -estimated ones; or your own,
    module:attribute."""
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

    controllers = [find_controller(name) for name in options.controllers]
    period = options.timestep if options.control_period is None else options.control_period
    settings = Settings(timestep=options.timestep, control_period=period, full=options.full)
    require_runnable(scenarios, controllers, settings)
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
    error_budgets, ledgers, omissions, studies
        What explains the cases; all but the budgets are empty unless the verification was full.
    decisions
        Decisions taken where the paper is silent, by id.
    settings, scenarios
        What was run.
    curves
        Every case over time, by ``scenario/controller``.
    """

    verdict: Literal["pass", "fail"]
    checks: tuple[Check, ...]
    runs: tuple[Run, ...]
    rows: Rows = ()
    claims: tuple[Claim, ...] = ()
    random_schedules: Mapping[str, Comparison] = field(default_factory=dict)
    error_budgets: tuple[ErrorBudget, ...] = ()
    ledgers: tuple[Ledger, ...] = ()
    omissions: tuple[Omission, ...] = ()
    studies: tuple[Refinement, ...] = ()
    decisions: Mapping[str, str] = field(default_factory=lambda: dict(DECISIONS))
    settings: Settings = field(default_factory=Settings)
    scenarios: tuple[Scenario, ...]
    curves: Mapping[str, Curves]

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
            if missing := UNITS.keys() - run.metrics.keys():
                raise ValueError(f"metrics of a run must hold {min(missing)}")
        for case, simulators in simulated.items():
            if sorted(simulators) != sorted(REPORTED):
                raise ValueError(f"runs must hold each simulator once, {'/'.join(case)} does not")
            if "/".join(case) not in self.curves:
                raise ValueError(f"curves must hold {'/'.join(case)}, a run's")
        if {scenario.name for scenario in self.scenarios} != {name for name, _ in simulated}:
            raise ValueError("scenarios must be those of the runs")

    @property
    def passed(self) -> bool:
        """Whether every check holds and every requirement is met."""
        return self.verdict == "pass"

    @property
    def failed_checks(self) -> list[Check]:
        """The checks that do not hold."""
        return [check for check in self.checks if not check.passed]

    def curves_on(self, scenario: Scenario) -> list[Curves]:
        """Return the curves of a scenario under each controller."""
        return [one for one in self.curves.values() if one.scenario == scenario.name]


def run(request: Request, *, workers: int = 1, progress: Progress = silent) -> Result:
    """Judge every scenario with every controller; the result does not depend on the workers."""
    scenarios, controllers, settings = request
    scales = nominal_scales(settings.timestep)
    published = {s.name for s in scenarios if is_published(s)}
    claimed = decidable({(name, c.name) for name in published for c in controllers})
    parts: list[Callable[[], Any]] = [partial(_of_equations, settings.full)]
    parts += [partial(judge, (s, c, settings)) for s in scenarios for c in controllers]
    progress("checking", 0, len(parts))
    with open_executor(min(workers, len(parts))) as executor:
        done = compute_all(call, parts, executor, counted(progress, "checking", len(parts)))
    checks, studies = done[0]
    judged: list[Judged] = done[1:]
    runs = tuple(
        replace(run, metrics=with_objective(run.metrics, scales))
        for case in judged
        for run in case.runs
    )
    decisive = {
        (run.scenario, run.controller): run.metrics
        for run in runs
        if run.simulator == DECISIVE and run.scenario in published
    }
    known = shipped() if claimed else None
    for case in judged:
        checks += [*case.checks, *case.explanation.checks]
        studies += case.explanation.studies
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
        ledgers=tuple(e.ledger for e in explained if e.ledger),
        omissions=tuple(e.omission for e in explained if e.omission),
        studies=tuple(studies),
        settings=settings,
        scenarios=tuple(scenarios),
        curves={f"{c.curves.scenario}/{c.curves.controller}": c.curves for c in judged},
    )


def _of_equations(full: bool) -> tuple[list[Check], list[Refinement]]:
    """Return the checks that need no case, and the refinement studies among them."""
    checks = list(equation_checks())
    if not full:
        return checks, []
    swings = free_swings()
    return [*checks, *reference_checks(swings), plateau_check()], list(swings)


class Judged(NamedTuple):
    """What is found of one case."""

    checks: tuple[Check, ...]
    runs: tuple[Run, ...]
    row: Row
    explanation: Explanation
    curves: Curves


def judge(case: Case) -> Judged:
    """Run and judge one scenario with one controller.

    The codes are compared on the ideal loop; requirements are of the run as deployed.
    """
    scenario, controller, settings = case
    ideal = scenario.ideal
    runs = closed_loop_runs(ideal, controller, settings)
    deployed = runs[DEPLOYED] if scenario == ideal else simulate_mujoco(scenario, controller)
    shown = {name: runs[name] for name in REPORTED}
    return Judged(
        closed_loop_checks(ideal, controller, runs),
        reported_runs(ideal, controller, runs),
        run_of(scenario, controller, deployed),
        explain(ideal, controller, runs, full=settings.full),
        select_curves(ideal, controller.name, shown, settings.timestep),
    )


# --- what is shown ------------------------------------------------------------------------------

QUANTILES = ("5%", "25%", "median", "75%", "95%")
"""Percentiles of the improvement over random schedules that are shown."""

PICTURED = "step-step"
"""The scenario whose runs are shown first, if it is there."""


def report(result: Result) -> Report:
    """Return what is shown of a verification."""
    pictured = next((s for s in result.scenarios if s.name == PICTURED), result.scenarios[0])
    blocks: list[Block] = [*_requirements(result)]
    blocks.append(_runs_figure(result, pictured))
    blocks += [_claims(result)] if result.claims else []
    blocks.append(_checks(result))
    blocks += [_budget(result)] if result.error_budgets else []
    blocks += _details(result)
    blocks += [_scenario(result, one, one is not pictured) for one in result.scenarios]
    decided = "\n".join(f"- **{id}**: {plain(words)}" for id, words in result.decisions.items())
    blocks.append(Section("Decisions where the paper is silent", "decisions", [decided], True))
    return Report(headline=_headline(result), passed=result.passed, blocks=blocks)


def _headline(result: Result) -> str:
    """Say whether the codes agree, what is missed, and how many of the paper's claims hold."""
    total, failed = len(result.checks), result.failed_checks
    said = [f"CODES AGREE {total}/{total}"]
    if failed or not total:
        said = [f"CODES DIFFER, {total - len(failed)}/{total} checks hold"]
    if failed:
        one = failed[0]
        where = "" if one.scenario == ANY else f" on {one.scenario} with {one.controller}"
        said[0] += f": {one.id} {_value(one.value)} > {limit(one.limit)}{where}"
    if missing := [run for run in result.rows if run.missed]:
        one_of = f"{missing[0].controller} on {missing[0].scenario} {how(missing[0].failure)}"
        said.append(f"{len(missing)} of {len(result.rows)} runs fail: {one_of}")
    named = {(run.scenario, run.controller) for run in missing}
    ended = [
        run
        for run in result.runs
        if run.outcome != COMPLETED and (run.scenario, run.controller) not in named
    ]
    if ended:
        one_run, cases = ended[0], {(run.scenario, run.controller) for run in ended}
        said.append(
            f"{len(cases)} of {len(result.curves)} cases did not complete: {one_run.scenario} with "
            f"{one_run.controller} {one_run.outcome}, {one_run.simulator}"
        )
    if result.claims:
        groups = [GROUPS[kind(claim.verdict)][1] for claim in result.claims]
        counts = ", ".join(f"{groups.count(one)} {one}" for one in dict.fromkeys(groups))
        said.append(f"of the paper's {len(groups)} claims {counts}")
    return "; ".join(said)


def _requirements(result: Result) -> list[Matrix]:
    """Return how requirements are met; nothing if completion is the only one and all complete."""
    own = any(one.requirements != NOTHING or one != one.ideal for one in result.scenarios)
    if not own and not any(run.missed for run in result.rows):
        return []
    found = []
    for scenario in result.scenarios:
        cases = grouped([run for run in result.rows if run.scenario == scenario.name])
        draws = {name: runs for (_, name), runs in cases.items()}
        needs = {name: [run.metrics for run in runs] for name, runs in draws.items()}
        found.append(requirements_matrix(scenario, draws, needs))
    return found


def _runs_figure(result: Result, scenario: Scenario) -> Figure:
    """Return a scenario over time under each controller."""
    hold = short(1e3 * result.settings.control_period)
    return Figure(
        name=f"report-runs-{_number(result, scenario)}",
        title=f"{scenario.name} in MuJoCo and by the equations",
        caption=f"Colours: MuJoCo as deployed, the force held for {hold} ms; dashed over them: the "
        "ideal equations; grey across: disturbances.",
        draw=partial(_draw, "draw_runs", scenario, result.curves_on(scenario)),
    )


def _number(result: Result, scenario: Scenario) -> int:
    """Return the number of a scenario, from 1."""
    return [one.name for one in result.scenarios].index(scenario.name) + 1


def _claims(result: Result) -> Section:
    """Return the paper's claims beside what is found here."""
    blocks: list[Block] = [
        Matrix(
            caption="C9 to C12, and what readings say of C3 to C6, come with the package",
            columns=("Claim", "Paper", "Here", "Verdict"),
            rows=[
                (
                    one.id,
                    _counted(one, one.paper, 4),
                    _counted(one, one.here, 3),
                    Cell(one.verdict, GROUPS[kind(one.verdict)][0]),
                )
                for one in result.claims
            ],
        ),
        Figure(
            name="report-claims",
            title="The paper's claims",
            caption="The paper's number (open) and the one found here (filled); the bar is the "
            "95 % interval of C9. C3 to C6 are the improvements of the paper's Table 3.",
            draw=partial(_draw, "draw_claims", result.claims, result.random_schedules),
        ),
        Matrix(
            caption="What is claimed, what is compared, and why the verdict",
            columns=("Claim", "The paper says", "Compared", "Why the verdict"),
            rows=[(one.id, one.claim, one.figure, one.why) for one in result.claims],
            folded="What each claim says, and why the verdict",
        ),
    ]
    if result.random_schedules:
        rows = [
            (
                name,
                str(one.schedules),
                percent(one.share, 3),
                f"{interval(one.interval)} %",
                *(fixed(one.quantiles.get(quantile), 1) for quantile in QUANTILES),
            )
            for name, one in result.random_schedules.items()
        ]
        columns = ("Gains", "Schedules", "Adaptive wins", "95 % interval", *QUANTILES)
        caption = "Adaptive against fixed gains, and percentiles of the improvement [%]"
        matrix = Matrix(caption=caption, columns=columns, rows=rows)
        blocks.append(Section("Random schedules", "random", [matrix], folded=True))
    return Section("The paper's claims", "claims", blocks)


def _counted(claim: Claim, value: float | None, digits: int) -> str:
    """Return a number of a claim with its unit."""
    unit = re.search(r"\[([^]]*)\]$", claim.figure)
    return f"{short(value, digits)} {unit[1]}" if unit and value is not None else short(value)


def _checks(result: Result) -> Section:
    """Return each criterion at its worst, and every judged value."""
    found = {id: [check for check in result.checks if check.id == id] for id in CRITERIA}
    worst = [max(alike, key=lambda check: check.rank) for alike in found.values() if alike]
    judged = {(c.scenario, c.controller, c.id): c for c in result.checks if c.scenario != ANY}
    ids = [id for id in CRITERIA if any(id == key[2] for key in judged)]
    outcomes = {(run.scenario, run.controller, run.simulator): run for run in result.runs}
    cases = dict.fromkeys((run.scenario, run.controller) for run in result.runs)
    return Section(
        "Checks",
        "checks",
        [
            Matrix(
                caption="Each criterion at its worst, states in m, rad, m/s, rad/s",
                columns=("Check", "What is compared", "Worst", "Limit", "Margin"),
                rows=[
                    (
                        one.id,
                        one.quantity + (f" [{one.unit}]" if one.unit in ("J", "N s") else ""),
                        Cell(_value(one.value), "good" if one.passed else "bad"),
                        limit(one.limit),
                        _margin(one),
                    )
                    for one in worst
                ],
            ),
            Matrix(
                caption="How each case ended in MuJoCo, continuous and as deployed; the objective; "
                "every judged value",
                columns=("Scenario", "Controller", "Continuous", "Deployed", "Objective", *ids),
                rows=[
                    (
                        *case,
                        *(_ended(outcomes[*case, name]) for name in (DECISIVE, DEPLOYED)),
                        fixed(outcomes[*case, DECISIVE].metrics["objective"], 4),
                        *(_judged(judged.get((*case, id))) for id in ids),
                    )
                    for case in cases
                ],
                folded="Every case",
            ),
            Matrix(
                caption="The criteria",
                columns=("Check", "Why this limit", "Proves", "Leaves open"),
                rows=[
                    (one.id, one.reason, CRITERIA[one.id].proves, CRITERIA[one.id].leaves_open)
                    for one in worst
                ],
                folded="Why these limits, and what each check proves and leaves open",
            ),
        ],
    )


def _value(value: float | None) -> str:
    """Return a judged value as text."""
    if value is None:
        return "none"
    return short(value, 2) if value == 0.0 or 1e-2 <= abs(value) < 1e3 else scientific(value)


def _margin(check: Check) -> str:
    """Return how many times a value fits into its limit."""
    if not check.value or not check.limit:
        return "–"
    return f"{short(check.limit / check.value, 2)}×"


def _ended(run: Run) -> Cell:
    """Return how a run ended; one that did not complete is marked."""
    return Cell(run.outcome, "" if run.outcome == COMPLETED else "bad")


def _judged(check: Check | None) -> Cell:
    """Return a judged value; one that fails is marked."""
    return Cell("–") if check is None else Cell(_value(check.value), "" if check.passed else "bad")


def _budget(result: Result) -> Section:
    """Return why a run as deployed differs from the ideal equations."""
    budgets = result.error_budgets
    worst = max(budgets, key=lambda budget: abs(budget.at_worst.total))
    at, parts = worst.at_worst, {**SOURCES, "residual": "not explained", "total": "total"}
    return Section(
        "Error budget",
        "budget",
        [
            Matrix(
                caption=f"{worst.scenario}, {worst.controller}: as deployed minus the equations, "
                f"{SYMBOLS[at.state]} [{STATE_UNITS[at.state]}] at {short(at.time)} s",
                columns=("Source", "There", "Largest in any run"),
                rows=[
                    (
                        words,
                        scientific(getattr(at, name)),
                        scientific(max(getattr(one, name) for one in budgets)),
                    )
                    for name, words in parts.items()
                ],
            ),
            Figure(
                name="report-budget",
                title="What the difference consists of",
                caption="Left: the worst run, in the state and at the instant where it is worst; "
                "there the signed parts add up. Right: the largest value of any state at any "
                "instant, in every run.",
                draw=partial(_draw, "draw_budget", budgets),
            ),
            Matrix(
                caption="Largest of any state at any instant [m, rad, m/s, rad/s]",
                columns=("Scenario", "Controller", *parts.values(), "residual of total"),
                rows=[
                    (
                        one.scenario,
                        one.controller,
                        *(scientific(getattr(one, name)) for name in parts),
                        percent(one.residual_share),
                    )
                    for one in budgets
                ],
                folded=f"Error budget of {len(budgets)} runs",
            ),
        ],
    )


def _details(result: Result) -> list[Section]:
    """Return what a full verification adds: orders, ledgers, and what the paper leaves out."""
    found: list[Section] = []
    if result.studies:
        alike: dict[str, list[Refinement]] = {}
        for study in result.studies:
            alike.setdefault(study.study, []).append(study)
        orders = Matrix(
            caption="Orders observed over four step sizes",
            columns=("Study", "Expected", "Observed", "Runs"),
            rows=[
                (name, short(some[0].expected), _range([one.order for one in some]), f"{len(some)}")
                for name, some in alike.items()
            ],
        )
        found.append(Section("Observed orders", "orders", [orders], folded=True))
    if result.ledgers:
        parts = {
            "work": "Work [J]",
            "energy_of_ramps": "Ramps [J]",
            "energy_of_jumps": "Jumps [J]",
            "energy_residual": "Residual [J]",
            "impulse": "Impulse [N s]",
            "momentum_of_ramps": "Ramps [N s]",
            "momentum_of_jumps": "Jumps [N s]",
            "momentum_residual": "Residual [N s]",
        }
        ledgers = Matrix(
            caption="Ledger at the end of each run; the residual is the largest along it",
            columns=("Scenario", "Controller", *parts.values()),
            rows=[
                (one.scenario, one.controller, *(short(getattr(one, name)) for name in parts))
                for one in result.ledgers
            ],
        )
        found.append(Section("Energy and momentum", "ledger", [ledgers], folded=True))
    if result.omissions:
        omissions = Matrix(
            caption="Largest change of any state (SI)",
            columns=("Scenario", "Controller", "Terms in l′", "Momenta kept at steps"),
            rows=[
                (one.scenario, one.controller, size(one.stretching_rod), size(one.momenta_kept))
                for one in result.omissions
            ],
        )
        title = "What the paper’s frozen parameters leave out"
        found.append(Section(title, "omissions", [omissions], folded=True))
    return found


def _range(orders: Sequence[float | None]) -> str:
    """Return the range of the orders that there are."""
    known = [order for order in orders if order is not None and math.isfinite(order)]
    low, high = (fixed(f(known, default=None), 3) for f in (min, max))
    return low if low == high else f"{low} to {high}"


def _scenario(result: Result, scenario: Scenario, drawn: bool) -> Section:
    """Return one scenario: what happens in it, its curves, its metrics in every simulator."""
    number = _number(result, scenario)
    facts = "\n".join(f"- **{label}**: {plain(text)}" for label, text in describe(scenario))
    runs = [run for run in result.runs if run.scenario == scenario.name]
    blocks: list[Block] = [
        facts,
        Chart(
            anchor=f"scenario-{number}",
            title="Trajectories",
            quantities=QUANTITIES,
            data=chart_data(result.curves_on(scenario), scenario),
        ),
        *([_runs_figure(result, scenario)] if drawn else []),
        metrics_matrix(
            {f"{run.controller}, {run.simulator}": [run.metrics] for run in runs},
            list(runs[0].metrics),
            folded="All metrics in every simulator",
            digits=6,
        ),
    ]
    return Section(scenario.name, f"scenario-{number}", blocks, folded=True)


def _draw(figure: str, *arguments: Any) -> Any:
    """Draw a figure of `verify.figures`."""
    from afl_mujoco.studies.verify import figures

    return getattr(figures, figure)(*arguments)


# --- junit.xml ----------------------------------------------------------------------------------


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
    judged += [
        (
            one.requirement,
            f"{run.scenario}/{run.controller}",
            ""
            if one.met
            else f"{run.controller} {how(run.failure)}: {asked(one)}, got {one.value}",
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
    order=0,
    schema=1,
    configuration=Options,
    prepare=prepare,
    run=run,
    stem="report",
)
