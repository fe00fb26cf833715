"""The paper's objective (O1) of a closed loop, and the cost of a loop that is lost."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.simulation.batch.integrate import Terms

PENALTY = 1e9
"""Cost of a loop that falls or diverges at the horizon; one that does so at once costs twice as
much."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectiveScales:
    """The scales by which the terms of (O1) are divided (decision D4).

    Attributes
    ----------
    iae_z
        Integral of abs(z) [m s].
    iae_phi
        Integral of abs(phi) [rad s].
    max_force
        Largest abs(F) [N].
    """

    iae_z: float
    iae_phi: float
    max_force: float


def objective(iae_z: Any, iae_phi: Any, max_force: Any, scales: ObjectiveScales) -> Any:
    """Return the objective of Eq. (O1), of floats or arrays.

    Parameters
    ----------
    iae_z, iae_phi
        Integrals of abs(z) [m s] and abs(phi) [rad s].
    max_force
        Largest abs(F) [N].
    """
    return iae_z / scales.iae_z + iae_phi / scales.iae_phi + max_force / scales.max_force


def penalised_objective(
    terms: Terms, scales: ObjectiveScales, duration: float
) -> NDArray[np.float64]:
    """Return a finite cost of each loop: lost loops cost more than others, early losses most.

    Parameters
    ----------
    duration
        The horizon [s].
    """
    costs = objective(terms.iae_z, terms.iae_phi, terms.max_force, scales)
    return np.where(terms.lost, PENALTY * (2.0 - terms.end_time / duration), costs)
