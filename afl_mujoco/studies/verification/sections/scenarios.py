"""The scenarios: what happens in each, how it ends, what it costs, and its curves."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from types import MappingProxyType

from afl_mujoco.report.numbers import MISSING, fixed, short
from afl_mujoco.report.old import (
    Block,
    Cell,
    Chart,
    Column,
    Fact,
    Facts,
    Figure,
    Section,
    Table,
    Text,
    good_or_bad,
)
from afl_mujoco.scenario.catalogue import is_published
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.words import describe
from afl_mujoco.simulation.metrics import LABELS, Metrics, unit_of
from afl_mujoco.simulation.trajectory import COMPLETED
from afl_mujoco.studies.cases import DEPLOYED, Run
from afl_mujoco.studies.verification.chart_data import QUANTITIES, chart_data
from afl_mujoco.studies.verification.claims.performance import ADAPTIVE, FIXED
from afl_mujoco.studies.verification.figures.responses import impulse_figure, response_figure
from afl_mujoco.studies.verification.figures.schedules import schedules_figure
from afl_mujoco.studies.verification.result import Result
from afl_mujoco.studies.verification.sections.checks import judged_cell
from afl_mujoco.studies.verification.sections.decisions import rests_on

CASES: Mapping[str, str] = MappingProxyType(
    {
        "step-step": "Analogue of the paper's Fig. 7: M and l change by steps.",
        "step-trapezoid": "Analogue of the paper's Fig. 8: M changes by steps, l by trapezoids.",
        "trapezoid-step": "Analogue of the paper's Fig. 9: M changes by trapezoids, l by steps.",
        "trapezoid-trapezoid": "Analogue of the paper's Fig. 10: M and l change by trapezoids.",
    }
)
"""The paper's four cases and its figures that show them."""

DISTURBED = "-impulse"
"""Ending of the name of a disturbed case."""

MAIN = (
    "objective", "iae_z", "iae_phi", "max_force", "settling_2pc_z", "settling_2pc_phi",
    "overshoot_z", "overshoot_phi", "peak_z_dot", "peak_phi_dot", "force_squared",
)  # fmt: skip
"""Metrics in the scenario's own table; the table of all metrics has the others."""

HEADLINE = ("B1", "B2", "B3", "B5")
"""The checks that the overview gives for each case."""


def scenarios_section(result: Result) -> Section:
    """Return every scenario."""
    known = [s for s in result.scenarios if is_published(s)]
    cases = [s for s in known if s.name in CASES]
    disturbed = [s for s in known if s.name.removesuffix(DISTURBED) in CASES and s not in cases]
    blocks: list[Block] = [
        Text(
            "Every scenario is run with each controller in four simulators: the ideal equations, "
            "and MuJoCo in three modes. MuJoCo's step is "
            f"{short(1e3 * result.settings.timestep)} ms; as deployed, the force is held for "
            f"{short(1e3 * result.settings.control_period)} ms."
        ),
        rests_on(result, "scenarios"),
        _overview(result),
    ]
    hold = result.settings.control_period
    if cases:
        blocks.append(schedules_figure(cases))
    if disturbed:
        blocks.append(impulse_figure([result.curves_of(s.name) for s in disturbed], hold))
    parts = [_section(result, k, one) for k, one in enumerate(result.scenarios, start=1)]
    return Section("Scenarios", "scenarios", (*blocks, *parts))


def scenario_anchor(result: Result, name: str) -> str:
    """Return the anchor of a scenario."""
    return f"scenario-{[s.name for s in result.scenarios].index(name) + 1}"


def _overview(result: Result) -> Table:
    """Return every case in a line: how it ended, and the checks."""
    checks = {(c.scenario, c.controller, c.id): c for c in result.checks}
    rows: list[tuple[Cell | str, ...]] = []
    for run in result.decisive_runs:
        found = (checks.get((run.scenario, run.controller, id)) for id in HEADLINE)
        rows.append(
            (
                Cell(run.scenario, link=scenario_anchor(result, run.scenario)),
                run.controller,
                _outcome(run.outcome),
                _outcome(result.outcome_of(run, DEPLOYED)),
                fixed(run.metrics["objective"], 4),
                *map(judged_cell, found),
            )
        )
    return Table(
        caption="Every scenario and controller; OF is the paper's objective, in units of the fixed "
        "gains on its nominal plant (D4); B1 to B5 are the checks of that name, – means not judged",
        columns=(
            Column("Scenario"),
            Column("Controller"),
            Column("Outcome"),
            Column("As deployed"),
            Column("OF", number=True),
            *(Column(id, number=True) for id in HEADLINE),
        ),
        rows=rows,
    )


def _outcome(outcome: str) -> Cell:
    """Return how a run ended; one that did not complete is marked."""
    return Cell(outcome, status="" if outcome == COMPLETED else "bad")


def _section(result: Result, number: int, scenario: Scenario) -> Section:
    """Return one scenario."""
    runs = [run for run in result.runs if run.scenario == scenario.name]
    decisive = [run for run in result.decisive_runs if run.scenario == scenario.name]
    figures = {run.controller: run.metrics for run in decisive}
    # A run that fell must not look better for what it did not do.
    completed = {run.controller: run.metrics for run in decisive if run.outcome == COMPLETED}
    curves = result.curves_of(scenario.name)
    change, _ = _change("objective", completed)
    blocks: list[Block] = [
        Facts([Fact(label, text) for label, text in describe(scenario)]),
        Chart(
            anchor=f"scenario-{number}",
            title="Trajectories",
            quantities=QUANTITIES,
            data=chart_data(curves, scenario),
        ),
        *_response(result, scenario, number),
        _merit(scenario, figures, completed),
        _details(scenario, runs),
    ]
    aside = f"OF {change} by adaptive gains" if change not in ("", MISSING) else ""
    return Section(scenario.name, f"scenario-{number}", blocks, folded=True, aside=aside)


def _response(result: Result, scenario: Scenario, number: int) -> list[Figure]:
    """Return states and force over time, for the paper's four cases and for own scenarios."""
    curves, hold = result.curves_of(scenario.name), result.settings.control_period
    if not is_published(scenario):
        plain = re.sub(r"[^A-Za-z0-9]+", "-", scenario.name)[:60]
        name = f"report-response-{number}-{plain}".strip("-")
        return [response_figure(name, "", curves, hold)]
    if scenario.name not in CASES:
        return []
    name = f"report-response-{scenario.name}"
    return [response_figure(name, CASES[scenario.name], curves, hold)]


def _merit(
    scenario: Scenario, figures: Mapping[str, Metrics], completed: Mapping[str, Metrics]
) -> Table:
    """Return the main metrics of every controller side by side, and how completed runs compare."""
    compared = FIXED in completed and ADAPTIVE in completed
    columns = [Column("Metric"), Column("Unit"), *(Column(c, number=True) for c in figures)]
    if compared:
        columns.append(Column("fixed to adaptive"))
    rows: list[list[Cell | str]] = []
    for key in MAIN:
        values = [figures[name][key] for name in figures]
        told = [fixed(x, 4) if key == "objective" else short(x) for x in values]
        row: list[Cell | str] = [LABELS.get(key, key), unit_of(key), *told]
        if compared:
            change, better = _change(key, completed)
            row.append(Cell(change, status="" if better is None else good_or_bad(better)))
        rows.append(row)
    return Table(
        caption=f"{scenario.name}: in MuJoCo, continuous mode; lower is better in every row",
        columns=columns,
        rows=rows,
    )


def _details(scenario: Scenario, runs: Sequence[Run]) -> Table:
    """Return every metric in every simulator."""
    return Table(
        summary="All metrics in every simulator",
        caption=f"{scenario.name}: all metrics",
        columns=(
            Column("Metric"),
            Column("Unit"),
            *(Column(f"{run.controller}, {run.simulator}", number=True) for run in runs),
        ),
        rows=[
            (
                LABELS.get(key, key),
                unit_of(key),
                *(short(run.metrics.get(key), 6) for run in runs),
            )
            for key in runs[0].metrics
        ],
    )


def _change(key: str, figures: Mapping[str, Metrics]) -> tuple[str, bool | None]:
    """Return the change from fixed to adaptive gains as text, and whether it is a decrease."""
    if not (FIXED in figures and ADAPTIVE in figures):
        return "", None
    one, other = figures[FIXED][key], figures[ADAPTIVE][key]
    if not one or other is None:
        return MISSING, None
    percent = 100.0 * (other / one - 1.0)
    better = None if math.isclose(one, other, rel_tol=5e-4) else other < one
    return f"{'+' if percent > 0.0 else ''}{fixed(percent, 1)} %", better
