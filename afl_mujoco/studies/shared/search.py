"""Searches that know nothing of cart-poles: where a property is lost; a cube's best point."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from afl_mujoco.errors import require_count

# --- a threshold: a scan on a logarithmic grid, then bisection ------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Threshold:
    """Where a property is lost on the way from a benign level to a harsh one."""

    # harshest level such that it and every more benign level tried hold; None if none holds
    holds_at: float | None
    fails_at: float | None  # most benign level found at which it does not hold; None if all hold


def find_threshold(
    holds: Callable[[float], bool],
    scan: list[float],
    tolerance: float,
    snapped: Callable[[float], float] = lambda level: level,
    *,
    closer: int = 0,
) -> Threshold:
    """Return where a property is lost, to a relative width; `closer` levels beside it must hold."""
    known: dict[float, bool] = {}

    def tried(level: float) -> bool:
        if level not in known:
            known[level] = holds(level)
        return known[level]

    levels = list(dict.fromkeys(snapped(level) for level in scan))
    found = [tried(level) for level in levels]
    if all(found):
        return Threshold(holds_at=levels[-1], fails_at=None)
    first = found.index(False)
    if first == 0:
        return Threshold(holds_at=None, fails_at=levels[0])
    benign, good, bad = levels[0], levels[first - 1], levels[first]
    while _apart(bad, good) > math.log1p(tolerance):
        middle = snapped(math.sqrt(good * bad))
        if middle in (good, bad):
            break
        if tried(middle):
            good = middle
        else:
            bad = middle
    ratio = math.sqrt(1.0 + tolerance) ** (1 if benign > levels[-1] else -1)
    good, bad = _descended(tried, good, bad, benign, ratio, snapped, closer)
    return Threshold(holds_at=good, fails_at=bad)


def _descended(
    holds: Callable[[float], bool],
    good: float,
    bad: float,
    benign: float,
    ratio: float,
    snapped: Callable[[float], float],
    closer: int,
) -> tuple[float, float]:
    """Move a bracket to the benign side until the `closer` levels beside it hold."""
    level, clean, lost = good, 0, False
    while clean < closer:
        level *= ratio
        at = snapped(level) if _apart(level, bad) < _apart(benign, bad) else benign
        if not holds(at):
            bad, clean, lost = at, 0, True
            continue
        if lost:
            good, lost = at, False
        if at == benign:
            break
        clean += 1
    return good, bad


def _apart(level: float, other: float) -> float:
    return abs(math.log(level / other))


# --- the unit cube, by CMA-ES ---------------------------------------------------------------------

Point = NDArray[np.float64]
MOST_GENERATIONS, MOST_POPULATION = 100_000, 10_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Budget:
    """How much a search may spend; it ends earlier if the strategy stops by itself."""

    generations: int = 30  # number of generations, and number of points in each
    population: int = 16

    def __post_init__(self) -> None:
        require_count("generations", self.generations, 1, MOST_GENERATIONS)
        require_count("population", self.population, 4, MOST_POPULATION)

    @property
    def points(self) -> int:
        """The largest number of points that a search tries."""
        return 1 + self.generations * self.population


def minimise(
    cost: Callable[[list[Point]], Sequence[float]],
    start: Point,
    step: float,
    rng: Generator,
    budget: Budget,
) -> tuple[Point, int]:
    """Search the unit cube by CMA-ES; return the best point and how many were tried."""
    import cma

    options = {
        "bounds": [0.0, 1.0],
        "popsize": budget.population,
        "maxiter": budget.generations,
        "randn": lambda rows, genes: rng.standard_normal((rows, genes)),
        "seed": np.nan,  # the global generator is left alone
        "verbose": -9,
    }
    axes = len(start)
    padded = np.append(start, 0.5) if axes == 1 else start  # cma needs two
    strategy = cma.CMAEvolutionStrategy(padded, step, options)
    best, least, tried = start, cost([start])[0], 1
    while not strategy.stop():
        asked = strategy.ask()
        points = [np.clip(x[:axes], 0.0, 1.0) for x in asked]
        costs = list(cost(points))
        strategy.tell(asked, costs)
        tried += len(points)
        k = int(np.argmin(costs))
        if costs[k] < least:
            best, least = points[k], costs[k]
    return best, tried
