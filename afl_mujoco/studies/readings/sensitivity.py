"""Random readings: how often Table 3 holds, and what of a reading drives the improvement."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from afl_mujoco.studies.paper_readings import (
    AXES,
    CASES,
    NEAR,
    PUBLISHED_IMPROVEMENTS,
    Array,
    improvements,
    random_readings,
    readings_at,
    terms_of,
)

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
REPEATS = 5
"""Independent estimates of the Sobol' indices."""

Driver = tuple[str, float, float, float]
"""An unknown with its total-order Sobol' index: mean, least and largest of `REPEATS` estimates."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CaseShares:
    """How one improvement of Table 3 does over random readings.

    Attributes
    ----------
    case, paper
        The case, and the paper's improvement [%].
    near, half, positive
        Shares of the readings under which the improvement is within `NEAR` percentage points of the
        paper's, at least half of it, and above zero.
    quantiles
        Quantiles of the improvement [%] at `QUANTILES`.
    histogram
        Shares of the readings in the bins between `EDGES`.
    drivers
        Unknowns that matter in the case, largest index first. The index is the share of the
        variance of the improvement in which the unknown has a part, alone or with others; an
        improvement below the first edge of the histogram counts as that.
    """

    case: str
    paper: float
    near: float
    half: float
    positive: float
    quantiles: tuple[float, ...]
    histogram: tuple[float, ...]
    drivers: tuple[Driver, ...]


EDGES = tuple(range(-100, 105, 5))
"""Edges of the histogram of improvements [%]; what lies below is in the first bin."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensitivity:
    """What random readings say.

    Attributes
    ----------
    samples, lost
        Readings drawn, and how many of them a run fell under.
    all_near, all_half
        Numbers of readings under which all four improvements are within `NEAR` percentage points,
        and at least half of the paper's.
    cases
        Each case of Table 3.
    """

    samples: int
    lost: int
    all_near: int
    all_half: int
    cases: tuple[CaseShares, ...]


def sensitivity_of(samples: int, base: int, seed: int, threads: int) -> Sensitivity:
    """Draw random readings and say how often Table 3 holds, and what drives it.

    Parameters
    ----------
    samples, base
        Number of readings, and base sample of the Sobol' indices, a power of two.
    """
    found = _improvements(random_readings(samples, seed), threads)
    sound = np.isfinite(found).all(axis=1)
    kept = found[sound]
    near = np.abs(kept - PUBLISHED_IMPROVEMENTS) <= NEAR
    half = kept >= 0.5 * PUBLISHED_IMPROVEMENTS
    drivers = _drivers(base, seed, threads)
    clipped = np.clip(kept, EDGES[0], EDGES[-1])
    return Sensitivity(
        samples=samples,
        lost=int((~sound).sum()),
        all_near=int(near.all(axis=1).sum()),
        all_half=int(half.all(axis=1).sum()),
        cases=tuple(
            CaseShares(
                case=case,
                paper=float(PUBLISHED_IMPROVEMENTS[k]),
                near=float(near[:, k].sum() / samples),
                half=float(half[:, k].sum() / samples),
                positive=float((kept[:, k] > 0.0).sum() / samples),
                quantiles=tuple(np.quantile(kept[:, k], QUANTILES).tolist()),
                histogram=tuple((np.histogram(clipped[:, k], EDGES)[0] / samples).tolist()),
                drivers=drivers[k],
            )
            for k, case in enumerate(CASES)
        ),
    )


def _improvements(readings: Array, threads: int) -> Array:
    """Return the improvements under readings [%], shape (N, 4)."""
    return improvements(terms_of(readings, threads).objectives(readings))


def _drivers(base: int, seed: int, threads: int) -> list[tuple[Driver, ...]]:
    """Return the total-order Sobol' indices of each case's unknowns, largest first."""
    from scipy.stats import sobol_indices, uniform

    def model(points: Array) -> Array:
        found = _improvements(readings_at(points.T), threads)
        return np.clip(found, EDGES[0], None).T

    uniforms: list[Any] = [uniform()] * len(AXES)
    totals = np.stack(
        [
            sobol_indices(
                func=model, n=base, dists=uniforms, rng=np.random.default_rng((seed, repeat))
            ).total_order
            for repeat in range(1, REPEATS + 1)
        ]
    )
    found = []
    for low, mean, high in zip(
        totals.min(axis=0), totals.mean(axis=0), totals.max(axis=0), strict=True
    ):
        order = [i for i in np.argsort(-mean, kind="stable") if mean[i] != 0.0]
        found.append(
            tuple((AXES[i].name, float(mean[i]), float(low[i]), float(high[i])) for i in order)
        )
    return found
