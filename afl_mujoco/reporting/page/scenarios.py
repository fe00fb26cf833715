"""The scenarios as the page shows them: what happens, how it ends, what it costs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from afl_mujoco.document.numbers import MISSING, fixed, short
from afl_mujoco.reporting.page.checks import figure
from afl_mujoco.reporting.page.inputs.report_data import Row
from afl_mujoco.reporting.page.schedule_text import push_text, schedule_text
from afl_mujoco.studies.verification.curves import REFERENCE, Curves

FIXED, ADAPTIVE = "fixed", "adaptive"

DECISIVE = "mujoco continuous"
"""Simulator whose figures the scenario's table gives: the law as published, in MuJoCo."""

SIMULATORS = {
    "ode": "ideal equations",
    "mujoco exact": "MuJoCo, reference integrator",
    "mujoco continuous": "MuJoCo, RK4, law in every stage",
    "mujoco sampled": "MuJoCo as deployed",
}
"""Simulators of the report in words."""

MAIN = (
    "objective", "iae_z", "iae_phi", "max_force", "settling_2pc_z", "settling_2pc_phi",
    "overshoot_z", "overshoot_phi", "peak_z_dot", "peak_phi_dot", "force_squared",
)  # fmt: skip
"""Metrics of the scenario's own table; the others are in the table of all."""

_STATES = {"z": "z", "phi": "φ", "z_dot": "z′", "phi_dot": "φ′"}
_LABELS = {
    "objective": "objective OF",
    "iae_z": "∫|z| dt",
    "iae_phi": "∫|φ| dt",
    "itae_z": "∫t|z| dt",
    "itae_phi": "∫t|φ| dt",
    "max_force": "max |F|",
    "force_squared": "∫F² dt",
    "force_variation": "total variation of F",
    "saturated_share": "share of time saturated",
    "end_time": "end",
    **{f"peak_{x}": f"max |{s}|" for x, s in _STATES.items()},
    **{f"overshoot_{x}": f"overshoot of {s}" for x, s in _STATES.items()},
    **{f"settling_2pc_{x}": f"settling of {s}, 2 %" for x, s in _STATES.items()},
    **{f"settling_5pc_{x}": f"settling of {s}, 5 %" for x, s in _STATES.items()},
}
HEADLINE = ("B1", "B2", "B3", "B5")
"""The checks that a scenario's line in the overview gives."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricRow:
    """A figure of every controller side by side.

    Attributes
    ----------
    label, unit
        What it is.
    values
        As text, one for each column.
    change
        From fixed to adaptive gains [%] as text; empty where there is no such pair.
    better
        Whether that is less; ``None`` where nothing changes or there is nothing to compare.
    """

    label: str
    unit: str
    values: tuple[str, ...]
    change: str = ""
    better: bool | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Overview:
    """A scenario and controller in one line.

    Attributes
    ----------
    controller, outcome, objective
        As text.
    checks
        A value and whether it passes for each of `HEADLINE`, ``None`` where there is none.
    """

    controller: str
    outcome: str
    objective: str
    checks: tuple[tuple[str, bool] | None, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class ScenarioSection:
    """A scenario as the page shows it.

    Attributes
    ----------
    anchor, name
        Its place and its name.
    facts
        What happens in it: a label and a text each.
    controllers
        Columns of `metrics`.
    overview
        A line for each controller.
    metrics
        The main figures.
    columns, details
        Every figure in every simulator.
    improvement
        How much adaptive gains change the objective, as text; empty if that is not known.
    """

    anchor: str
    name: str
    facts: tuple[tuple[str, str], ...]
    controllers: tuple[str, ...]
    overview: tuple[Overview, ...]
    metrics: tuple[MetricRow, ...]
    columns: tuple[tuple[str, str], ...]
    details: tuple[MetricRow, ...]
    improvement: str


def scenario_sections(
    report: Row, curves: Mapping[str, Sequence[Curves]], units: Mapping[str, str]
) -> tuple[ScenarioSection, ...]:
    """Return a section for each scenario of a report, in its order."""
    grouped: dict[str, list[Row]] = {}
    for run in report["runs"]:
        grouped.setdefault(run["scenario"], []).append(run)
    checks = {(c["scenario"], c["controller"], c["id"]): c for c in report["checks"]}
    return tuple(
        _section(f"scenario-{number}", runs, checks, curves.get(name, ()), units)
        for number, (name, runs) in enumerate(grouped.items(), start=1)
    )


def _section(
    anchor: str,
    runs: Sequence[Row],
    checks: Mapping[tuple[str, str, str], Row],
    curves: Sequence[Curves],
    units: Mapping[str, str],
) -> ScenarioSection:
    """Return the section of one scenario."""
    name = runs[0]["scenario"]
    decisive = {run["controller"]: run for run in runs if run["simulator"] == DECISIVE}
    figures = {controller: run["metrics"] for controller, run in decisive.items()}
    names = list(dict.fromkeys(key for run in runs for key in run["metrics"]))
    main = [key for key in MAIN if key in names]
    metrics = tuple(_metric_row(key, figures, units) for key in main)
    return ScenarioSection(
        anchor=anchor,
        name=name,
        facts=_facts(curves),
        controllers=tuple(figures),
        overview=tuple(_overview(run, checks) for run in decisive.values()),
        metrics=metrics,
        columns=tuple((run["controller"], run["simulator"]) for run in runs),
        details=tuple(
            MetricRow(
                label=_LABELS.get(key, key),
                unit=_unit(key, units),
                values=tuple(short(run["metrics"].get(key), 6) for run in runs),
            )
            for key in names
        ),
        improvement=metrics[0].change if main[:1] == ["objective"] else "",
    )


def _overview(run: Row, checks: Mapping[tuple[str, str, str], Row]) -> Overview:
    """Return a run in one line."""
    found = [checks.get((run["scenario"], run["controller"], id)) for id in HEADLINE]
    return Overview(
        controller=run["controller"],
        outcome=run["outcome"],
        objective=fixed(run["metrics"].get("objective"), 4),
        checks=tuple(
            None if check is None else (figure(check["value"]), check["passed"]) for check in found
        ),
    )


def _metric_row(key: str, figures: Mapping[str, Row], units: Mapping[str, str]) -> MetricRow:
    """Return one figure of every controller, and how adaptive gains change it."""
    values = {controller: found.get(key) for controller, found in figures.items()}
    one, other = values.get(FIXED), values.get(ADAPTIVE)
    change, better = "", None
    if FIXED in values and ADAPTIVE in values:
        change = MISSING
        if one and other is not None:
            percent = 100.0 * (other / one - 1.0)
            change = f"{'+' if percent > 0.0 else ''}{fixed(percent, 1)} %"
            better = None if math.isclose(one, other, rel_tol=5e-4) else other < one
    return MetricRow(
        label=_LABELS.get(key, key),
        unit=_unit(key, units),
        values=tuple(fixed(v, 4) if key == "objective" else short(v) for v in values.values()),
        change=change,
        better=better,
    )


def _unit(key: str, units: Mapping[str, str]) -> str:
    """Return the unit of a metric as the page writes it; nothing for a pure number."""
    unit = units.get(key, "").replace("^2", "²")
    return "" if unit == "1" else unit


def _facts(curves: Sequence[Curves]) -> tuple[tuple[str, str], ...]:
    """Say what happens in a scenario."""
    if not curves:
        return ()
    one = curves[0]
    z, phi, z_dot, phi_dot = one.states[REFERENCE][0].tolist()
    start = f"φ = {short(math.degrees(phi))}°"
    if z or z_dot or phi_dot:
        start += f", z = {short(z)} m, z′ = {short(z_dot)} m/s, φ′ = {short(phi_dot)} rad/s"
    else:
        start += ", at rest at z = 0"
    return (
        ("cart mass M", schedule_text(one.time, one.cart_mass, "kg")),
        ("half-length l", schedule_text(one.time, one.half_length, "m")),
        ("push on the cart", push_text(one.time, one.push)),
        ("start", start),
        ("horizon", f"{short(float(one.time[-1]))} s"),
    )
