"""What is compared: optimisers, problems, targets, runs and budget."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from afl_mujoco.errors import InvalidValueError, UnknownNameError
from afl_mujoco.scenario.parameters import require_finite
from afl_mujoco.tuning.referee.optimisers import OPTIMISERS
from afl_mujoco.tuning.referee.problems import PROBLEMS, RESOLUTION, Problem
from afl_mujoco.tuning.settings import Seed, require_seed

TARGETS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5)


@dataclass(frozen=True, slots=True, kw_only=True)
class Contest:
    """What is compared, and how; the defaults are those of the shipped result.

    Attributes
    ----------
    optimisers
        Names of `OPTIMISERS`; the others are compared with the first.
    problems
        The plants.
    targets
        How near to the optimal cost f a search must come: to f (1 + target); decreasing.
    runs
        Runs of each optimiser on each problem, each from a seed of its own.
    budget
        Evaluations of the cost that a run may spend.
    seed
        Of them all; a run gives the same whatever else is in the contest.
    """

    optimisers: tuple[str, ...] = tuple(OPTIMISERS)
    problems: tuple[Problem, ...] = PROBLEMS
    targets: tuple[float, ...] = TARGETS
    runs: int = 51
    budget: int = 100_000
    seed: Seed = 0

    def __post_init__(self) -> None:
        """Check each part."""
        for name in ("optimisers", "problems", "targets"):
            object.__setattr__(self, name, _require_distinct(name, getattr(self, name)))
        for name in self.optimisers:
            if name not in OPTIMISERS:
                raise UnknownNameError.among("optimiser", name, OPTIMISERS)
        targets = tuple(require_finite("target", target) for target in self.targets)
        if targets[-1] < RESOLUTION:
            rule = f"must be at least {RESOLUTION}, as well as an optimal cost is known"
            raise InvalidValueError("target", rule, targets[-1])
        for before, after in pairwise(targets):
            if after >= before:
                raise InvalidValueError("targets", "must decrease", f"{after} after {before}")
        object.__setattr__(self, "targets", targets)
        for name in ("runs", "budget"):
            number = getattr(self, name)
            if isinstance(number, bool) or not isinstance(number, int | np.integer) or number < 1:
                raise InvalidValueError(name, "must be a whole number of at least 1", repr(number))
            object.__setattr__(self, name, int(number))
        object.__setattr__(self, "seed", require_seed(self.seed))

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Numbers of optimisers, problems, targets and runs."""
        return len(self.optimisers), len(self.problems), len(self.targets), self.runs


def _require_distinct(thing: str, values: Sequence[object]) -> tuple[object, ...]:
    """Return `values` as a tuple, or raise unless there are some and no two are the same."""
    if not values:
        raise InvalidValueError(thing, "must hold at least one")
    if len(set(values)) != len(values):
        raise InvalidValueError(thing, "must differ", ", ".join(map(str, values)))
    return tuple(values)
