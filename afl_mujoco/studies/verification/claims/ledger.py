"""The claims ledger: C1 to C12 of the paper, judged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from afl_mujoco.control.gain_table import GainTable
from afl_mujoco.execution.executors import Executor, compute_all
from afl_mujoco.scenario.catalogue import SCENARIOS
from afl_mujoco.simulation.batch import ObjectiveScales
from afl_mujoco.studies.contract import Progress, counted, silent
from afl_mujoco.studies.verification.claims.claim import Claim
from afl_mujoco.studies.verification.claims.gains import (
    fit_claim,
    linearisation_claim,
    optima_claim,
)
from afl_mujoco.studies.verification.claims.performance import (
    ADAPTIVE,
    FIXED,
    Runs,
    performance_claims,
)
from afl_mujoco.studies.verification.claims.schedules import (
    Comparison,
    objectives_on_schedule,
    schedules_claim,
)
from afl_mujoco.studies.verification.claims.search import search_claim


@dataclass(frozen=True, slots=True, kw_only=True)
class Ledger:
    """The claims, judged, and the comparisons over random schedules behind C9.

    Attributes
    ----------
    claims
        C1 to C12 in order; empty if the campaign did not run what they need.
    comparisons
        Adaptive against fixed gains, published and retuned.
    """

    claims: tuple[Claim, ...] = ()
    comparisons: Mapping[str, Comparison] = field(default_factory=dict)


def decidable(runs: Runs) -> bool:
    """Return whether the runs are all that the claims need: both controllers, every scenario."""
    return all((s, c) in runs for s in SCENARIOS for c in (FIXED, ADAPTIVE))


def judge_claims(
    runs: Runs,
    scales: ObjectiveScales,
    schedules: int,
    executor: Executor,
    progress: Progress = silent,
) -> Ledger:
    """Judge the claims; return an empty ledger if the runs do not decide them.

    Parameters
    ----------
    schedules
        Number of random schedules to draw for C9.
    """
    if not decidable(runs):
        return Ledger()
    units = [(index, scales) for index in range(schedules)]
    advance = counted(progress, "random schedules", schedules)
    objectives = compute_all(objectives_on_schedule, units, executor, advance)
    c9, comparisons = schedules_claim(objectives)
    table = GainTable.shipped()
    claims = (
        linearisation_claim(),
        *performance_claims(runs),
        c9,
        optima_claim(table, scales),
        fit_claim(table),
        search_claim(),
    )
    return Ledger(claims=claims, comparisons=comparisons)
