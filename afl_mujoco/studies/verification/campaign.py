"""The campaign: every scenario x controller x simulator, judged; the same bits from any workers."""

from __future__ import annotations

import platform
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version
from typing import Any

from afl_mujoco.control.controller import Controller
from afl_mujoco.execution.executors import Executor, compute_all, open_executor
from afl_mujoco.scenario.catalogue import SCENARIOS
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.metrics import nominal_scales, with_objective
from afl_mujoco.studies.cases import Run, Settings, case_name, require_runnable
from afl_mujoco.studies.verification.case import judge
from afl_mujoco.studies.verification.check import Check
from afl_mujoco.studies.verification.checks.convergence import Refinement
from afl_mujoco.studies.verification.checks.equation_checks import equation_checks
from afl_mujoco.studies.verification.checks.explanation import Explanation, plateau_check
from afl_mujoco.studies.verification.checks.reference_checks import free_swings, reference_checks
from afl_mujoco.studies.verification.claims.ledger import Ledger, judge_claims
from afl_mujoco.studies.verification.claims.schedules import FULL, QUICK
from afl_mujoco.studies.verification.curves import Curves
from afl_mujoco.studies.verification.decisions import DECISIONS

DECISIVE = "mujoco continuous"
"""Simulator whose runs decide the paper's claims: the law as published, in MuJoCo's physics."""

_PACKAGES = ("afl_mujoco", "mujoco", "dm_control", "numpy", "scipy", "numba")


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
    studies
        The refinement studies; empty unless the campaign was full.
    curves
        Every scenario and controller over time, for figures; not part of the plain data.
    settings
        Step sizes of the campaign.
    command
        What reproduces it, as typed into a shell.
    """

    checks: tuple[Check, ...]
    runs: tuple[Run, ...]
    explanations: tuple[Explanation, ...] = ()
    ledger: Ledger = field(default_factory=Ledger)
    studies: tuple[Refinement, ...] = ()
    curves: tuple[Curves, ...] = ()
    settings: Settings = field(default_factory=Settings)
    command: str = ""

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
            "studies": [study.to_dict() for study in self.studies],
            "omissions": [e.omission.to_dict() for e in self.explanations if e.omission],
            "decisions": dict(DECISIONS),
            "settings": asdict(self.settings),
            "command": self.command,
        }


def run_campaign(
    scenarios: Sequence[Scenario],
    controllers: Sequence[Controller],
    settings: Settings,
    *,
    workers: int = 1,
    executor: Executor | None = None,
    progress: Callable[[str], None] = lambda done: None,
) -> Report:
    """Judge every scenario with every controller.

    Parameters
    ----------
    workers
        Processes to share the work among; the result does not depend on it.
    progress
        Called with the name of each pair as it is done.
    """
    require_runnable(scenarios, controllers, settings, workers)
    cases = [(s, c, settings) for s in scenarios for c in controllers]
    checks = list(equation_checks())
    studies: list[Refinement] = []
    if settings.full:
        swings = free_swings()
        checks += [*reference_checks(swings), plateau_check()]
        studies += swings
    scales = nominal_scales(settings.timestep)
    processes = open_executor(min(workers, len(cases)))
    with processes if executor is None else nullcontext(executor) as executor:
        judged = compute_all(judge, cases, executor, lambda i: progress(case_name(cases[i])))
        runs = tuple(
            replace(run, metrics=with_objective(run.metrics, scales))
            for pair in judged
            for run in pair.runs
        )
        published = {s.name for s in scenarios if SCENARIOS.get(s.name) == s}
        decisive = {
            (run.scenario, run.controller): run.metrics
            for run in runs
            if run.simulator == DECISIVE and run.scenario in published
        }
        schedules = FULL if settings.full else QUICK
        ledger = judge_claims(decisive, scales, schedules, executor, progress)
    for pair in judged:
        checks += [*pair.checks, *pair.explanation.checks]
        studies += pair.explanation.studies
    return Report(
        checks=tuple(checks),
        runs=runs,
        explanations=tuple(pair.explanation for pair in judged),
        ledger=ledger,
        studies=tuple(studies),
        curves=tuple(pair.curves for pair in judged),
        settings=settings,
    )
