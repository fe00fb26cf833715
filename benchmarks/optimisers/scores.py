"""Scores of searches, from the evaluations that their runs took to reach a target.

A run that did not reach it took infinitely many.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import binomtest, bootstrap, mannwhitneyu

CONFIDENCE = 0.95
RESAMPLES = 2000

FloatArray = NDArray[np.float64]


def expected_running_time(evaluations: ArrayLike, budget: int) -> float:
    """Return the fixed-target expected running time (ERT), in evaluations.

    All that the runs, shape (R,), spent, up to the target or to the budget, over the number that
    reached it: what it takes on average to reach it with a restart after each failure. Infinite if
    no run reached it. N. Hansen et al., COCO: Performance Assessment, 2016.
    """
    taken = np.asarray(evaluations, dtype=np.float64)
    solved = int(np.isfinite(taken).sum())
    return float(np.minimum(taken, budget).sum() / solved) if solved else float("inf")


def empirical_distribution(evaluations: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return where the share of solved (problem, target, run) rises, and the share from then on."""
    taken = np.ravel(np.asarray(evaluations, dtype=np.float64))
    values, counts = np.unique(taken[np.isfinite(taken)], return_counts=True)
    return values, np.cumsum(counts) / len(taken)


def superiority(evaluations: FloatArray, reference: FloatArray) -> FloatArray:
    """Return Vargha and Delaney's A12: the probability that a run is faster than one of another.

    Ties count half. 0.5: no difference; 1: always sooner; 0: never. Shapes (..., R) and (..., S)
    give shape (...).
    """
    mine, theirs = evaluations[..., :, None], reference[..., None, :]
    return ((mine < theirs) + 0.5 * (mine == theirs)).mean(axis=(-2, -1))


@dataclass(frozen=True, slots=True, kw_only=True)
class Effect:
    """How a search compares with another: A12 averaged over problems, and its interval.

    `p_value` is of the two-sided Mann-Whitney test of no difference, uncorrected for the number of
    tests; ``None`` for several problems combined.
    """

    a12: float
    low: float
    high: float
    p_value: float | None


def effect_size(
    evaluations: Sequence[ArrayLike], reference: Sequence[ArrayLike], *, seed: int = 0
) -> Effect:
    """Return how a search compares with another on one problem, or on several equally weighted.

    For each problem, `evaluations` and `reference` hold those of the runs, shape (R,). The interval
    is a percentile bootstrap, resampled within each problem. Where every run of one is sooner than
    every run of the other, on each problem, a bootstrap cannot vary; the interval is then the exact
    binomial one of runs paired off, which is wider than need be.
    """
    mine = [np.asarray(runs, dtype=np.float64) for runs in evaluations]
    theirs = [np.asarray(runs, dtype=np.float64) for runs in reference]

    def mean(*samples: FloatArray, axis: int = -1) -> FloatArray:
        halves = zip(samples[: len(mine)], samples[len(mine) :], strict=True)
        average: FloatArray = np.mean([superiority(x, y) for x, y in halves], axis=0)
        return average

    a12 = float(mean(*mine, *theirs))
    pairs = sum(min(len(x), len(y)) for x, y in zip(mine, theirs, strict=True))
    if a12 in (0.0, 1.0):
        exact = binomtest(round(a12 * pairs), pairs)
        interval = exact.proportion_ci(CONFIDENCE, method="exact")
    else:
        interval = bootstrap(
            (*mine, *theirs),
            mean,
            n_resamples=RESAMPLES,
            batch=500,
            vectorized=True,
            confidence_level=CONFIDENCE,
            method="percentile",
            rng=seed,
        ).confidence_interval
    p_value = float(mannwhitneyu(mine[0], theirs[0]).pvalue) if len(mine) == 1 else None
    return Effect(a12=a12, low=float(interval.low), high=float(interval.high), p_value=p_value)
