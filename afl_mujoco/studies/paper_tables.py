"""The paper's Tables 1 and 2, and what the rows that it prints say about its fits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.gain_function import GainFunction, scheduled_gain, shipped_data

PAIRS = 400
"""Pairs (M, l) of the paper's table, of which it prints 40."""

PUBLISHED_RMSE = {"switching": 0.7862, "slope": 0.1550, "boundary_layer": 6.6458}
"""RMSE of the fits over all pairs, from Table 2."""

OPTIMAL = 1e-2
"""Relative excess over the optimum up to which a published row counts as one."""

LABELS = {"table2": (0, 1, 2), "table1": (2, 1, 0)}
"""Columns of Table 1 that hold K, lambda and Phi, by the reading of its header (D2)."""


def published_rows() -> NDArray[np.float64]:
    """Return Table 1 as the paper heads it: (Phi, lambda, K, objective, M, l), shape (40, 6)."""
    return np.array(shipped_data("published_table.json")["rows"])


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """One published fit beside the rows that are printed.

    Attributes
    ----------
    gain, labels
        The gain, and the reading of the columns (D2).
    rmse
        RMSE of the published function over the printed rows.
    least
        Least RMSE that it can have over all pairs: the others may be met exactly.
    published
        The RMSE that the paper gives for all pairs.
    """

    gain: str
    labels: str
    rmse: float
    least: float
    published: float

    @property
    def possible(self) -> bool:
        """Whether the published RMSE can be right: it is printed to four decimals."""
        return self.least <= self.published + 5e-5


def published_fits() -> tuple[Fit, ...]:
    """Return the published fits of each gain under each reading of the columns."""
    rows, function = published_rows(), GainFunction.published()
    found = []
    for labels, columns in LABELS.items():
        for gain, column in zip(PUBLISHED_RMSE, columns, strict=True):
            values: NDArray[np.float64] = scheduled_gain(  # type: ignore[no-untyped-call]
                rows[:, 4], rows[:, 5], getattr(function, gain)
            )
            rmse = float(np.sqrt(np.mean((values - rows[:, column]) ** 2)))
            least = rmse * float(np.sqrt(len(rows) / PAIRS))
            published = PUBLISHED_RMSE[gain]
            found.append(Fit(gain=gain, labels=labels, rmse=rmse, least=least, published=published))
    return tuple(found)
