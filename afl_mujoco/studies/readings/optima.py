"""Table 1 under every choice of scales: how many of its rows are optima of (O1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from afl_mujoco.simulation.batch import closed_loop_terms
from afl_mujoco.studies.paper_readings import Array, nominal_terms
from afl_mujoco.studies.paper_tables import LABELS, OPTIMAL, published_rows

BOX = {"K": (100.0, 200.0), "lambda": (1.0, 5.0), "Phi": (90.0, 110.0)}
"""Box of the gains (D8)."""


SPAN = 4.0
"""Largest log10 of a factor on a scale."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Optima:
    """How Table 1 does under one horizon and one reading of its columns.

    Attributes
    ----------
    labels, horizon
        Reading of the columns (D2), and the horizon [s].
    best
        Largest number of rows that are optimal under one choice of scales.
    scales
        log10 of the factors on D4's scales for the integrals of z and phi, where that is so.
    as_decided
        Number of rows that are optimal under D4's scales.
    median_excess
        Median excess over the optimum where most rows are optimal [1].
    column_error
        Rms relative difference of column OF from the best non-negative weights of the terms [1].
    """

    labels: str
    horizon: float
    best: int
    scales: tuple[float, float]
    as_decided: int
    median_excess: float
    column_error: float


def judge_optima(unit: tuple[str, float, int, int]) -> Optima:
    """Compare Table 1 with the optimum over a grid of gains, under a grid of scales.

    The optimum over a grid is not below that over the box, so that the excess is, if anything, too
    small: the paper is given the benefit.

    Parameters
    ----------
    unit
        Labels, horizon, grid points of lambda (a quarter of them for K, an eighth for Phi), and
        grid points of each scale.
    """
    labels, horizon, slopes, steps = unit
    rows = published_rows()
    plants, columns = rows[:, [4, 5]], LABELS[labels]
    axes = [
        np.linspace(*BOX["K"], max(slopes // 4, 2)),
        np.geomspace(*BOX["lambda"], slopes),
        np.linspace(*BOX["Phi"], max(slopes // 8, 2)),
    ]
    gains = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    nominal = nominal_terms()
    published = _terms(rows[:, columns], plants, horizon) / nominal
    grid = np.linspace(-SPAN, SPAN, steps)
    pairs = np.stack(np.meshgrid(grid, grid, indexing="ij"), axis=-1).reshape(-1, 2)
    weights = np.column_stack([10.0**-pairs, np.ones(len(pairs))])
    excess = np.empty((len(rows), len(pairs)))
    for k, plant in enumerate(plants):
        here = published[k] @ weights.T
        terms = _terms(gains, np.broadcast_to(plant, (len(gains), 2)), horizon) / nominal
        least = np.minimum((terms @ weights.T).min(axis=0), here)
        excess[k] = here / least - 1.0
    good = (excess <= OPTIMAL).sum(axis=0)
    most = int(np.lexsort((np.median(excess, axis=0), -good))[0])
    decided = int(np.abs(pairs).sum(axis=1).argmin())
    _, residual = nnls(published / rows[:, [3]], np.ones(len(rows)))
    return Optima(
        labels=labels,
        horizon=horizon,
        best=int(good[most]),
        scales=(float(pairs[most, 0]), float(pairs[most, 1])),
        as_decided=int(good[decided]),
        median_excess=float(np.median(excess[:, most])),
        column_error=float(residual / np.sqrt(len(rows))),
    )


def _terms(gains: Array, plants: Array, horizon: float) -> Array:
    """Return the terms of (O1), shape (N, 3)."""
    found = closed_loop_terms(gains, plants, duration=horizon)
    terms = np.column_stack([found.iae_z, found.iae_phi, found.max_force])
    terms[found.lost] = np.inf
    return terms
