"""A claim of the paper with its number, ours, and the verdict."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

REPRODUCED, IN_PART = "reproduced", "reproduced in part"
NOT_REPRODUCED, UNDETERMINED = "not reproduced", "cannot be determined"
EVERY, NONE = (f"holds under {which} reading tried" for which in ("every", "no"))
RANDOM, FITTED = "holds under random readings", "some reading can be fitted"
"""Verdicts on what hangs on what the paper leaves open (a reading of it). To `RANDOM` the
share is added. That a reading can be fitted, of so many unknowns, is no evidence that it is so."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Claim:
    """One row of the claims ledger.

    Attributes
    ----------
    id
        C1 to C12.
    claim
        What the paper says.
    figure
        What `paper` and `here` measure, with its unit.
    paper, here
        The paper's number and ours; ``None`` if there is none.
    verdict
        One of the verdicts of this module.
    why
        The reason for the verdict, one sentence.
    """

    id: str
    claim: str
    figure: str
    paper: float | None
    here: float | None
    verdict: str
    why: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """How adaptive gains do against fixed ones over many schedules."""

    schedules: int
    share: float
    """Share of the schedules on which the adaptive gains have the lower objective."""
    interval: tuple[float, float]
    """Its exact (Clopper-Pearson) 95 % confidence interval."""
    quantiles: Mapping[str, float | None]
    """Quantiles of the improvement [%], by percentile; a run that fell counts as infinitely bad."""


def verdict_on_readings(assumed: bool, fitted: Iterable[bool], drawn: float) -> str:
    """Return the verdict on a claim from whether it holds under readings.

    It may hold as `assumed` under D3 and D4, which were chosen before any was tried, under those
    that were `fitted` so that it would, and under a share of those `drawn` at random.
    """
    if drawn:
        return EVERY if assumed and drawn == 1.0 else f"{RANDOM} in {100.0 * drawn:.1f} %"
    return FITTED if assumed or any(fitted) else NONE


def kind(verdict: str) -> str:
    """Return a verdict without the share in it."""
    return RANDOM if verdict.startswith(RANDOM) else verdict


def verdict(share: float, enough: float = 1.0, least: float = 0.0) -> str:
    """Return the verdict on a share of what was claimed.

    Parameters
    ----------
    least
        Largest share that counts as not reproduced; between it and `enough`, in part.
    """
    return REPRODUCED if share >= enough else IN_PART if share > least else NOT_REPRODUCED
