"""The checks as the page shows them: a row for each criterion, its worst value, what it says."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from afl_mujoco.document.numbers import limit, scientific, short
from afl_mujoco.reporting.page.inputs.report_data import Row
from afl_mujoco.studies.verification.criteria import CRITERIA

ANY = "any"

DECADES = 8.0
"""How far below its limit a value is still told apart on the bar [decades]."""

BEYOND = 1.0
"""How much of the bar lies beyond the limit [decades]."""

TIERS = {"A": "The equations", "B": "The closed loop"}
"""Titles of the tiers, by the first letter of a criterion."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """The verdict as the page shows it.

    Attributes
    ----------
    word, text
        Pass or fail, and how many checks hold.
    kind
        How it is marked.
    total, failed
        How many checks there are, and how many of them do not hold.
    """

    word: str
    text: str
    kind: str
    total: int
    failed: int


@dataclass(frozen=True, slots=True)
class Margin:
    """How far a value is from its limit, on a logarithmic scale.

    Attributes
    ----------
    filled
        Where the value lies on the bar, 0 to 1.
    limit
        Where the limit lies, 0 to 1.
    text
        The same in words.
    """

    filled: float
    limit: float
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """One judged figure of a criterion.

    Attributes
    ----------
    value
        As text.
    passed
        Whether it holds.
    """

    value: str
    passed: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class CriterionRow:
    """One criterion with everything that it judged.

    Attributes
    ----------
    id, quantity, unit, reason
        As in the report.
    proves, leaves_open
        What it shows and what not; empty for a criterion that this version does not know.
    tier
        Title of the tier it belongs to.
    limit, worst
        As text; `worst` is the value that comes closest to the limit or beyond it.
    place
        Where the worst is, empty if the criterion does not depend on it.
    count, failed
        How many figures it judged, and how many of them do not hold.
    margin
        Of the worst.
    controllers
        Columns of the table of all figures.
    rows
        Scenario and a cell for each controller, ``None`` where nothing was judged.
    """

    id: str
    quantity: str
    unit: str
    reason: str
    proves: str
    leaves_open: str
    tier: str
    limit: str
    worst: str
    place: str
    count: int
    failed: int
    margin: Margin
    controllers: tuple[str, ...]
    rows: tuple[tuple[str, tuple[Cell | None, ...]], ...]

    @property
    def passed(self) -> bool:
        """Whether every figure holds."""
        return not self.failed

    @property
    def spread_out(self) -> bool:
        """Whether it judged a figure for each scenario and controller."""
        return bool(self.place)


def criterion_rows(checks: Sequence[Row]) -> tuple[CriterionRow, ...]:
    """Return a row for each criterion, in the order of the checks, those that fail first."""
    grouped: dict[str, list[Row]] = {}
    for check in checks:
        grouped.setdefault(check["id"], []).append(check)
    rows = [_criterion_row(found) for found in grouped.values()]
    order = list(CRITERIA)
    rows.sort(key=lambda row: order.index(row.id) if row.id in order else len(order))
    return tuple(sorted(rows, key=lambda row: row.passed))


def _criterion_row(found: Sequence[Row]) -> CriterionRow:
    """Return the row of one criterion."""
    worst = max(found, key=rank)
    known = CRITERIA.get(worst["id"])
    controllers = tuple(dict.fromkeys(check["controller"] for check in found))
    everywhere = worst["scenario"] == ANY
    return CriterionRow(
        id=worst["id"],
        quantity=worst["quantity"],
        unit=worst["unit"],
        reason=worst["reason"],
        proves=known.proves if known else "",
        leaves_open=known.leaves_open if known and known.leaves_open != "-" else "",
        tier=TIERS.get(worst["id"][:1], "Other"),
        limit=limit(worst["limit"]),
        worst=figure(worst["value"]),
        place="" if everywhere else f"{worst['scenario']} / {worst['controller']}",
        count=len(found),
        failed=sum(not check["passed"] for check in found),
        margin=margin(worst["value"], worst["limit"], worst["passed"]),
        controllers=controllers,
        rows=_rows(found, controllers),
    )


def _rows(
    found: Iterable[Row], controllers: Sequence[str]
) -> tuple[tuple[str, tuple[Cell | None, ...]], ...]:
    """Return every figure of a criterion by scenario and controller."""
    cells: dict[str, dict[str, Cell]] = {}
    for check in found:
        cell = Cell(value=figure(check["value"]), passed=check["passed"])
        cells.setdefault(check["scenario"], {})[check["controller"]] = cell
    return tuple(
        (scenario, tuple(row.get(name) for name in controllers)) for scenario, row in cells.items()
    )


def rank(check: Row) -> float:
    """Return how bad a check of a criterion is: its value, infinite if there is none."""
    value = check["value"]
    return math.inf if value is None else float(value)


def figure(value: float | None) -> str:
    """Return a judged value as text.

    Parameters
    ----------
    value
        The value; ``None`` if it was not finite.
    """
    if value is None:
        return "none"
    return short(value, 2) if value == 0.0 or 1e-2 <= abs(value) < 1e3 else scientific(value)


def margin(value: float | None, most: float, passed: bool) -> Margin:
    """Return how far a value is from its limit."""
    whole = DECADES + BEYOND
    at_limit = DECADES / whole
    if value is None:
        return Margin(1.0, at_limit, "no finite value")
    if value <= 0.0:
        return Margin(0.0, at_limit, "exactly 0" if most else "0, as it must be")
    if most <= 0.0:
        return Margin(1.0, at_limit, "must be 0")
    decades = math.log10(most / value)
    ratio = short(10.0 ** abs(decades), 2)
    text = f"{ratio} times {'below' if passed else 'above'}"
    if ratio == "1":
        text = "at the limit" if passed else "just above"
    return Margin(min(1.0, max(0.0, (DECADES - decades) / whole)), at_limit, text)


def verdict_of(checks: Sequence[Row]) -> Verdict:
    """Return the verdict of the checks."""
    total, failed = len(checks), sum(not check["passed"] for check in checks)
    passed = bool(checks) and not failed
    return Verdict(
        word="PASS" if passed else "FAIL",
        text=f"all {total} checks hold" if passed else f"{failed} of {total} checks fail",
        kind="good" if passed else "bad",
        total=total,
        failed=failed,
    )


def tiers(criteria: Iterable[CriterionRow]) -> list[tuple[str, list[CriterionRow]]]:
    """Return the criteria under their titles, those that fail under one of their own."""
    titled = ((row.tier if row.passed else "Failing", row) for row in criteria)
    return [
        (title, [row for _, row in rows])
        for title, rows in itertools.groupby(titled, key=lambda pair: pair[0])
    ]
