"""The claims ledger: C1 to C12 of the paper, judged."""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.gain_table import GainTable
from afl_mujoco.scenario.catalogue import SCENARIOS
from afl_mujoco.simulation.batch import ObjectiveScales
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
from afl_mujoco.studies.verification.claims.readings import Tried
from afl_mujoco.studies.verification.claims.schedules import Comparison, schedules_claim
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


def decidable(runs: Container[tuple[str, str]]) -> bool:
    """Return whether the runs are all that the claims need: both controllers, every scenario."""
    return all((s, c) in runs for s in SCENARIOS for c in (FIXED, ADAPTIVE))


def judge_claims(
    runs: Runs, scales: ObjectiveScales, objectives: NDArray[np.float64], tried: Tried
) -> Ledger:
    """Judge the claims by runs that decide them.

    Parameters
    ----------
    objectives
        On random schedules, for C9, from `objectives_on_schedules`.
    tried
        Random readings of the paper, for C3 to C6.
    """
    c9, comparisons = schedules_claim(objectives)
    table = GainTable.shipped()
    claims = (
        linearisation_claim(),
        *performance_claims(runs, tried),
        c9,
        optima_claim(table, scales),
        fit_claim(table),
        search_claim(),
    )
    return Ledger(claims=claims, comparisons=comparisons)
