"""The referee of searches: does the paper's find the optimal gains, and how do others compare."""

from afl_mujoco.tuning.referee.contest import TARGETS, Contest
from afl_mujoco.tuning.referee.files import load_result, save_result, shipped_result, summary
from afl_mujoco.tuning.referee.optimisers import OPTIMISERS, Optimiser
from afl_mujoco.tuning.referee.problems import PROBLEMS, Optimum, Problem, known_optimum
from afl_mujoco.tuning.referee.result import ContestResult
from afl_mujoco.tuning.referee.runs import hold_contest
from afl_mujoco.tuning.referee.scores import (
    Effect,
    effect_size,
    empirical_distribution,
    expected_running_time,
    superiority,
)

__all__ = [
    "OPTIMISERS",
    "PROBLEMS",
    "TARGETS",
    "Contest",
    "ContestResult",
    "Effect",
    "Optimiser",
    "Optimum",
    "Problem",
    "effect_size",
    "empirical_distribution",
    "expected_running_time",
    "hold_contest",
    "known_optimum",
    "load_result",
    "save_result",
    "shipped_result",
    "summary",
    "superiority",
]
