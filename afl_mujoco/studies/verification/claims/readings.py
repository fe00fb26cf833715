"""Table 3 under readings of what the paper leaves open: those fitted to it, and random ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.studies.paper_readings import (
    NEAR,
    PUBLISHED_IMPROVEMENTS,
    improvements,
    random_readings,
    shipped_readings,
    terms_of,
)

READINGS = 2000
"""Number of random readings."""

SEED = 0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tried:
    """The improvements of Table 3's cases under readings.

    Attributes
    ----------
    names
        Names of the readings that `afl-mujoco readings` fitted to Table 3, shape (K,).
    fitted, random
        Improvements under those and under random readings [%], shapes (K, 4) and (N, 4); not finite
        where a run was lost.
    """

    names: tuple[str, ...]
    fitted: NDArray[np.float64]
    random: NDArray[np.float64]


def try_readings(count: int) -> Tried:
    """Return the improvements under the fitted readings and under random ones, computed anew."""
    shipped = shipped_readings()
    readings = np.stack([*shipped.values(), *random_readings(count, SEED)])
    found = improvements(terms_of(readings).objectives(readings))
    return Tried(names=tuple(shipped), fitted=found[: len(shipped)], random=found[len(shipped) :])


def near(found: NDArray[np.float64], case: int) -> NDArray[np.bool_]:
    """Return whether the improvement of a case comes near the paper's under each reading."""
    return np.asarray(np.abs(found[:, case] - PUBLISHED_IMPROVEMENTS[case]) <= NEAR)
