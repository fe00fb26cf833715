"""The campaign: every scenario x controller x simulator, judged; the same bits from any workers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from operator import call
from typing import Any

from afl_mujoco.control.controller import Controller
from afl_mujoco.pool import compute_all, open_executor
from afl_mujoco.scenario.catalogue import is_published
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.scoring import nominal_scales, with_objective
from afl_mujoco.studies.cases import DECISIVE, Settings, require_runnable
from afl_mujoco.studies.contract import Progress, counted, silent
from afl_mujoco.studies.verification.case import Judged, judge
from afl_mujoco.studies.verification.check import Check
from afl_mujoco.studies.verification.checks.convergence import Refinement
from afl_mujoco.studies.verification.checks.equation_checks import equation_checks
from afl_mujoco.studies.verification.checks.explanation import plateau_check
from afl_mujoco.studies.verification.checks.reference_checks import free_swings, reference_checks
from afl_mujoco.studies.verification.claims.ledger import decidable, judge_claims
from afl_mujoco.studies.verification.claims.shipped import shipped
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
    scales = nominal_scales(settings.timestep)
    published = {s.name for s in scenarios if is_published(s)}
    claimed = decidable({(name, c.name) for name in published for c in controllers})
    parts: list[Callable[[], Any]] = [partial(_of_equations, settings.full)]
    parts += [partial(judge, (s, c, settings)) for s in scenarios for c in controllers]
    progress("checking", 0, len(parts))
    with open_executor(min(workers, len(parts))) as executor:
        done = compute_all(call, parts, executor, counted(progress, "checking", len(parts)))
    checks, studies = done[0]
    judged: list[Judged] = done[1:]
    runs = tuple(
        replace(run, metrics=with_objective(run.metrics, scales))
        for case in judged
        for run in case.runs
    )
    decisive = {
        (run.scenario, run.controller): run.metrics
        for run in runs
        if run.simulator == DECISIVE and run.scenario in published
    }
    known = shipped() if claimed else None
    for case in judged:
        checks += [*case.checks, *case.explanation.checks]
        studies += case.explanation.studies
    rows = tuple(case.row for case in judged)
    explained = [case.explanation for case in judged]
    return Result(
        verdict=verdict_of(tuple(checks), rows),
        checks=tuple(checks),
        runs=runs,
        rows=rows,
        claims=judge_claims(decisive, known) if known else (),
        random_schedules=known.random_schedules if known else {},
        error_budgets=tuple(e.budget for e in explained if e.budget),
        ledgers=tuple(e.ledger for e in explained if e.ledger),
        omissions=tuple(e.omission for e in explained if e.omission),
        studies=tuple(studies),
        settings=settings,
        scenarios=tuple(scenarios),
        curves={f"{c.curves.scenario}/{c.curves.controller}": c.curves for c in judged},
    )


def _of_equations(full: bool) -> tuple[list[Check], list[Refinement]]:
    """Return the checks that need no case, and the refinement studies among them."""
    checks = list(equation_checks())
    if not full:
        return checks, []
    swings = free_swings()
    return [*checks, *reference_checks(swings), plateau_check()], list(swings)
