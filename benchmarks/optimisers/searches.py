"""The optimisers that are compared: each searches a box until its cost raises `Finished`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import count
from types import MappingProxyType
from typing import Any, NoReturn

import cma
import numpy as np
from numpy.random import Generator, default_rng
from numpy.typing import NDArray
from scipy.optimize import Bounds, differential_evolution

from afl_mujoco.studies.gain_tuning.genetic import MultipleCrossoverGA
from afl_mujoco.studies.gain_tuning.settings import Box, GeneticSettings

FloatArray = NDArray[np.float64]
Cost = Callable[[FloatArray], FloatArray]
Search = Callable[[Cost, Box, tuple[int, ...]], NoReturn]

SMALL_POPULATION = 60  # of the smaller entries of the genetic algorithm

DE_SETTINGS: Mapping[str, Any] = MappingProxyType(
    {  # the defaults of scipy.optimize.differential_evolution
        "strategy": "best1bin",
        "popsize": 15,
        "mutation": (0.5, 1.0),
        "recombination": 0.7,
        "init": "latinhypercube",
    }
)

CMA_SETTINGS: Mapping[str, Any] = MappingProxyType({"sigma0": 0.25, "restart_popsize_factor": 2})
"""Initial step in widths of the box; growth of the population at a restart (IPOP-CMA-ES)."""

RANDOM_BATCH = 1000


class Finished(Exception):
    """Raised when nothing is left to search for."""


class CountedCost:
    """A cost that records the evaluation at which each threshold was first met, and ends the
    search.

    It raises `Finished` when every threshold is reached or the budget of evaluations is spent;
    points beyond the budget are not evaluated.
    """

    def __init__(self, cost: Cost, thresholds: Sequence[float], budget: int) -> None:
        self._cost = cost
        self._thresholds = np.array(thresholds, dtype=np.float64)
        self._budget = budget
        self.reached: FloatArray = np.full(len(self._thresholds), np.inf)  # counted from 1
        self.spent = 0
        self.best = np.inf

    def __call__(self, points: FloatArray) -> FloatArray:
        """Return the costs, shape (n,), of points, shape (n, D)."""
        costs = self._cost(points[: self._budget - self.spent])
        met = costs[:, None] <= self._thresholds
        new = met.any(axis=0) & np.isinf(self.reached)
        self.reached[new] = self.spent + 1 + np.argmax(met, axis=0)[new]
        self.spent += len(costs)
        self.best = min(self.best, float(costs.min()))
        if self.spent >= self._budget or np.isfinite(self.reached).all():
            raise Finished
        return costs


@dataclass(frozen=True, slots=True, eq=False)
class Optimiser:
    """An optimiser to compare: `search(cost, box, seed)`, and its settings as plain data."""

    search: Search
    settings: Mapping[str, Any]


def _genetic(settings: GeneticSettings) -> Optimiser:
    """Return the paper's search, which continues beyond its number of generations."""

    def search(cost: Cost, box: Box, seed: tuple[int, ...]) -> NoReturn:
        breeding = MultipleCrossoverGA(box, settings, seed)
        while True:
            breeding.tell(cost(breeding.ask()))

    described = asdict(settings)
    del described["generations"]
    return Optimiser(search, described)


def _restarted(run: Callable[[Cost, Box, Generator, int], object]) -> Search:
    """Return a search that restarts with other random numbers whenever it ends by itself."""

    def search(cost: Cost, box: Box, seed: tuple[int, ...]) -> NoReturn:
        for restart in count():
            run(cost, box, default_rng((*seed, restart)), restart)
        raise AssertionError("unreachable")

    return search


def _differential_evolution(cost: Cost, box: Box, rng: Generator, restart: int) -> None:
    """Search until the population is one point."""
    differential_evolution(
        lambda points: cost(np.ascontiguousarray(points.T)),
        Bounds(np.array(box.lower), np.array(box.upper)),
        maxiter=10**9,
        tol=0.0,
        polish=False,
        updating="deferred",
        vectorized=True,
        rng=rng,
        **DE_SETTINGS,
    )


def _cma_es(cost: Cost, box: Box, rng: Generator, restart: int) -> None:
    """Search from the middle of the box until the strategy's own criteria end it."""
    lower, upper = np.array(box.lower), np.array(box.upper)
    options = {
        "bounds": [box.lower, box.upper],
        "CMA_stds": upper - lower,
        "popsize_factor": CMA_SETTINGS["restart_popsize_factor"] ** restart,
        "randn": lambda rows, genes: rng.standard_normal((rows, genes)),
        "seed": np.nan,  # the global generator is left alone
        "verbose": -9,
    }
    strategy = cma.CMAEvolutionStrategy((lower + upper) / 2.0, CMA_SETTINGS["sigma0"], options)
    while not strategy.stop():
        points = strategy.ask()
        strategy.tell(points, cost(np.array(points)).tolist())


def _random(cost: Cost, box: Box, rng: Generator, restart: int) -> None:
    """Draw points uniformly."""
    lower, upper = np.array(box.lower), np.array(box.upper)
    while True:
        cost(lower + (upper - lower) * rng.random((RANDOM_BATCH, len(lower))))


OPTIMISERS: Mapping[str, Optimiser] = MappingProxyType(
    {
        **{
            f"{kind} GA, Np = {size}": _genetic(
                GeneticSettings(population_size=size, parents=parents)
            )
            for kind, parents in (("multiple-crossover", 3), ("two-parent", 2))
            for size in (GeneticSettings().population_size, SMALL_POPULATION)
        },
        "differential evolution": Optimiser(_restarted(_differential_evolution), DE_SETTINGS),
        "CMA-ES": Optimiser(_restarted(_cma_es), CMA_SETTINGS),
        "random search": Optimiser(_restarted(_random), {"batch": RANDOM_BATCH}),
    }
)
"""Optimisers by name. The first is the paper's; the others are compared with it."""
