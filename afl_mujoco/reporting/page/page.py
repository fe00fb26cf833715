"""The report as one HTML page: a pure function of what was found, the same bytes each time."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from jinja2 import Environment, PackageLoader

from afl_mujoco.document import html, numbers
from afl_mujoco.document.blocks import Finding, Section
from afl_mujoco.document.pictures import Picture
from afl_mujoco.reporting.page.chart_data import chart_data
from afl_mujoco.reporting.page.checks import criterion_rows, tiers, verdict_of
from afl_mujoco.reporting.page.decisions import (
    claim_rows,
    decision_list,
    section_decisions,
    tally,
)
from afl_mujoco.reporting.page.evidence import QUANTILES, evidence_sections
from afl_mujoco.reporting.page.inputs.films import Film
from afl_mujoco.reporting.page.inputs.report_data import Row
from afl_mujoco.reporting.page.scenarios import HEADLINE, scenario_sections
from afl_mujoco.reporting.page.summary import five_sentences
from afl_mujoco.simulation.metrics import UNITS
from afl_mujoco.studies.verification.curves import Curves

Item = TypeVar("Item")
Key = TypeVar("Key", bound=Hashable)

PACKAGE = "afl_mujoco.reporting.page"


def render_page(
    report: Row,
    curves: Sequence[Curves],
    pictures: Sequence[Picture],
    films: Sequence[Film],
    *,
    sections: Sequence[Section] = (),
    results: Path = Path(),
    files: Sequence[str] = (),
) -> str:
    """Return the page.

    Parameters
    ----------
    sections, results
        What the studies of robustness say, and the folder of their figures.
    """
    claims = claim_rows(report["claims"], report["decisions"])
    figures = _grouped(pictures, lambda picture: picture.place)
    return (
        _environment()
        .get_template("page.html.j2")
        .render(
            **html.frame(),
            sections=section_decisions(report["decisions"]),
            texts=report["decisions"],
            figures=figures,
            sentences=five_sentences(report),
            files=files,
            claims=claims,
            tally=tally(claims),
            decisions=decision_list(report["decisions"], claims),
            **_checks(report),
            **_scenarios(report, curves, films),
            comparisons=report["random_schedules"],
            quantiles=QUANTILES,
            command=report["command"],
            settings=report["settings"],
            versions=report["versions"],
            evidence=html.write_sections(evidence_sections(report, figures), results),
            **_robustness(sections, results),
        )
        + "\n"
    )


def _robustness(sections: Sequence[Section], results: Path) -> dict[str, Any]:
    """Return the part of the studies, and the findings that the page repeats at its top."""
    return {
        "robustness": sections,
        "robustness_part": html.write_sections(sections, results, level=3),
        "findings": [
            (finding, section.anchor)
            for section in sections
            for finding in section.walk()
            if isinstance(finding, Finding)
        ],
    }


def _checks(report: Row) -> dict[str, Any]:
    """Return what the verdict and the checks show."""
    criteria = criterion_rows(report["checks"])
    return {
        "verdict": verdict_of(report["checks"]),
        "failures": [row for row in criteria if not row.passed],
        "criteria": criteria,
        "judged": {row.id for row in criteria},
        "tiers": tiers(criteria),
    }


def _scenarios(report: Row, curves: Sequence[Curves], films: Sequence[Film]) -> dict[str, Any]:
    """Return what the scenarios show."""
    drawn = _grouped(curves, lambda one: one.scenario)
    scenarios = scenario_sections(report, drawn, UNITS)
    names = {scenario.name for scenario in scenarios}
    return {
        "headline": HEADLINE,
        "scenarios": scenarios,
        "charts": {
            s.anchor: {"anchor": s.anchor, "data": chart_data(drawn[s.name])}
            for s in scenarios
            if s.name in drawn
        },
        "films": _grouped(
            sorted((f for f in films if f.scenario in names), key=lambda film: not film.wide),
            lambda film: film.scenario,
        ),
        "showcase": [film for film in films if film.scenario is None],
        "no_films": not films,
    }


@cache
def _environment() -> Environment:
    """Return the templates, which escape whatever they are given."""
    environment = html.environment(PackageLoader(PACKAGE))
    environment.filters.update(
        setting=_setting,
    )
    return environment


def _setting(value: object) -> str:
    """Return a setting of a campaign in words: a switch, or a stretch of time."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{numbers.short(value)} s" if isinstance(value, int | float) else str(value)


def _grouped(items: Iterable[Item], key: Callable[[Item], Key]) -> dict[Key, list[Item]]:
    """Return items by a key, in their order."""
    groups: dict[Key, list[Item]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups
