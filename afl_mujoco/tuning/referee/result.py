"""What a contest gave, and its scores."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.tuning.referee.contest import Contest
from afl_mujoco.tuning.referee.problems import Optimum, Problem
from afl_mujoco.tuning.referee.scores import (
    Effect,
    effect_size,
    empirical_distribution,
    expected_running_time,
)

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ContestResult:
    """What a contest gave.

    Attributes
    ----------
    contest
        What was compared.
    optima
        The optimum of each problem.
    best_costs
        Least cost that any run met on each problem; a run ends at its last target.
    evaluations
        Evaluations that each run took to each target, infinite if it did not reach it; shape
        (optimisers, problems, targets, runs).
    versions
        Of Python and of the packages.
    """

    contest: Contest
    optima: tuple[Optimum, ...]
    best_costs: tuple[float, ...]
    evaluations: FloatArray
    versions: Mapping[str, str]

    def __post_init__(self) -> None:
        """Check that the parts are of one size."""
        if self.evaluations.shape != self.contest.shape:
            rule = f"must have shape {self.contest.shape}"
            raise InvalidValueError("evaluations", rule, self.evaluations.shape)
        for name in ("optima", "best_costs"):
            if len(getattr(self, name)) != len(self.contest.problems):
                rule = "must hold one for each problem"
                raise InvalidValueError(name, rule, len(getattr(self, name)))
        self.evaluations.flags.writeable = False

    @property
    def successes(self) -> NDArray[np.intp]:
        """Runs that reached each target, shape (optimisers, problems, targets)."""
        reached: NDArray[np.intp] = np.isfinite(self.evaluations).sum(axis=-1)
        return reached

    @property
    def expected_running_times(self) -> FloatArray:
        """ERT [evaluations], shape (optimisers, problems, targets); infinite without success."""
        rows = self.evaluations.reshape(-1, self.contest.runs)
        times = [expected_running_time(runs, self.contest.budget) for runs in rows]
        return np.array(times).reshape(self.evaluations.shape[:-1])

    def distribution(self, optimiser: str) -> tuple[FloatArray, FloatArray]:
        """Return the share of (problem, target, run) that a search has solved over evaluations.

        Parameters
        ----------
        optimiser
            Its name.

        Returns
        -------
        tuple of ndarray
            As of `empirical_distribution`.
        """
        return empirical_distribution(self.evaluations[self._place(optimiser)])

    def effect(self, optimiser: str, target: float, problem: Problem | None = None) -> Effect:
        """Return how soon a search reaches a target, compared with the first one.

        Parameters
        ----------
        optimiser
            Its name.
        target
            One of the contest's.
        problem
            One of the contest's; by default all, equally weighted.
        """
        problems = self.contest.problems
        which = range(len(problems)) if problem is None else [problems.index(problem)]
        row = self.contest.targets.index(target)
        mine, theirs = self.evaluations[self._place(optimiser)], self.evaluations[0]
        return effect_size([mine[p, row] for p in which], [theirs[p, row] for p in which])

    def _place(self, optimiser: str) -> int:
        """Return where an optimiser stands in the contest."""
        return self.contest.optimisers.index(optimiser)
