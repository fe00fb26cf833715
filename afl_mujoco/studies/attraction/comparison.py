"""Where the ideal equations and MuJoCo disagree about what settles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.simulation.attraction.grid import OUTCOMES, AttractionMap

AGREE, ON_BORDER, INSIDE = range(3)
"""Kinds of grid point in the map of disagreement."""


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """One controller on one rectangle of rollouts, by the equations and in MuJoCo.

    Attributes
    ----------
    ode, mujoco
        The two maps.

    Raises
    ------
    InvalidValueError
        If the maps are not of the same grid points and the same controller.
    """

    ode: AttractionMap
    mujoco: AttractionMap

    def __post_init__(self) -> None:
        """Raise if the maps do not belong together."""
        a, b = self.ode, self.mujoco
        if a.controller != b.controller:
            rule = f"must be {a.controller!r} in both maps"
            raise InvalidValueError("controller", rule, repr(b.controller))
        for name in ("starts", "plants"):
            if not np.array_equal(getattr(a.grid, name), getattr(b.grid, name)):
                raise InvalidValueError(f"{name} of the grid points", "must be those of both maps")

    def disagreement(self) -> NDArray[np.uint8]:
        """Return for each grid point `AGREE`, `ON_BORDER` or `INSIDE`, shape (rows, columns).

        A grid point whose outcomes differ is on the border if, in either map, one of its up to
        eight neighbours has a different outcome: a finer grid would move it. The others are
        inside: the regions in which they differ are wider than the spacing of the grid.
        """
        differs = self.ode.outcome != self.mujoco.outcome
        border = on_border(self.ode.outcome) | on_border(self.mujoco.outcome)
        return np.where(differs, np.where(border, ON_BORDER, INSIDE), AGREE).astype(np.uint8)

    def transitions(self) -> NDArray[np.int64]:
        """Count grid points by their outcome by the equations (row) and in MuJoCo (column)."""
        count = len(OUTCOMES)
        pairs = count * self.ode.outcome.ravel().astype(np.int64) + self.mujoco.outcome.ravel()
        return np.bincount(pairs, minlength=count**2).reshape(count, count)


def on_border(outcome: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return whether one of a grid point's up to eight neighbours has a different outcome.

    Parameters
    ----------
    outcome
        Outcomes of a map, shape (rows, columns).
    """
    rows, columns = outcome.shape
    padded = np.pad(outcome, 1, mode="edge")
    border = np.zeros(outcome.shape, dtype=np.bool_)
    for i in range(3):
        for j in range(3):
            border |= padded[i : i + rows, j : j + columns] != outcome
    return border
