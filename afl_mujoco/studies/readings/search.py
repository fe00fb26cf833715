"""The readings that come nearest to Table 3: searched freely, and among round numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.studies.cube_search import Budget, minimise
from afl_mujoco.studies.paper_readings import (
    AXES,
    HORIZON,
    LABELS,
    SCALE_PHI,
    SCALE_Z,
    SCHEDULES,
    SIGNED,
    Array,
    both_errors,
    improvement_error,
    random_readings,
    readings_at,
    terms_of,
    value_error,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Goal:
    """What a reading is to come near to.

    Attributes
    ----------
    error
        Function of the objectives, shape (N, 4, 2), that returns the error of each reading.
    meaning
        What the error measures, with its unit.
    scales
        Whether the scales are free too; otherwise they are those of D4.
    """

    error: Callable[[Array], Array]
    meaning: str
    scales: bool


_POINTS = "rms difference of the four improvements [percentage points]"

GOALS: Mapping[str, Goal] = {
    "improvements-d4": Goal(error=improvement_error, meaning=_POINTS, scales=False),
    "improvements": Goal(error=improvement_error, meaning=_POINTS, scales=True),
    "values": Goal(
        error=value_error,
        meaning="rms difference of the eight objectives [%]",
        scales=True,
    ),
    "both": Goal(
        error=both_errors, meaning="root of the sum of the squares of both errors", scales=True
    ),
}
"""The goals by name."""

WIDER = 3.0
"""Factor by which the range of the logarithms of the scales is wider than for random readings."""

ROUND_TIME = 0.5
ROUND_HORIZONS = (10.0, 15.0, 20.0, 30.0)
ROUND_LEVELS = {"M": 0.1 * np.arange(1, 21), "l": 0.05 * np.arange(1, 21)}
"""The paper's own grids of M and l."""

ROUND_FACTOR = 0.1
"""Grid of log10 of the factors of the scales."""

LATEST = max(ROUND_HORIZONS)

Unit = tuple[str, int, int, Budget]
"""Goal, number of the restart, seed and budget of a search."""

Found = tuple[list[float], float, int]
"""A reading, its error, and how many readings were tried."""


def nearest(unit: Unit) -> Found:
    """Return the reading nearest to a goal, by CMA-ES from a random start.

    Labels (D2) and the sign of the largest force (D5) are taken in turn by the restarts.
    """
    name, restart, seed, budget = unit
    goal = GOALS[name]
    rng = np.random.default_rng((seed, list(GOALS).index(name), restart))
    free = [k for k in range(len(AXES)) if k not in _fixed(goal)]

    def readings(points: list[Array]) -> Array:
        cube = np.full((len(points), len(AXES)), 0.5)
        cube[:, free] = points
        cube[:, LABELS], cube[:, SIGNED] = restart % 2, restart // 2 % 2
        found = readings_at(cube)
        found[:, [SCALE_Z, SCALE_PHI]] *= WIDER
        return found

    def cost(points: list[Array]) -> list[float]:
        return _costs(goal, readings(points))

    best, tried = minimise(cost, rng.random(len(free)), 0.3, rng, budget)
    one = tidied(readings([best])[0])
    return one.tolist(), float(_costs(goal, one[None])[0]), tried


def _fixed(goal: Goal) -> tuple[int, ...]:
    """Return the unknowns that a search for a goal does not vary."""
    return (LABELS, SIGNED) if goal.scales else (LABELS, SIGNED, SCALE_Z, SCALE_PHI)


def _costs(goal: Goal, readings: Array) -> list[float]:
    """Return errors that are finite, as the search needs them."""
    errors = goal.error(terms_of(readings).objectives(readings))
    return np.minimum(errors, 1e6).tolist()  # type: ignore[no-any-return]


def tidied(one: Array) -> Array:
    """Return a reading with times in multiples of 2 ms, and its other numbers with few digits."""
    found = np.round(one, 4)
    found[HORIZON] = round(one[HORIZON], 2)
    for times, _ in SCHEDULES.values():
        found[times] = np.round(2e-3 * np.round(one[times] / 2e-3), 3)
    return found


def rounded(readings: Array, goal: Goal) -> Array:
    """Return the round readings next to others, their times still increasing."""
    found = readings.copy()
    horizons = np.array(ROUND_HORIZONS)
    nearest_horizon = np.abs(readings[:, HORIZON, None] - horizons).argmin(axis=1)
    found[:, HORIZON] = horizons[nearest_horizon]
    last = found[:, HORIZON, None] - ROUND_TIME
    for (symbol, _), (times, levels) in SCHEDULES.items():
        rank = ROUND_TIME * np.arange(len(times))  # without it equal times may stand side by side
        halves = ROUND_TIME * np.round(readings[:, times] / ROUND_TIME) - rank
        apart = np.clip(halves, ROUND_TIME, last - rank[-1])
        found[:, times] = np.maximum.accumulate(apart, axis=1) + rank
        grid = ROUND_LEVELS[symbol]
        found[:, levels] = grid[np.abs(readings[:, levels, None] - grid).argmin(axis=2)]
    scales = [SCALE_Z, SCALE_PHI]
    found[:, scales] = np.round(readings[:, scales] / ROUND_FACTOR) * ROUND_FACTOR
    if not goal.scales:
        found[:, scales] = 0.0
    return found


def sound(readings: Array) -> NDArray[np.bool_]:
    """Return which readings have increasing times before their horizon."""
    found = np.ones(len(readings), dtype=bool)
    for times, _ in SCHEDULES.values():
        instants = readings[:, times]
        found &= (np.diff(instants, axis=1) > 0.0).all(axis=1)
        found &= instants[:, -1] < readings[:, HORIZON]
    return found


def round_starts(
    name: str, found: Sequence[Found], draws: tuple[int, int], seed: int, threads: int
) -> list[list[float]]:
    """Return round readings to descend from: next to the nearest found freely, and drawn.

    Parameters
    ----------
    found
        What the free searches for the goal found.
    draws
        Number of round readings to draw, and how many of the best to return.
    """
    goal, (count, kept) = GOALS[name], draws
    nearest_found = np.array([min(found, key=lambda one: one[1])[0]])
    drawn = rounded(random_readings(count, seed), goal)
    errors = goal.error(terms_of(drawn, threads).objectives(drawn))
    best = drawn[np.argsort(errors, kind="stable")[:kept]]
    return [*rounded(nearest_found, goal).tolist(), *best.tolist()]


RoundUnit = tuple[str, list[float]]
"""Goal and start of a descent among round readings."""


def descend(unit: RoundUnit) -> Found:
    """Return the round reading that no change of one unknown brings nearer to a goal."""
    name, start = unit
    goal, best = GOALS[name], np.array(start)
    least, tried = _costs(goal, best[None])[0], 1
    alternatives = {k: _alternatives(k) for k in range(len(AXES))}
    if not goal.scales:
        del alternatives[SCALE_Z], alternatives[SCALE_PHI]
    while True:
        before = least
        for k, values in alternatives.items():
            others = np.repeat(best[None], len(values), axis=0)
            others[:, k] = values
            for times, _ in SCHEDULES.values():
                others[:, times] = np.sort(others[:, times], axis=1)
            others = others[sound(others)]
            costs = _costs(goal, others)
            tried += len(others)
            if len(others) and min(costs) < least:
                least = min(costs)
                best = others[int(np.argmin(costs))]
        if least == before:
            return best.tolist(), least, tried


def _alternatives(k: int) -> NDArray[Any]:
    """Return the round values of an unknown."""
    axis = AXES[k]
    if axis.kind == "time":
        return np.arange(ROUND_TIME, LATEST, ROUND_TIME)
    if axis.kind == "horizon":
        return np.array(ROUND_HORIZONS)
    if axis.kind == "scale":
        end = round(WIDER * axis.high / ROUND_FACTOR)
        return ROUND_FACTOR * np.arange(-end, end + 1)
    return np.array([0.0, 1.0]) if axis.kind == "choice" else ROUND_LEVELS[axis.kind]


def round_count() -> int:
    """Return how many round readings there are, without the choice of scales."""
    total = 0
    for horizon in ROUND_HORIZONS:
        times = round(horizon / ROUND_TIME) - 1
        each = 1
        for instants, levels in SCHEDULES.values():
            ways = np.prod([(times - k) / (k + 1) for k in range(len(instants))])
            each *= round(float(ways)) * 20 ** len(levels)
        total += each
    return 4 * total
