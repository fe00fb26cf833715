"""Thousands of closed loops on constant plants at once, and the paper's objective of each."""

from afl_mujoco.simulation.batch.integrate import TOLERANCE, Terms, closed_loop_terms
from afl_mujoco.simulation.batch.objective import (
    ObjectiveScales,
    objective,
    penalised_objective,
)

__all__ = [
    "TOLERANCE",
    "ObjectiveScales",
    "Terms",
    "closed_loop_terms",
    "objective",
    "penalised_objective",
]
