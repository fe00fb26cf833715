"""What is shown of a verification: headline, claims, checks, error budget, scenarios."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from afl_mujoco.report.blocks import Block, Cell, Figure, Matrix, Report, Section
from afl_mujoco.report.markdown import plain
from afl_mujoco.report.numbers import fixed, interval, limit, percent, scientific, short
from afl_mujoco.scenario.parameters import symbol
from afl_mujoco.scenario.requirements import NONE
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.words import describe
from afl_mujoco.simulation.trajectory import COMPLETED, Layout
from afl_mujoco.studies.cases import DECISIVE, DEPLOYED
from afl_mujoco.studies.tables import grouped, how, metrics_matrix, replay, requirements_matrix
from afl_mujoco.studies.verify.claims import GROUPS, Claim, kind
from afl_mujoco.studies.verify.convergence import Refinement
from afl_mujoco.studies.verify.criteria import ANY, CRITERIA, Check
from afl_mujoco.studies.verify.explanation import SOURCES

if TYPE_CHECKING:
    from afl_mujoco.studies.validate import Result

QUANTILES = ("5%", "25%", "median", "75%", "95%")
"""Percentiles of the improvement over random schedules that are shown."""

PICTURED = "step-step"
"""The scenario whose runs are shown first, if it is there."""


def report(result: Result) -> Report:
    """Return what is shown of a verification."""
    pictured = next((s for s in result.scenarios if s.name == PICTURED), result.scenarios[0])
    blocks: list[Block] = [*_requirements(result)]
    blocks += _pictures(result, pictured) if result.curves else []
    blocks += [_claims(result)] if result.claims else []
    blocks.append(_checks(result))
    blocks += [_budget(result)] if result.error_budgets else []
    blocks += _details(result)
    blocks += [_scenario(result, one, one is not pictured) for one in result.scenarios]
    decided = "\n".join(f"- **{id}**: {plain(words)}" for id, words in result.decisions.items())
    if decided:
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
    if not result.model_verified:
        said.append("model not verified: no equations")
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
        one_run, (cases, all_cases) = (
            ended[0],
            ({(run.scenario, run.controller) for run in runs} for runs in (ended, result.runs)),
        )
        said.append(
            f"{len(cases)} of {len(all_cases)} cases did not complete: {one_run.scenario} with "
            f"{one_run.controller} {one_run.outcome}, {one_run.simulator}"
        )
    if result.claims:
        groups = [GROUPS[kind(claim.verdict)][1] for claim in result.claims]
        counts = ", ".join(f"{groups.count(one)} {one}" for one in dict.fromkeys(groups))
        said.append(f"of the paper's {len(groups)} claims {counts}")
    return "; ".join(said)


def _requirements(result: Result) -> list[Block]:
    """Return how requirements are met; nothing if completion is the only one and all complete."""
    own = any(one.requirements != NONE or one != one.ideal for one in result.scenarios)
    if not own and not any(run.missed for run in result.rows):
        return []
    found: list[Block] = []
    if any(one != one.ideal for one in result.scenarios):
        found.append("With the imperfections of the file; the codes are compared without them.")
    for scenario in result.scenarios:
        cases = grouped([run for run in result.rows if run.scenario == scenario.name])
        draws = {name: runs for (_, name), runs in cases.items()}
        needs = {name: [run.metrics for run in runs] for name, runs in draws.items()}
        found.append(requirements_matrix(scenario, draws, needs))
    return found


def _pictures(result: Result, scenario: Scenario) -> list[Block]:
    """Return a scenario under each controller: replayed, and over time."""
    number, curves = _number(result, scenario), result.curves_on(scenario)
    hold = short(1e3 * result.settings.control_period)
    figure = Figure(
        name=f"report-runs-{number}",
        title=f"{scenario.name} in MuJoCo and by the equations",
        caption=f"Colours: MuJoCo as deployed, the force held for {hold} ms; dashed over them: the "
        "ideal equations; grey across: disturbances.",
        draw=partial(_draw, "draw_runs", scenario, curves),
    )
    deployed = [x for x in result.runs if (x.scenario, x.simulator) == (scenario.name, DEPLOYED)]
    endings = {run.controller: run.outcome for run in deployed}
    moving = {
        one.controller: (one.time[: len(states)], states)
        for one in curves
        for states in [one.states[DEPLOYED]]
    }
    return [replay(f"report-runs-{number}", scenario, moving, endings), figure]


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
                        *(
                            Cell(outcome, "" if outcome == COMPLETED else "bad")
                            for name in (DECISIVE, DEPLOYED)
                            if (outcome := outcomes[*case, name].outcome)
                        ),
                        fixed(outcomes[*case, DECISIVE].metrics.get("objective"), 4),
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
                f"{symbol(at.state)} [{at.unit}] at {short(at.time)} s",
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
            _by_case(
                "Largest of any state at any instant [m, rad, m/s, rad/s]",
                budgets,
                parts,
                folded=f"Error budget of {len(budgets)} runs",
            ),
        ],
    )


BOOKED = {
    "work": "Work [J]",
    "energy_of_ramps": "Ramps [J]",
    "energy_of_jumps": "Jumps [J]",
    "energy_residual": "Residual [J]",
    "impulse": "Impulse [N s]",
    "momentum_of_ramps": "Ramps [N s]",
    "momentum_of_jumps": "Jumps [N s]",
    "momentum_residual": "Residual [N s]",
}
GROWN = {
    "difference": "|MuJoCo exact − ODE|, whole run",
    "amplification": "Growth of a small change of the start",
}
OMITTED = {"stretching_rod": "Terms in l′", "momenta_kept": "Momenta kept at steps"}


def _details(result: Result) -> Iterator[Section]:
    """Yield what a full verification adds: orders, ledgers, and what the paper leaves out."""
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
        yield Section("Observed orders", "orders", [orders], folded=True)
    for found, columns, title, anchor, caption in (
        (
            result.growths, GROWN, "Differences over whole runs", "growth",
            "Shown, not judged: an unstable plant amplifies round-off; restarts keep it from that",
        ),
        (
            result.ledgers, BOOKED, "Energy and momentum", "ledger",
            "Ledger at the end of each run; the residual is the largest along it",
        ),
        (
            result.omissions, OMITTED, "What the paper’s frozen parameters leave out", "omissions",
            "Largest change of any state (SI)",
        ),
    ):  # fmt: skip
        if found:
            yield Section(title, anchor, [_by_case(caption, found, columns)], folded=True)


def _by_case(
    caption: str, found: Sequence[Any], columns: Mapping[str, str], *, folded: str = ""
) -> Matrix:
    """Return some fields of what was found of each case."""
    return Matrix(
        caption=caption,
        columns=("Scenario", "Controller", *columns.values()),
        rows=[
            (one.scenario, one.controller, *(short(getattr(one, name), 3) for name in columns))
            for one in found
        ],
        folded=folded,
    )


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
        *(_pictures(result, scenario) if drawn and result.curves else []),
        metrics_matrix(
            {f"{run.controller}, {run.simulator}": [run.metrics] for run in runs},
            list(runs[0].metrics),
            folded="All metrics in every simulator",
            digits=6,
            layout=Layout.of(scenario),
        ),
    ]
    return Section(scenario.name, f"scenario-{number}", blocks, folded=True)


def _draw(figure: str, *arguments: Any) -> Any:
    """Draw a figure of `verify.figures`."""
    from afl_mujoco.studies.verify import figures

    return getattr(figures, figure)(*arguments)
