"""A campaign's report as JSON, Markdown, JUnit XML and a table on the terminal."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from afl_mujoco.files import write_text
from afl_mujoco.simulation.metrics import UNITS, Metrics
from afl_mujoco.studies.verification.check import Check
from afl_mujoco.studies.verification.criteria import CRITERIA
from afl_mujoco.studies.verification.decisions import DECISIONS

if TYPE_CHECKING:
    from afl_mujoco.studies.verification.campaign import Report

ANY = "any"
REFERENCE = "ode"
WIDE = 110
"""Width of a terminal that shows every column; a narrower one shows `NARROW`."""

NARROW = ("scenario", "controller", "B1", "B3", "B5")

HEADLINE = ("B1", "B2", "B2b", "B3", "B5")
"""The checks that have a column of their own; the others have a row for their worst value."""


def write_report(report: Report, folder: Path) -> tuple[Path, ...]:
    """Write report.json, report.md and junit.xml, each whole or not at all."""
    texts = {
        "report.json": json.dumps(report.to_dict(), indent=1, allow_nan=False) + "\n",
        "report.md": markdown(report),
        "junit.xml": junit(report),
    }
    for name, text in texts.items():
        write_text(folder / name, text)
    return tuple(folder / name for name in texts)


def verdict_line(report: Report) -> str:
    """Return the verdict in one line."""
    total, failed = len(report.checks), len(report.failed_checks)
    return (
        f"PASS: all {total} checks hold" if report.passed else f"FAIL: {failed} of {total} checks"
    )


def markdown(report: Report) -> str:
    """Return the report as Markdown."""
    from afl_mujoco.document.markdown import to_markdown
    from afl_mujoco.reporting.page.evidence import evidence_sections

    header, rows = _grid(report)
    lines = ["# MuJoCo against the analytic model", "", f"**{verdict_line(report)}**", ""]
    lines += ["| " + " | ".join(header) + " |", "|" + " --- |" * len(header)]
    lines += ["| " + " | ".join(row) + " |" for row in rows]
    lines += ["", "## Checks", "", "| check | quantity | unit | limit | worst here | reason |"]
    lines += ["|" + " --- |" * 6]
    for id, worst in _worst(report).items():
        c = CRITERIA[id]
        quantity = c.quantity.replace("|", "\\|")
        lines.append(
            f"| {id} | {quantity} | {c.unit} | {c.limit:g} | {_value(worst)} | {c.reason} |"
        )
    if report.ledger.claims:
        lines += ["", "## Claims of the paper", "", *_markdown_table(_claims(report))]
    lines += ["", to_markdown(evidence_sections(report.to_dict(), {}), level=2).rstrip()]
    lines += ["", "## Decisions these results rest on", ""]
    lines += [f"- **{id}** {text}" for id, text in DECISIONS.items()]
    return "\n".join(lines) + "\n"


def junit(report: Report) -> str:
    """Return the checks as JUnit XML, one test case each."""
    suite = ElementTree.Element(
        "testsuite",
        name="afl-mujoco validate",
        tests=str(len(report.checks)),
        failures=str(len(report.failed_checks)),
    )
    for check in report.checks:
        place = f"{check.scenario}/{check.controller}"
        case = ElementTree.SubElement(suite, "testcase", classname=check.id, name=place)
        if not check.passed:
            ElementTree.SubElement(case, "failure", message=_sentence(check))
    ElementTree.indent(suite)
    return ElementTree.tostring(suite, encoding="unicode", xml_declaration=True) + "\n"


def print_report(report: Report, console: Console) -> None:
    """Print the table, the failures and, last, the verdict."""
    header, rows = _grid(report)
    table = Table(title="MuJoCo against the analytic model", box=SIMPLE_HEAD, padding=(0, 1))
    kept = [
        index
        for index, title in enumerate(header)
        if console.width >= WIDE or title.split()[0] in NARROW
    ]
    for index in kept:
        title = header[index].replace(" <= ", "\n<= ")
        table.add_column(title, justify="left" if index < 3 else "right", no_wrap=True)
    for row in rows:
        table.add_row(*(row[index] for index in kept))
    console.print(table)
    for id, worst in _worst(report).items():
        c = CRITERIA[id]
        mark = "[green]ok  [/]" if worst.passed else "[red]FAIL[/]"
        console.print(
            f"{mark} {id:<3} {_value(worst):>8} <= {c.limit:<6g} {c.quantity}", highlight=False
        )
    for check in report.failed_checks:
        console.print(f"[red]FAIL[/] {_sentence(check)}", highlight=False, soft_wrap=True)
    for claim in report.ledger.claims:
        numbers = f"paper {_cell(claim.paper)}, here {_cell(claim.here)}"
        console.print(
            f"{claim.id:<4} {claim.verdict:<19} {numbers}: {claim.claim}", highlight=False
        )
    colour = "bold green" if report.passed else "bold red"
    console.print(f"[{colour}]{verdict_line(report)}[/]", highlight=False)


def _grid(report: Report) -> tuple[list[str], list[list[str]]]:
    """Return header and rows of the table by scenario and controller."""
    judged = {c.id for c in report.checks if c.scenario != ANY}
    ids = [id for id in HEADLINE if id in judged]
    found = {(c.scenario, c.controller, c.id): c for c in report.checks}
    rows = []
    for run in report.runs:
        if run.simulator != REFERENCE:
            continue
        objective = run.metrics["objective"]
        checks = [found.get((run.scenario, run.controller, id)) for id in ids]
        rows.append(
            [
                run.scenario,
                run.controller,
                run.outcome,
                "-" if objective is None else f"{objective:.4f}",
                *("-" if c is None else _value(c) + " FAIL" * (not c.passed) for c in checks),
            ]
        )
    limits = [f"{id} <= {CRITERIA[id].limit:g}" for id in ids]
    return ["scenario", "controller", "outcome", "OF", *limits], rows


def _markdown_table(rows: list[dict[str, Any]]) -> list[str]:
    """Return a Markdown table, a column for each key."""
    cells = [[_cell(value) for value in row.values()] for row in rows]
    header = [key.replace("_", " ") for key in rows[0]]
    rule = ["---"] * len(header)
    return ["| " + " | ".join(line) + " |" for line in (header, rule, *cells)]


def _cell(value: str | float | None) -> str:
    """Return a value as a cell of a Markdown table."""
    if value is None:
        return "-"
    return value.replace("|", "\\|") if isinstance(value, str) else f"{value:.3g}"


def _claims(report: Report) -> list[dict[str, Any]]:
    """Return the claims ledger as a table."""
    columns = ("id", "claim", "verdict", "figure", "paper", "here", "why")
    return [{name: getattr(claim, name) for name in columns} for claim in report.ledger.claims]


def _worst(report: Report) -> dict[str, Check]:
    """Return the check of each criterion that comes closest to its limit or beyond it."""
    worst: dict[str, Check] = {}
    for check in report.checks:
        held = worst.get(check.id)
        if held is None or _rank(check) > _rank(held):
            worst[check.id] = check
    return worst


def _rank(check: Check) -> float:
    """Return the value, infinite if there is none."""
    return float("inf") if check.value is None else check.value


def _value(check: Check) -> str:
    """Return the value as a table shows it."""
    return "none" if check.value is None else f"{check.value:.1e}" if check.value else "0"


def _sentence(check: Check) -> str:
    """Say what a check found."""
    return (
        f"{check.id} {check.scenario}/{check.controller}: {check.quantity} is {_value(check)}, "
        f"must be {check.comparison} {check.limit:g} {check.unit}"
    )


def print_metrics(figures: Mapping[str, Metrics], outcomes: Mapping[str, str]) -> None:
    """Print the metrics of runs side by side."""
    table = Table("metric", "unit")
    for simulator in figures:
        table.add_column(simulator, justify="right")
    table.add_row("outcome", "", *(outcomes[simulator] for simulator in figures))
    for name in next(iter(figures.values())):
        values = (run[name] for run in figures.values())
        table.add_row(name, UNITS[name], *("-" if v is None else f"{v:.6g}" for v in values))
    Console().print(table)
