"""The plants whose gains are searched, and the best known optimum of each."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import qmc

from afl_mujoco.simulation.batch import closed_loop_terms, penalised_objective
from afl_mujoco.studies.gain_tuning.gain_cost import (
    GAIN_BOX,
    HORIZON,
    Cost,
    gain_cost,
    paper_scales,
)

RESOLUTION = 1e-6
"""Relative accuracy of an optimal cost: a tighter tolerance of the simulation moves it by up to
8e-7. A target nearer to the optimum than that is meaningless."""

TIGHT_TOLERANCE = 1e-8
"""Local error of a step at which the optimum is refined; the searches have 2e-6."""

DESIGN_SIZE = 4096
"""Points of the design from which the refinement starts."""

POLISHES: tuple[tuple[Any, Any], ...] = (
    ("Nelder-Mead", {"xatol": 1e-6, "fatol": 1e-9}),
    ("L-BFGS-B", {"eps": 1e-5}),
)
"""Local searches that refine the optimum, on a box scaled to a unit cube."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Problem:
    """The search for the gains of one plant, M [kg] and l [m], in the box of decision D8."""

    cart_mass: float
    half_length: float

    @property
    def label(self) -> str:
        """The plant in words."""
        return f"M = {self.cart_mass:g} kg, l = {self.half_length:g} m"

    @property
    def cost(self) -> Cost:
        """The cost that the searches see."""
        return gain_cost(self.cart_mass, self.half_length)

    @property
    def tight_cost(self) -> Cost:
        """The same cost from a simulation of a tighter tolerance."""

        def cost(gains: NDArray[np.float64]) -> NDArray[np.float64]:
            plant = (self.cart_mass, self.half_length)
            terms = closed_loop_terms(gains, plant, duration=HORIZON, tolerance=TIGHT_TOLERANCE)
            return penalised_objective(terms, paper_scales(), HORIZON)

        return cost


PROBLEMS = tuple(
    Problem(cart_mass=mass, half_length=length)
    for mass, length in ((1.0, 0.5), (2.0, 1.0), (0.1, 0.65), (0.5, 0.2), (0.1, 0.05))
)
"""Plants; the optimal lambda is inside the box for the first three, else on its bound."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Optimum:
    """The optimal gains (K, lambda, Phi), their cost as the searches see it, and the tight cost."""

    gains: tuple[float, float, float]
    cost: float
    tight_cost: float


@functools.cache
def known_optimum(problem: Problem) -> Optimum:
    """Return the best that local searches find, started in each octant of the box.

    The start in an octant is its best point of a Sobol' design.
    """
    lower, upper = np.array(GAIN_BOX.lower), np.array(GAIN_BOX.upper)
    tight = problem.tight_cost

    def gains_at(unit: NDArray[np.float64]) -> NDArray[np.float64]:
        gains: NDArray[np.float64] = np.clip(lower + (upper - lower) * unit, lower, upper)
        return gains

    def cost_at(unit: NDArray[np.float64]) -> float:
        return float(tight(gains_at(unit)[None])[0])

    design = qmc.Sobol(len(lower), scramble=False).random(DESIGN_SIZE)
    costs = problem.cost(gains_at(design))
    octants = (design > 0.5) @ (1, 2, 4)
    starts = [min(np.flatnonzero(octants == k), key=costs.__getitem__) for k in range(8)]
    unit_cube = [(0.0, 1.0)] * len(lower)
    found = [
        minimize(cost_at, design[start], method=method, bounds=unit_cube, options=options)
        for start in starts
        for method, options in POLISHES
    ]
    best = gains_at(min(found, key=lambda end: end.fun).x)
    switching, slope, boundary_layer = best.tolist()
    return Optimum(
        gains=(switching, slope, boundary_layer),
        cost=float(problem.cost(best[None])[0]),
        tight_cost=float(tight(best[None])[0]),
    )
