"""The campaign: every scenario x controller x simulator, judged; the same bits from any workers."""

from __future__ import annotations

import math
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version
from typing import Any

import numpy as np

from afl_mujoco.control.controllers import CONTROLLERS
from afl_mujoco.control.law import Law
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.catalogue import SCENARIOS
from afl_mujoco.scenario.sampling import whole_steps
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.ensemble.objective import ObjectiveScales
from afl_mujoco.simulation.ode import simulate_ode
from afl_mujoco.simulation.trajectory import Trajectory, law_along
from afl_mujoco.sweep.executors import open_executor
from afl_mujoco.sweep.sweep import compute_all
from afl_mujoco.validation.check import Check
from afl_mujoco.validation.checks.closed_loop_checks import (
    Settings,
    closed_loop_checks,
    closed_loop_runs,
)
from afl_mujoco.validation.checks.equation_checks import equation_checks
from afl_mujoco.validation.checks.explanation import Explanation, explain, plateau_check
from afl_mujoco.validation.checks.reference_checks import reference_checks
from afl_mujoco.validation.claims.ledger import Ledger, judge_claims
from afl_mujoco.validation.claims.schedules import FULL, QUICK
from afl_mujoco.validation.decisions import DECISIONS
from afl_mujoco.validation.metrics import (
    Metrics,
    metrics,
    objective_scales,
    with_objective,
)

REPORTED = ("ode", "mujoco exact", "mujoco continuous", "mujoco sampled")
"""Simulators whose metrics the report gives; the others are references of checks."""

DECISIVE = "mujoco continuous"
"""Simulator whose runs decide the paper's claims: the law as published, in MuJoCo's physics."""

_PACKAGES = ("afl_mujoco", "mujoco", "dm_control", "numpy", "scipy", "numba")


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """The result of a campaign.

    Attributes
    ----------
    checks
        Every judged figure.
    runs
        Every run's metrics.
    explanations
        Error budget, ledger and omissions of each scenario and controller.
    ledger
        The paper's claims, judged; empty unless the campaign ran all that they need.
    """

    checks: tuple[Check, ...]
    runs: tuple[Run, ...]
    explanations: tuple[Explanation, ...] = ()
    ledger: Ledger = field(default_factory=Ledger)

    @property
    def passed(self) -> bool:
        """Whether every check holds, and there is one."""
        return bool(self.checks) and all(check.passed for check in self.checks)

    @property
    def failed_checks(self) -> tuple[Check, ...]:
        """The checks that do not hold."""
        return tuple(check for check in self.checks if not check.passed)

    def to_dict(self) -> dict[str, Any]:
        """Return the report as plain data, schema 1."""
        versions = {name: version(name) for name in _PACKAGES}
        return {
            "schema": 1,
            "verdict": "pass" if self.passed else "fail",
            "versions": {**versions, "python": platform.python_version()},
            "checks": [check.to_dict() for check in self.checks],
            "runs": [run.to_dict() for run in self.runs],
            "claims": [claim.to_dict() for claim in self.ledger.claims],
            "random_schedules": self.ledger.comparisons_as_data(),
            "error_budgets": [e.budget.to_dict() for e in self.explanations if e.budget],
            "ledgers": [e.ledger.to_dict() for e in self.explanations if e.ledger],
            "omissions": [e.omission.to_dict() for e in self.explanations if e.omission],
            "decisions": dict(DECISIONS),
        }


Pair = tuple[Scenario, Law, Settings]
Judged = tuple[tuple[Check, ...], tuple[Run, ...], Explanation]


def run_campaign(
    scenarios: Sequence[Scenario],
    controllers: Sequence[Law],
    settings: Settings,
    *,
    workers: int = 1,
    progress: Callable[[str], None] = lambda done: None,
) -> Report:
    """Judge every scenario with every controller.

    Parameters
    ----------
    scenarios, controllers
        What to combine.
    settings
        Step sizes.
    workers
        Processes to share the work among; the result does not depend on it.
    progress
        Called with the name of each pair as it is done.

    Returns
    -------
    Report
        Checks and runs, in the order of the arguments.

    Raises
    ------
    AflMujocoError
        If a setting breaks its rule; nothing is run then.
    """
    require_runnable(scenarios, controllers, settings, workers)
    pairs = [(s, c, settings) for s in scenarios for c in controllers]
    checks = list(equation_checks())
    if settings.full:
        checks += [*reference_checks(), plateau_check()]
    scales = nominal_scales(settings)
    with open_executor(min(workers, len(pairs))) as executor:
        judged = compute_all(judge, pairs, executor, lambda i: progress(pair_name(pairs[i])))
        runs = tuple(
            replace(run, metrics=with_objective(run.metrics, scales))
            for _, reported, _ in judged
            for run in reported
        )
        published = {s.name for s in scenarios if SCENARIOS.get(s.name) == s}
        decisive = {
            (run.scenario, run.controller): run.metrics
            for run in runs
            if run.simulator == DECISIVE and run.scenario in published
        }
        schedules = FULL if settings.full else QUICK
        ledger = judge_claims(decisive, scales, schedules, executor, progress)
    for pair_checks, _, explanation in judged:
        checks += [*pair_checks, *explanation.checks]
    return Report(
        checks=tuple(checks),
        runs=runs,
        explanations=tuple(explanation for _, _, explanation in judged),
        ledger=ledger,
    )


def pair_name(pair: Pair) -> str:
    """Return what a progress bar calls a pair.

    Parameters
    ----------
    pair
        Scenario, controller and settings.
    """
    return f"{pair[0].name} / {pair[1].name}"


def judge(pair: Pair) -> Judged:
    """Run and judge one scenario with one controller.

    Parameters
    ----------
    pair
        Scenario, controller and settings.

    Returns
    -------
    tuple
        The checks, the runs of `REPORTED` with their metrics, and what explains them.
    """
    scenario, controller, settings = pair
    runs = closed_loop_runs(scenario, controller, settings)
    reported = reported_runs(scenario, controller, runs)
    checks = closed_loop_checks(scenario, controller, runs)
    return checks, reported, explain(scenario, controller, runs, full=settings.full)


def reported_runs(
    scenario: Scenario, controller: Law, runs: Mapping[str, Trajectory]
) -> tuple[Run, ...]:
    """Return the runs of `REPORTED` with their metrics, the objective aside.

    Parameters
    ----------
    scenario, controller
        What was simulated.
    runs
        From `closed_loop_runs`.
    """
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


def nominal_scales(settings: Settings) -> ObjectiveScales:
    """Return the scales of the objective: the fixed gains on the nominal plant (decision D4).

    Parameters
    ----------
    settings
        Gives the grid on which the integrals are taken.
    """
    scenario, controller = SCENARIOS["nominal"], CONTROLLERS["fixed"]
    run = simulate_ode(scenario, controller, sample_period=settings.timestep)
    return objective_scales(metrics(scenario, controller, run))


def require_runnable(
    scenarios: Sequence[Scenario],
    controllers: Sequence[Law],
    settings: Settings,
    workers: int,
) -> None:
    """Raise if a campaign cannot be run as asked; arguments as of `run_campaign`.

    Parameters
    ----------
    scenarios, controllers, settings, workers
        What would be run.

    Raises
    ------
    AflMujocoError
        If a setting breaks its rule, or a name stands twice.
    """
    if workers < 1:
        raise InvalidValueError("workers", "must be at least 1", workers)
    for thing, names in (
        ("scenario", [s.name for s in scenarios]),
        ("controller", [c.name for c in controllers]),
    ):
        if not names:
            raise InvalidValueError(f"{thing}s", "must hold at least one")
        for name in names:
            if names.count(name) > 1:
                raise InvalidValueError(f"{thing} names", "must differ", f"{name!r} twice")
    whole_steps("control_period", settings.control_period, "timestep", settings.timestep)
    for scenario in scenarios:
        scenario.require_ideal()
        whole_steps("duration", scenario.duration, "timestep", settings.timestep)
        if abs(tilt := scenario.initial_state[1]) >= 0.5 * math.pi:
            rule = "must lie inside (-pi/2, pi/2): a pole that has fallen leaves nothing to compare"
            raise InvalidValueError(f"scenario {scenario.name!r}: initial phi", rule, f"{tilt} rad")
        for controller in controllers:
            law_along(scenario, controller, np.array([0.0, *scenario.breakpoints]))
