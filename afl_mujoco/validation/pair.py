"""One scenario with one controller: run in every simulator, judged and explained."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from afl_mujoco.control.controller import Controller
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.trajectory import Trajectory
from afl_mujoco.validation.check import Check
from afl_mujoco.validation.checks.closed_loop_checks import (
    Settings,
    closed_loop_checks,
    closed_loop_runs,
)
from afl_mujoco.validation.checks.error_budget import budget_curves
from afl_mujoco.validation.checks.explanation import Explanation, explain
from afl_mujoco.validation.curves import Curves, select_curves
from afl_mujoco.validation.metrics import Metrics, metrics

REPORTED = ("ode", "mujoco exact", "mujoco continuous", "mujoco sampled")
"""Simulators whose metrics the report gives; the others are references of checks."""

Pair = tuple[Scenario, Controller, Settings]


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """One simulated run of the report.

    Attributes
    ----------
    scenario, controller, simulator
        What was simulated, in what.
    outcome
        How it ended.
    metrics
        Its figures.
    """

    scenario: str
    controller: str
    simulator: str
    outcome: str
    metrics: Metrics

    def to_dict(self) -> dict[str, Any]:
        """Return the run as plain data."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class Judged:
    """What a worker finds about one pair.

    Attributes
    ----------
    checks, runs, explanation, curves
        As of `Report`.
    """

    checks: tuple[Check, ...]
    runs: tuple[Run, ...]
    explanation: Explanation
    curves: Curves


def pair_name(pair: Pair) -> str:
    """Return what a progress bar calls a pair."""
    return f"{pair[0].name} / {pair[1].name}"


def judge(pair: Pair) -> Judged:
    """Run and judge one scenario with one controller."""
    scenario, controller, settings = pair
    runs = closed_loop_runs(scenario, controller, settings)
    parts = budget_curves(scenario, controller, runs)
    explanation = explain(scenario, controller, runs, parts, full=settings.full)
    return Judged(
        closed_loop_checks(scenario, controller, runs),
        reported_runs(scenario, controller, runs),
        explanation,
        select_curves(
            scenario,
            controller,
            {name: runs[name] for name in REPORTED},
            timestep=settings.timestep,
            parts=parts,
            energy=explanation.ledger.energy if explanation.ledger else {},
        ),
    )


def reported_runs(
    scenario: Scenario, controller: Controller, runs: Mapping[str, Trajectory]
) -> tuple[Run, ...]:
    """Return the runs of `REPORTED` with their metrics, the objective aside."""
    return tuple(
        Run(
            scenario=scenario.name,
            controller=controller.name,
            simulator=name,
            outcome=str(runs[name].outcome),
            metrics=metrics(scenario, controller, runs[name]),
        )
        for name in REPORTED
    )
