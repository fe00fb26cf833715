"""C9: is the improvement a property of the method? Random schedules, published and retuned."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.catalogue import CONTROLLERS, AFLController
from afl_mujoco.scenario.randomised import random_scenario
from afl_mujoco.simulation.batch import ObjectiveScales, objective, scheduled_terms
from afl_mujoco.studies.verification.claims.claim import IN_PART, NOT_REPRODUCED, REPRODUCED, Claim

COMPARED = ("fixed", "adaptive", "fixed-retuned", "adaptive-retuned")
SEED = 0
SCHEDULES = 1000
"""Number of schedules drawn."""

ENOUGH = 0.95
"""Share of schedules on which adaptive gains must win to be called better in general."""


def objectives_on_schedules(count: int, scales: ObjectiveScales) -> NDArray[np.float64]:
    """Return the objectives of `COMPARED` on random schedules, shape (count, 4); inf where lost."""
    scenarios = [random_scenario(SEED, index) for index in range(count)]
    masses, lengths = (
        np.stack([getattr(scenario, name).knots for scenario in scenarios])
        for name in ("cart_mass", "half_length")
    )
    found = []
    for name in COMPARED:
        controller = CONTROLLERS[name]
        assert isinstance(controller, AFLController)
        coefficients = controller.gain_function.coefficients
        terms = scheduled_terms(masses, lengths, coefficients, scenarios[0].duration)
        values = objective(terms.iae_z, terms.iae_phi, terms.peak_force, scales)
        found.append(np.where(terms.lost, np.inf, values))
    return np.stack(found, axis=1)


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
    objectives: NDArray[np.float64],
) -> tuple[Claim, Mapping[str, Comparison]]:
    """Judge C9 by the objectives of `COMPARED`; return the comparisons behind it too."""
    found = {
        "published": compare(objectives[:, 0], objectives[:, 1]),
        "retuned": compare(objectives[:, 2], objectives[:, 3]),
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
