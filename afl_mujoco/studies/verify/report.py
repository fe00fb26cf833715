"""What is shown of a verification: headline, claims, checks, error budget, scenarios."""

from __future__ import annotations

import re
from functools import partial
from typing import TYPE_CHECKING, Any

from afl_mujoco.report.blocks import (
    MISSING,
    Block,
    Cell,
    Figure,
    Matrix,
    Replay,
    Report,
    Section,
    fixed,
    limit,
    scientific,
    short,
)
from afl_mujoco.scenario.parameters import symbol
from afl_mujoco.scenario.requirements import NONE
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.trajectory import COMPLETED
from afl_mujoco.studies.shared.tables import as_file, grouped, how, replay, requirements_matrix
from afl_mujoco.studies.verify.cases import DEPLOYED
from afl_mujoco.studies.verify.checks import ANY, CRITERIA
from afl_mujoco.studies.verify.claims import GROUPS, Claim, kind
from afl_mujoco.studies.verify.explanation import SOURCES

if TYPE_CHECKING:
    from afl_mujoco.studies.validate import Result

PICTURED = "step-step"  # the scenario whose runs are shown first, if it is there
PERCENT = " [%]"  # ending of the quantity of a claim that is drawn on the axis


def report(result: Result) -> Report:
    """Return what is shown of a verification."""
    pictured = next((s for s in result.scenarios if s.name == PICTURED), result.scenarios[0])
    blocks: list[Block] = [*_requirements(result), _replay(result, pictured)]
    blocks += [_claims(result)] if result.claims else []
    blocks.append(_checks(result))
    blocks += [_budget(result)] if result.error_budgets else []
    blocks += [_omissions(result)] if result.omissions else []
    blocks += [_growths(result)] if result.growths else []
    blocks += [_scenario(result, one, one is not pictured) for one in result.scenarios]
    return Report(headline=_headline(result), passed=result.passed, blocks=blocks)


def _headline(result: Result) -> str:
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
        first = missing[0]
        own = next(one for one in result.scenarios if one.name == first.scenario)
        one_of = f"{first.controller} on {first.scenario} {how(first.failure, own)}"
        values = [x.value for x in first.requirements if x.requirement == first.failure]
        value = f" ({short(values[0], 3)})" if values and values[0] is not None else ""
        wrong = f"{len(missing)} of {len(result.rows)} runs fail: {one_of}{value}"
        said.insert(1 if failed else 0, wrong)  # what fails stands first
    named = {(run.scenario, run.controller) for run in missing}
    ended = [
        run
        for run in result.runs
        if run.outcome != COMPLETED and (run.scenario, run.controller) not in named
    ]
    if ended:
        cases, of = (len({(x.scenario, x.controller) for x in y}) for y in (ended, result.runs))
        said.append(
            f"{cases} of {of} cases did not complete: {ended[0].scenario} with "
            f"{ended[0].controller} {ended[0].outcome}, {ended[0].simulator}"
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


def _replay(result: Result, scenario: Scenario) -> Replay:
    deployed = [x for x in result.runs if (x.scenario, x.simulator) == (scenario.name, DEPLOYED)]
    endings = {run.controller: run.outcome for run in deployed}
    moving = {name: result.curves[f"{scenario.name}/{name}"] for name in endings}
    return replay(f"report-runs-{_number(result, scenario)}", scenario, moving, endings)


def _number(result: Result, scenario: Scenario) -> int:
    return [one.name for one in result.scenarios].index(scenario.name) + 1


def _claims(result: Result) -> Section:
    rows = []
    for one in result.claims:
        verdict = Cell(_holds(one), GROUPS[kind(one.verdict)][0])
        numbers = (_counted(one, one.paper, 4), _counted(one, one.here, 3))
        rows.append((one.id, one.claim, *numbers, verdict))
    ledger = Matrix(
        caption="Here, C2 and C8: when the last state is within 2 % of its peak; C3 to C6: how "
        "much adaptive gains lower the objective; C9: the schedules won; C10: the excess over our "
        "optimum. make claims computes C9 to C12, and the readings behind C3 to C6",
        columns=("Claim", "The paper says", "Paper", "Here", "Verdict"),
        rows=rows,
    )
    figure = Figure(
        name="report-claims",
        title="The paper's claims",
        caption="The paper's number (open) and the one found here (filled), of the claims "
        "in percent; the bar is the 95 % interval of C9. C3 to C6 are the improvements of "
        "the paper's Table 3.",
        draw=partial(_draw_claims, result),
    )
    why = "What is compared, and why the verdict"
    reasons = Matrix(
        caption=why,
        columns=("Claim", "Compared", "Why the verdict"),
        rows=[(one.id, one.figure, f"{one.verdict}: {one.why}") for one in result.claims],
        folded=why,
    )
    return Section("The paper's claims", "claims", [ledger, figure, reasons])


def _holds(claim: Claim) -> str:
    """Return whether a claim holds, as the headline counts it."""
    word = GROUPS[kind(claim.verdict)][1]
    return "holds" if word == "hold" else word


def _draw_claims(result: Result) -> Any:
    """Draw the two numbers of each claim that is counted in percent, C9 with its interval."""
    from afl_mujoco.report.figures import BLUE, GREY, ORANGE, VERMILION, Dot, dots

    colours = {"good": BLUE, "neutral": ORANGE, "bad": VERMILION, "open": GREY}
    rows: dict[str, list[Dot]] = {}
    shades = {}
    for one in result.claims:
        if one.figure.endswith(PERCENT):
            paper, here = ([] if x is None else [x] for x in (one.paper, one.here))
            ends = (min(paper + here), max(paper + here)) if paper and here else None
            found = result.random_schedules.get("published") if one.id == "C9" else None
            low, high = (100.0 * end for end in found.interval) if found else (0.0, 0.0)
            status = GROUPS[kind(one.verdict)][0]
            name = f"{one.id} {_holds(one)}: paper {fixed(one.paper, 1)} %"
            name += f", here {fixed(one.here, 1)} %"
            shades[name] = colours[status]
            rows[name] = [
                *(Dot(at=x, hollow=True) for x in paper),
                *(Dot(at=x, thin=ends, thick=(low, high) if found else None) for x in here),
            ]
    return dots(rows, "the claim's quantity [%]", line=0.0, colour_of=shades, spread=0.0)


def _counted(claim: Claim, value: float | None, digits: int) -> str:
    unit = re.search(r"\[([^]]*)\]$", claim.figure)
    return f"{short(value, digits)} {unit[1]}" if unit and value is not None else short(value)


def _checks(result: Result) -> Section:
    """Return each criterion at its worst, and every judged value."""
    found = {id: [check for check in result.checks if check.id == id] for id in CRITERIA}
    worst = [max(alike, key=lambda check: check.rank) for alike in found.values() if alike]
    rows = []
    for one in worst:
        quantity = one.quantity + (f" [{one.unit}]" if one.unit in ("J", "N s") else "")
        value = Cell(_value(one.value), "good" if one.passed else "bad")
        fits = f"{short(one.limit / one.value, 2)}×" if one.value and one.limit else MISSING
        rows.append((one.id, quantity, value, limit(one.limit), fits))
    judged = Matrix(
        caption="Each criterion at its worst, states in m, rad, m/s, rad/s",
        columns=("Check", "What is compared", "Worst", "Limit", "Margin"),
        rows=rows,
    )
    known = [(one, CRITERIA[one.id]) for one in worst]
    criteria = Matrix(
        caption="The criteria",
        columns=("Check", "Why this limit", "Proves", "Leaves open"),
        rows=[(one.id, one.reason, its.proves, its.leaves_open) for one, its in known],
        folded="Why these limits, and what each check proves and leaves open",
    )
    return Section("Checks", "checks", [judged, criteria])


def _value(value: float | None) -> str:
    if value is None:
        return "none"
    return short(value, 2) if value == 0.0 or 1e-2 <= abs(value) < 1e3 else scientific(value)


def _budget(result: Result) -> Section:
    budgets = result.error_budgets
    worst = max(budgets, key=lambda budget: abs(budget.at_worst.total))
    at, parts = worst.at_worst, {**SOURCES, "residual": "not explained", "total": "total"}
    rows = [
        (words, scientific(getattr(at, x)), scientific(max(getattr(one, x) for one in budgets)))
        for x, words in parts.items()
    ]
    table = Matrix(
        caption=f"{worst.scenario}, {worst.controller}: as deployed minus the equations, "
        f"{symbol(at.state)} [{at.unit}] at {short(at.time)} s",
        columns=("Source", "There", "Largest in any run"),
        rows=rows,
    )
    return Section("Error budget", "budget", [table])


def _omissions(result: Result) -> Section:
    table = Matrix(
        caption="Largest change of any state (SI)",
        columns=("Scenario", "Controller", "Terms in l′", "Momenta kept at steps"),
        rows=[
            (one.scenario, one.controller, short(one.stretching_rod, 3), short(one.momenta_kept, 3))
            for one in result.omissions
        ],
    )
    title = "What the paper’s frozen parameters leave out"
    return Section(title, "omissions", [table], folded=True)


def _growths(result: Result) -> Section:
    grown = ("Scenario", "Controller", "Exact mode minus ODE", "Growth of a change at the start")
    table = Matrix(
        caption="Shown, not judged: an unstable plant amplifies round-off; B1r restarts",
        columns=grown,
        rows=[
            (one.scenario, one.controller, _value(one.difference), _value(one.amplification))
            for one in result.growths
        ],
    )
    return Section("Differences over whole runs", "growth", [table], folded=True)


def _scenario(result: Result, scenario: Scenario, moves: bool) -> Section:
    """Return what happens in one scenario, and its runs unless they are shown already."""
    blocks: list[Block] = [as_file(scenario), *[_replay(result, scenario)] * moves]
    return Section(scenario.name, f"scenario-{_number(result, scenario)}", blocks, folded=True)
