"""The paper's multiple-crossover genetic algorithm, with an ask-and-tell interface."""

from __future__ import annotations

import math
import time
from array import array
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import final

import numpy as np
from numpy.random import PCG64, Generator
from numpy.typing import ArrayLike, NDArray

from afl_mujoco.errors import AflMujocoError, InvalidValueError, reading
from afl_mujoco.studies.gain_tuning import checkpoint as files
from afl_mujoco.studies.gain_tuning.operators import clip, multiple_crossover, mutate, tournament
from afl_mujoco.studies.gain_tuning.settings import Box, GeneticSettings, Seed, require_seed

__all__ = ["Box", "GeneticSettings", "MultipleCrossoverGA", "SearchResult", "Seed", "minimise"]

FloatArray = NDArray[np.float64]

CHECKPOINT_INTERVAL = 1.0
"""Time between two checkpoints [s]: a killed search loses at most this and one generation."""


@final
class MultipleCrossoverGA:
    """The search, by ask and tell: repeat `ask` for chromosomes and `tell` for their costs.

    The first round is a population drawn uniformly in the box. In every other round, a random
    permutation of the population gives groups, which are replaced by their children (A1), and then
    chromosomes that are mutated (A2). The rest of the next generation are copies, selected by
    tournament from the whole population, which keep their cost. The first copy is always that of
    the best chromosome: the paper is silent on such elitism, but without it the best could be lost.

    Parameters
    ----------
    box
        The search box; genes that leave it are clipped.
    settings
        Settings of the search.
    seed
        An int, or a tuple of ints; the same seed gives the same bits.

    Attributes
    ----------
    problem
        Settings, bounds and seed by name.
    generation
        Generations bred so far; 0 is the initial population.
    evaluations
        Costs evaluated so far.
    population, costs
        Chromosomes, shape (P, D), and their costs, shape (P,); empty before the first `tell`.
    """

    def __init__(self, box: Box, settings: GeneticSettings, seed: Seed) -> None:
        self.box = box
        self.settings = settings
        self.seed = require_seed(seed)
        self.problem = {**asdict(settings), **asdict(box), "seed": self.seed}
        self.generation = 0
        self.evaluations = 0
        self.population: FloatArray = np.empty((0, len(box.lower)))
        self.costs: FloatArray = np.empty(0)
        self._lower, self._upper = np.array(box.lower), np.array(box.upper)
        self._rng = Generator(PCG64(self.seed))
        self._copies: NDArray[np.intp] = np.empty(0, dtype=np.intp)
        self._asked: FloatArray | None = None
        self._history = array("d")

    @property
    def best(self) -> FloatArray:
        """The best chromosome so far, shape (D,)."""
        best: FloatArray = self.population[self._fittest()]
        return best

    @property
    def best_cost(self) -> float:
        """Cost of the best chromosome."""
        return float(self.costs[self._fittest()])

    @property
    def history(self) -> FloatArray:
        """Best cost of each generation, shape (generation + 1,)."""
        return np.array(self._history)

    @property
    def finished(self) -> bool:
        """Whether all generations of the settings were bred."""
        return self.evaluations > 0 and self.generation >= self.settings.generations

    def ask(self) -> FloatArray:
        """Return the chromosomes whose costs are wanted, shape (n, D); the same until `tell`."""
        if self._asked is None:
            chromosomes = self._bred() if self.evaluations else self._drawn()
            self._asked = clip(chromosomes, self._lower, self._upper)
        return self._asked.copy()

    def tell(self, costs: ArrayLike) -> None:
        """Take the costs of the chromosomes that `ask` returned, and end the generation.

        Parameters
        ----------
        costs
            Finite costs, shape (n,).
        """
        if self._asked is None:
            raise AflMujocoError("tell", "must follow ask")
        values = _require_costs(costs, self._asked)
        self.generation += self.evaluations > 0
        self.evaluations += len(values)
        self._settle(
            np.concatenate((self.population[self._copies], self._asked)),
            np.concatenate((self.costs[self._copies], values)),
        )
        self._history.append(self.best_cost)
        self._asked = None

    def state(self) -> files.SearchState:
        """Return all that decides how the search continues."""
        if self._asked is not None or not self.evaluations:
            raise AflMujocoError("state", "is complete only after tell")
        return files.SearchState(
            problem=self.problem,
            generation=self.generation,
            evaluations=self.evaluations,
            rng=dict(self._rng.bit_generator.state),
            population=self.population,
            costs=self.costs,
            history=self.history,
        )

    def restore(self, state: files.SearchState) -> None:
        """Continue from a state of the same problem, bit for bit."""
        self.generation, self.evaluations = state.generation, state.evaluations
        self._rng.bit_generator.state = dict(state.rng)
        self._settle(state.population.copy(), state.costs.copy())
        self._history = array("d", state.history.tolist())
        self._asked = None

    def _fittest(self) -> int:
        """Return the index of the best chromosome."""
        if not self.evaluations:
            raise AflMujocoError("best", "is not known before the first tell")
        return int(np.argmin(self.costs))

    def _settle(self, population: FloatArray, costs: FloatArray) -> None:
        """Make a generation the current one, read-only."""
        population.flags.writeable = costs.flags.writeable = False
        self.population, self.costs = population, costs

    def _drawn(self) -> FloatArray:
        """Return the initial population."""
        size = (self.settings.population_size, len(self._lower))
        drawn: FloatArray = self._lower + (self._upper - self._lower) * self._rng.random(size)
        return drawn

    def _bred(self) -> FloatArray:
        """Return children and mutants of the current generation, and choose the copies."""
        settings, rng = self.settings, self._rng
        order = rng.permutation(settings.population_size)
        crossed = settings.groups * settings.parents
        groups = order[:crossed].reshape(settings.groups, settings.parents)
        chosen = order[crossed : crossed + settings.mutants]
        children = multiple_crossover(self.population, self.costs, groups, rng)
        mutants = mutate(self.population[chosen], settings.mutation_constant, rng)
        selected = tournament(self.costs, settings.copies - 1, rng)
        self._copies = np.concatenate(([self._fittest()], selected))
        return np.concatenate((children.reshape(crossed, -1), mutants))


def _require_costs(costs: ArrayLike, chromosomes: FloatArray) -> FloatArray:
    """Return the costs of `chromosomes` as an array, or raise unless they are finite numbers."""
    try:
        values = np.array(costs, dtype=np.float64)
    except (TypeError, ValueError):
        raise InvalidValueError("costs", "must be numbers", repr(costs)) from None
    if values.shape != (len(chromosomes),):
        raise InvalidValueError("costs", f"must have shape ({len(chromosomes)},)", values.shape)
    finite = np.isfinite(values)
    if not finite.all():
        worst = int(np.argmin(finite))
        place = ", ".join(f"{x:.6g}" for x in chromosomes[worst])
        raise InvalidValueError(f"cost of ({place})", "must be finite", values[worst])
    return values


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SearchResult:
    """What a search found.

    Attributes
    ----------
    best
        The best chromosome, shape (D,).
    cost
        Its cost.
    evaluations, generations
        Numbers of evaluations and generations that it took.
    history
        Best cost of each generation, shape (generations + 1,), from the initial population on.
    """

    best: FloatArray
    cost: float
    evaluations: int
    generations: int
    history: FloatArray


def minimise(
    cost: Callable[[FloatArray], ArrayLike],
    box: Box,
    settings: GeneticSettings,
    seed: Seed,
    *,
    checkpoint: Path | None = None,
    resume: bool = False,
    progress: Callable[[int, float], None] | None = None,
) -> SearchResult:
    """Search the box for the chromosome of least cost.

    Parameters
    ----------
    cost
        Function that returns finite costs, shape (n,), of chromosomes, shape (n, D).
    checkpoint
        File that is written after the first generation, after the last, and in between every
        `CHECKPOINT_INTERVAL`; its folder must exist.
    resume
        Continue from the checkpoint, to the same bits as without a break; start if there is none.
        The checkpoint knows settings, bounds and seed but not `cost`: problems that differ only in
        their cost need separate files, or separate seeds.
    """
    search = MultipleCrossoverGA(box, settings, seed)
    if checkpoint is not None:
        _begin(search, checkpoint, resume)
    elif resume:
        raise InvalidValueError("resume", "needs a checkpoint", checkpoint)
    due = -math.inf
    while not search.finished:
        search.tell(cost(search.ask()))
        if checkpoint is not None and (search.finished or time.monotonic() >= due):
            files.save(checkpoint, search.state())
            due = time.monotonic() + CHECKPOINT_INTERVAL
        if progress is not None:
            progress(search.generation, search.best_cost)
    return SearchResult(
        best=search.best,
        cost=search.best_cost,
        evaluations=search.evaluations,
        generations=search.generation,
        history=search.history,
    )


def _begin(search: MultipleCrossoverGA, checkpoint: Path, resume: bool) -> None:
    """Resume a fresh search from its checkpoint, or raise if there is one that must not be lost."""
    if not resume:
        files.refuse_existing(checkpoint)
    elif (state := files.resume(checkpoint, search.problem)) is not None:
        with reading(checkpoint, files.WRONG, files.THEN):
            search.restore(state)
