"""A search of the unit cube by CMA-ES that knows nothing of cart-poles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from afl_mujoco.errors import require_count

Point = NDArray[np.float64]


MOST_GENERATIONS, MOST_POPULATION = 100_000, 10_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Budget:
    """How much a search may spend; it ends earlier if the strategy stops by itself."""

    generations: int = 30  # number of generations, and number of points in each
    population: int = 16

    def __post_init__(self) -> None:
        """Check both numbers."""
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
