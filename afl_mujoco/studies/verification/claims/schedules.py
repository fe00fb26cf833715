"""C9: is the improvement a property of the method? Random schedules, published and retuned."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.catalogue import CONTROLLERS
from afl_mujoco.scenario.randomised import random_scenario
from afl_mujoco.simulation.batch import ObjectiveScales
from afl_mujoco.simulation.scoring import ideal_objective
from afl_mujoco.studies.verification.claims.claim import IN_PART, NOT_REPRODUCED, REPRODUCED, Claim

COMPARED = ("fixed", "adaptive", "fixed-retuned", "adaptive-retuned")
SEED = 0
QUICK, FULL = 200, 1000
"""Number of schedules drawn by default, and in a full verification."""

ENOUGH = 0.95
"""Share of schedules on which adaptive gains must win to be called better in general."""

Unit = tuple[int, ObjectiveScales]


def objectives_on_schedule(unit: Unit) -> list[float | None]:
    """Return the objective of each of `COMPARED` on one random schedule; None where it fell."""
    index, scales = unit
    scenario = random_scenario(SEED, index)
    return [ideal_objective(scenario, CONTROLLERS[name], scales) for name in COMPARED]


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """How adaptive gains do against fixed ones over many schedules.

    Attributes
    ----------
    schedules
        Number of schedules drawn.
    share
        Share of them on which the adaptive gains have the lower objective.
    interval
        Its exact (Clopper-Pearson) 95 % confidence interval.
    quantiles
        Quantiles of the improvement [%], by percentile; a run that fell counts as infinitely bad.
    """

    schedules: int
    share: float
    interval: tuple[float, float]
    quantiles: Mapping[str, float | None]


def compare(fixed: NDArray[np.float64], adaptive: NDArray[np.float64]) -> Comparison:
    """Compare the objectives of two controllers over the same schedules.

    Parameters
    ----------
    fixed, adaptive
        Objectives, shape (N,); infinite where the pole fell.
    """
    from scipy.stats import binomtest  # half a second to import, and of use only here

    wins = int(np.sum(adaptive < fixed))
    test = binomtest(wins, len(fixed)).proportion_ci(confidence_level=0.95, method="exact")
    with np.errstate(invalid="ignore"):
        improved = 100.0 * np.where(adaptive == fixed, 0.0, 1.0 - adaptive / fixed)
    found = np.quantile(np.sort(improved), (0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0), method="lower")
    names = ("least", "5%", "25%", "median", "75%", "95%", "largest")
    return Comparison(
        schedules=len(fixed),
        share=wins / len(fixed),
        interval=(float(test.low), float(test.high)),
        quantiles={
            name: float(x) if np.isfinite(x) else None for name, x in zip(names, found, strict=True)
        },
    )


def schedules_claim(
    objectives: Sequence[Sequence[float | None]],
) -> tuple[Claim, Mapping[str, Comparison]]:
    """Judge C9, and return the comparisons behind it."""
    table = np.array([[np.inf if x is None else x for x in row] for row in objectives])
    found = {
        "published": compare(table[:, 0], table[:, 1]),
        "retuned": compare(table[:, 2], table[:, 3]),
    }
    paper, ours = found["published"], found["retuned"]
    claim = Claim(
        id="C9",
        claim="the improvement is a property of the method, not of one schedule",
        figure="share of random schedules on which the published adaptive gains win [%]",
        paper=100.0,
        here=100.0 * paper.share,
        verdict=_judged(paper),
        why=f"of {paper.schedules} schedules (95 % interval {100 * paper.interval[0]:.1f} to "
        f"{100 * paper.interval[1]:.1f} %), median improvement {_percent(paper)}; "
        f"retuned gains win on {100 * ours.share:.1f} % ({100 * ours.interval[0]:.1f} to "
        f"{100 * ours.interval[1]:.1f} %), median {_percent(ours)}",
    )
    return claim, found


def _percent(comparison: Comparison) -> str:
    """Return the median improvement for use in a sentence."""
    median = comparison.quantiles["median"]
    return "none" if median is None else f"{median:.1f} %"


def _judged(comparison: Comparison) -> str:
    """Return the verdict; the claim holds in part only if winning is likelier than losing."""
    if comparison.share >= ENOUGH:
        return REPRODUCED
    return IN_PART if comparison.interval[0] > 0.5 else NOT_REPRODUCED
