"""The campaign: every scenario x controller x simulator, judged; the same bits from any workers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from afl_mujoco.control.controller import Controller
from afl_mujoco.execution.executors import compute_all, open_executor
from afl_mujoco.scenario.catalogue import is_published
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.scoring import nominal_scales, with_objective
from afl_mujoco.studies.cases import DECISIVE, Settings, require_runnable
from afl_mujoco.studies.contract import Progress, counted, silent
from afl_mujoco.studies.verification.case import judge
from afl_mujoco.studies.verification.checks.convergence import Refinement
from afl_mujoco.studies.verification.checks.equation_checks import equation_checks
from afl_mujoco.studies.verification.checks.explanation import plateau_check
from afl_mujoco.studies.verification.checks.reference_checks import free_swings, reference_checks
from afl_mujoco.studies.verification.claims.ledger import judge_claims
from afl_mujoco.studies.verification.result import Result, verdict_of


def verify(
    scenarios: Sequence[Scenario],
    controllers: Sequence[Controller],
    settings: Settings,
    *,
    workers: int = 1,
    progress: Progress = silent,
) -> Result:
    """Judge every scenario with every controller; arguments as for the study's `run`."""
    require_runnable(scenarios, controllers, settings)
    cases = [(s, c, settings) for s in scenarios for c in controllers]
    progress("cases", 0, len(cases))
    checks = list(equation_checks())
    studies: list[Refinement] = []
    if settings.full:
        swings = free_swings()
        checks += [*reference_checks(swings), plateau_check()]
        studies += swings
    scales = nominal_scales(settings.timestep)
    advance = counted(progress, "cases", len(cases))
    with open_executor(min(workers, len(cases))) as executor:
        judged = compute_all(judge, cases, executor, advance)
        runs = tuple(
            replace(run, metrics=with_objective(run.metrics, scales))
            for case in judged
            for run in case.runs
        )
        published = {s.name for s in scenarios if is_published(s)}
        decisive = {
            (run.scenario, run.controller): run.metrics
            for run in runs
            if run.simulator == DECISIVE and run.scenario in published
        }
    ledger = judge_claims(decisive, scales)
    for case in judged:
        checks += [*case.checks, *case.explanation.checks]
        studies += case.explanation.studies
    requirements = tuple(case.requirements for case in judged)
    explained = [case.explanation for case in judged]
    return Result(
        verdict=verdict_of(tuple(checks), requirements),
        checks=tuple(checks),
        runs=runs,
        requirements=requirements,
        claims=ledger.claims,
        random_schedules=ledger.comparisons,
        error_budgets=tuple(e.budget for e in explained if e.budget),
        ledgers=tuple(e.ledger for e in explained if e.ledger),
        omissions=tuple(e.omission for e in explained if e.omission),
        studies=tuple(studies),
        settings=settings,
        scenarios=tuple(scenarios),
        curves={f"{c.curves.scenario}/{c.curves.controller}": c.curves for c in judged},
    )
