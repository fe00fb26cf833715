"""Error budgets, refinement studies and the rest as the page shows them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from afl_mujoco.document import numbers
from afl_mujoco.reporting.page.inputs.report_data import Row
from afl_mujoco.reporting.page.summary import SOURCES

QUANTILES = ("5%", "25%", "median", "75%", "95%")
"""Percentiles of the improvement over random schedules that the page gives."""

STUDIES = {
    "continuous": "continuous mode, over the step",
    "sampled": "sampled mode, over the control period",
    "schedule": "schedule frozen alone, over the step",
}
"""Refinement studies in words."""


def evidence(report: Row) -> dict[str, Any]:
    """Return what the sections behind the scenarios show.

    Parameters
    ----------
    report
        The report.
    """
    return {
        "sources": list(SOURCES.items()),
        "budgets": [_budget(row) for row in report["error_budgets"]],
        "studies": _studies(report["studies"]),
        "ledgers": report["ledgers"],
        "omissions": report["omissions"],
        "comparisons": report["random_schedules"],
        "quantiles": QUANTILES,
        "command": report["command"],
        "settings": report["settings"],
        "versions": report["versions"],
    }


def _budget(row: Row) -> Row:
    """Return a row of the error budget with its largest source."""
    return {**row, "largest": max(row[name] for name in SOURCES)}


def _studies(rows: Sequence[Row]) -> list[Row]:
    """Return the refinement studies by what they refine, with the range of orders observed."""
    found: list[Row] = []
    for name in dict.fromkeys(row["study"] for row in rows):
        group = [row for row in rows if row["study"] == name]
        orders = [row["order"] for row in group if row["order"] is not None]
        low, high = (numbers.fixed(f(orders, default=None), 3) for f in (min, max))
        found.append(
            {
                "name": STUDIES.get(name, name),
                "expected": group[0]["expected"],
                "observed": low if low == high else f"{low} to {high}",
                "steps": group[0]["steps"],
                "rows": group,
            }
        )
    return found
