"""Thousands of closed loops, on constant plants or schedules, and the paper's objective of each."""

from afl_mujoco.simulation.batch.integrate import TOLERANCE, Terms, closed_loop_terms
from afl_mujoco.simulation.batch.objective import (
    ObjectiveScales,
    objective,
    penalised_objective,
)
from afl_mujoco.simulation.batch.scheduled import ScheduledTerms, scheduled_terms

__all__ = [
    "TOLERANCE",
    "ObjectiveScales",
    "ScheduledTerms",
    "Terms",
    "closed_loop_terms",
    "objective",
    "penalised_objective",
    "scheduled_terms",
]
