"""The cost of gains on one plant: the objective (O1) inside the box of decision D8."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.gain_function import GAIN_NAMES
from afl_mujoco.control.gains import FIXED_GAINS
from afl_mujoco.scenario.parameters import NOMINAL
from afl_mujoco.simulation.batch import closed_loop_terms
from afl_mujoco.simulation.batch.objective import ObjectiveScales, penalised_objective
from afl_mujoco.studies.gain_tuning.settings import Box

HORIZON = 20.0
"""Horizon of the objective [s], decision D4."""

GAIN_BOX = Box(lower=(100.0, 1.0, 90.0), upper=(200.0, 5.0, 110.0))
"""Box of (K, lambda, Phi), decision D8."""

Cost = Callable[[NDArray[np.float64]], NDArray[np.float64]]


@functools.cache
def paper_scales() -> ObjectiveScales:
    """Return the scales of (O1): its terms for the fixed gains on the nominal plant (D4)."""
    gains = [[getattr(FIXED_GAINS, name) for name in GAIN_NAMES]]
    plant = (NOMINAL.cart_mass, NOMINAL.half_length)
    terms = closed_loop_terms(gains, plant, duration=HORIZON)
    return ObjectiveScales(
        iae_z=float(terms.iae_z[0]),
        iae_phi=float(terms.iae_phi[0]),
        max_force=float(terms.max_force[0]),
    )


def gain_cost(cart_mass: float, half_length: float) -> Cost:
    """Return the cost of gains (K, lambda, Phi), shape (N, 3), on one plant.

    Parameters
    ----------
    cart_mass, half_length
        M [kg] and l [m].
    """

    def cost(gains: NDArray[np.float64]) -> NDArray[np.float64]:
        terms = closed_loop_terms(gains, (cart_mass, half_length), duration=HORIZON)
        return penalised_objective(terms, paper_scales(), HORIZON)

    return cost
