"""What the study of readings finds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.studies.paper_readings import (
    AXES,
    CASES,
    Array,
    improvements,
    scaled,
    scenario_of,
    terms_of,
)
from afl_mujoco.studies.paper_tables import Fit
from afl_mujoco.studies.readings.optima import Optima
from afl_mujoco.studies.readings.search import GOALS, Found
from afl_mujoco.studies.readings.sensitivity import Sensitivity


@dataclass(frozen=True, slots=True, kw_only=True)
class FittedReading:
    """The reading found nearest to a goal.

    Attributes
    ----------
    name, goal
        Its name, and that of the goal.
    round
        Whether its numbers are round.
    error
        Its error, in the unit of the goal.
    errors
        The errors that all restarts ended with, smallest first.
    tried
        Readings tried by all restarts together.
    values
        The unknowns by name, as in `readings_at`.
    objectives
        Objectives of the cases with fixed and adaptive gains, at the common scale that brings them
        nearest to Table 3.
    improvements
        By how much adaptive gains lower them [%].
    """

    name: str
    goal: str
    round: bool
    error: float
    errors: tuple[float, ...]
    tried: int
    values: dict[str, float]
    objectives: tuple[tuple[float, float], ...]
    improvements: tuple[float, ...]

    @property
    def vector(self) -> Array:
        """The unknowns as an array."""
        return np.array([self.values[axis.name] for axis in AXES])

    @property
    def scenarios(self) -> list[Scenario]:
        """The four cases."""
        return [scenario_of(self.vector, case, self.name) for case in CASES]


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """Readings of the paper.

    Attributes
    ----------
    seed
        Seed of everything drawn.
    readings
        The readings nearest to each goal, free and round.
    draws
        Round readings drawn for each goal before the descents.
    sensitivity
        What random readings say.
    optima
        Table 1 under each horizon and labels.
    fits
        The fits of Table 2 beside the printed rows.
    """

    seed: int
    readings: tuple[FittedReading, ...]
    draws: int
    sensitivity: Sensitivity
    optima: tuple[Optima, ...]
    fits: tuple[Fit, ...]


def named_readings(
    searched: Sequence[str],
    found: Sequence[Found],
    started: Sequence[str],
    descended: Sequence[Found],
) -> tuple[FittedReading, ...]:
    """Return the best reading of each goal, searched freely and among round numbers.

    Parameters
    ----------
    searched, started
        The goals of the searches and of the descents.
    found, descended
        What they found.
    """
    named = []
    for is_round, goals, results in ((False, searched, found), (True, started, descended)):
        for goal in GOALS:
            mine = [one for name, one in zip(goals, results, strict=True) if name == goal]
            if mine:
                named.append(_named(goal, is_round, mine))
    return tuple(named)


def _named(goal: str, is_round: bool, found: Sequence[Found]) -> FittedReading:
    """Return the best of the readings found for a goal."""
    values, error, _ = min(found, key=lambda one: one[1])
    one = np.array(values)[None]
    objectives = scaled(terms_of(one).objectives(one))
    return FittedReading(
        name=f"{'round' if is_round else 'nearest'}-{goal}",
        goal=goal,
        round=is_round,
        error=error,
        errors=tuple(sorted(error for _, error, _ in found)),
        tried=sum(tried for *_, tried in found),
        values={axis.name: float(x) for axis, x in zip(AXES, values, strict=True)},
        objectives=tuple((float(f), float(a)) for f, a in objectives[0]),
        improvements=tuple(improvements(objectives)[0].tolist()),
    )
