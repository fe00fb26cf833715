"""The checks: each criterion at its worst, the reason for its limit, every value behind it."""

from __future__ import annotations

import math
from collections.abc import Sequence

from afl_mujoco.report.numbers import limit, listed, scientific, sentence, short
from afl_mujoco.report.old import (
    Bar,
    Block,
    Cell,
    Column,
    Finding,
    Section,
    Table,
    Text,
    good_or_bad,
)
from afl_mujoco.studies.verification.check import Check
from afl_mujoco.studies.verification.criteria import CRITERIA
from afl_mujoco.studies.verification.figures.errors import errors_figure
from afl_mujoco.studies.verification.result import Result
from afl_mujoco.studies.verification.sections.decisions import rests_on

ANY = "any"

DECADES, BEYOND = 8.0, 1.0
"""Length of a bar below the limit, and beyond it [decades]."""


def checks_section(result: Result) -> Section:
    """Return whether the two codes agree."""
    worst = worst_checks(result.checks)
    failed = len(result.failed_checks)
    blocks: list[Block] = [
        Finding("Agreement", _agreement(result)),
        Text(
            "Each row is one criterion at its worst: the value measured, the limit, and how far "
            "apart they are. A bar on the page spans from eight decades below the limit to one "
            "above it; its mark is the limit.",
            note=True,
        ),
        rests_on(result, "checks"),
        Text(
            "Both sides have the same schedules, gains and assumed parameters, so the other "
            "decisions affect both alike and no verdict here depends on them.",
            note=True,
        ),
    ]
    if failed:
        blocks.append(_failures(result.failed_checks))
    blocks += [
        Table(
            caption=f"{len(result.checks)} checks of {len(worst)} criteria, "
            f"{failed or 'none'} failing",
            columns=(
                Column("Check"),
                Column("What is compared"),
                Column("Worst", number=True),
                Column("Limit", number=True),
                Column("Margin"),
                Column("Verdict"),
            ),
            rows=[_row(check) for check in worst],
            stacked=True,
        ),
        _reasons(worst),
        _every_figure(result),
        errors_figure(list(result.curves.values())),
    ]
    return Section("Checks", "checks", blocks)


def worst_checks(checks: Sequence[Check]) -> list[Check]:
    """Return for each criterion, in their order, the check closest to its limit or beyond it."""
    found = {id: [check for check in checks if check.id == id] for id in CRITERIA}
    return [max(alike, key=_rank) for alike in found.values() if alike]


def check_link(result: Result, id: str) -> str:
    """Return a link to a check, if the run has it."""
    there = any(check.id == id for check in result.checks)
    return f"[{id}](#check-{id})" if there else id


def figure(value: float | None) -> str:
    """Return a judged value as text."""
    if value is None:
        return "none"
    return short(value, 2) if value == 0.0 or 1e-2 <= abs(value) < 1e3 else scientific(value)


def _rank(check: Check) -> float:
    """Return the rank of a check: its value, infinite if there is none."""
    return math.inf if check.value is None else check.value


def _row(check: Check) -> tuple[Cell | str, ...]:
    """Return a criterion at its worst."""
    status = good_or_bad(check.passed)
    drawn, words = margin(check)
    unit = check.unit if check.unit != "1" else ""
    place = "" if check.scenario == ANY else f"worst in {check.scenario} / {check.controller}"
    return (
        Cell(check.id, anchor=f"check-{check.id}"),
        Cell(check.quantity, note=place),
        Cell(figure(check.value), note=unit),
        f"≤ {limit(check.limit)}",
        Cell(words, bar=drawn, status=status),
        Cell("holds" if check.passed else "FAILS", status=status),
    )


def margin(check: Check) -> tuple[Bar, str]:
    """Return how far a value is from its limit, on a logarithmic scale and in words."""
    value, most, whole = check.value, check.limit, DECADES + BEYOND
    mark = DECADES / whole
    if value is None:
        return Bar(0.0, 1.0, mark), "no finite value"
    if value <= 0.0:
        return Bar(0.0, 0.0, mark), "exactly 0" if most else "0, as it must be"
    if most <= 0.0:
        return Bar(0.0, 1.0, mark), "must be 0"
    decades = math.log10(most / value)
    ratio = short(10.0 ** abs(decades), 2)
    text = f"{ratio} times {'below' if check.passed else 'above'}"
    if ratio == "1":
        text = "at the limit" if check.passed else "just above"
    return Bar(0.0, min(1.0, max(0.0, (DECADES - decades) / whole)), mark), text


def _failures(failed: Sequence[Check]) -> Table:
    """Return every check that does not hold."""
    return Table(
        caption="What fails",
        columns=(
            Column("Check"),
            Column("Scenario"),
            Column("Controller"),
            Column("What is compared"),
            Column("Value", number=True),
            Column("Limit", number=True),
        ),
        rows=[
            (
                Cell(check.id, link=f"check-{check.id}"),
                check.scenario,
                check.controller,
                check.quantity,
                Cell(f"{figure(check.value)}{_unit(check)}", status="bad"),
                f"≤ {limit(check.limit)}{_unit(check)}",
            )
            for check in failed
        ],
    )


def _unit(check: Check) -> str:
    """Return the unit of a check behind a number; nothing for a pure number."""
    return "" if check.unit == "1" else f" {check.unit}"


def _reasons(worst: Sequence[Check]) -> Table:
    """Return the reasons for the limits, and what the checks show."""
    known = [CRITERIA[check.id] for check in worst]
    return Table(
        summary="Why these limits, and what each check proves and leaves open",
        caption="The criteria",
        columns=(
            Column("Check"),
            Column("Why this limit"),
            Column("Proves"),
            Column("Leaves open"),
        ),
        rows=[
            (c.id, *(sentence(text) for text in (c.reason, c.proves, c.leaves_open))) for c in known
        ],
        stacked=True,
    )


def _every_figure(result: Result) -> Table:
    """Return every value that was judged, by scenario and controller."""
    judged = [check for check in result.checks if check.scenario != ANY]
    ids = list(dict.fromkeys(check.id for check in judged))
    found = {(check.scenario, check.controller, check.id): check for check in judged}
    places = dict.fromkeys((check.scenario, check.controller) for check in judged)
    return Table(
        summary=f"All {len(judged)} values by scenario and controller",
        caption="Every judged value, in the unit of its check; – means not judged",
        columns=(
            Column("Scenario"),
            Column("Controller"),
            *(Column(f"{id} ≤ {limit(CRITERIA[id].limit)}", number=True) for id in ids),
        ),
        rows=[(*place, *(judged_cell(found.get((*place, id))) for id in ids)) for place in places],
    )


def judged_cell(check: Check | None) -> Cell:
    """Return a judged value; one that fails is marked."""
    if check is None:
        return Cell("–")
    return Cell(figure(check.value), status="" if check.passed else "bad")


def _agreement(result: Result) -> str:
    """Say whether the two sides are one model."""
    exact = [check for check in result.checks if check.id == "B1"]
    others = (check.id for check in result.failed_checks if check.id != "B1")
    failed = list(dict.fromkeys(others))
    more = f"; yet {listed(failed, 'and')} fail{'s' * (len(failed) == 1)}" if failed else ""
    if not exact:
        return f"No run here compares MuJoCo with the equations under one integrator{more}."
    worst = max(exact, key=_rank)
    most = limit(worst.limit)
    where = f"{worst.scenario} with {worst.controller}"
    if worst.value is None:
        return f"In {where} MuJoCo and the paper's equations do not end the same way{more}."
    found = scientific(worst.value)
    if not worst.passed:
        return (
            f"Under one integrator MuJoCo and the paper's equations differ by {found} in {where}, "
            f"beyond the limit of {most}: they are not the same model{more}."
        )
    runs = f"{len(exact)} run{'s' * (len(exact) != 1)}"
    return (
        f"Under one integrator MuJoCo and the paper's equations differ by at most {found} in any "
        f"state at any instant of {runs} (limit {most}): one model, up to round-off{more}."
    )
