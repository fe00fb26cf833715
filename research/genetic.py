"""The paper's multiple-crossover genetic algorithm, by ask and tell.

It knows nothing of cart-poles. The operators are Eqs. (A1) and (A2). A search can be resumed from
its checkpoint to the same bits.
"""

from __future__ import annotations

import json
import math
import time
from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal, final

import numpy as np
from numpy.random import PCG64, Generator
from numpy.typing import ArrayLike, NDArray
from pydantic import PlainSerializer, PlainValidator

from afl_mujoco.errors import (
    AflMujocoError,
    FileError,
    InvalidValueError,
    reading,
    require_count,
)
from afl_mujoco.files import read_json, shortened, write_json

IndexArray = NDArray[np.intp]


def _array(value: object) -> NDArray[np.float64]:
    try:
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError("must be numbers in lists of equal lengths") from None


def _nested_lists(array: NDArray[np.float64]) -> Any:
    return np.where(np.isnan(array), np.array(None), array).tolist()


FloatArray = Annotated[NDArray[np.float64], PlainValidator(_array), PlainSerializer(_nested_lists)]
"""An array of floats as a field of a dataclass that is kept in a file: NaN is null there."""

ROUND_OFF = 1e-9
"""Round-off that is tolerated in a sum of shares, and in a whole number of groups."""

SHARES = ("reproduction", "crossover", "mutation")

Seed = int | tuple[int, ...]


MOST = 1_000_000
"""Most chromosomes, and most generations."""

LARGEST_SEED = 2**63 - 1


def _require_finite(thing: str, value: object) -> float:
    """Return `value` as a float, or raise unless it is a finite number."""
    try:
        if isinstance(value, bool | np.bool_ | str | bytes):
            raise TypeError
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        raise InvalidValueError(thing, "must be a number", repr(value)) from None
    if not math.isfinite(number):
        raise InvalidValueError(thing, "must be finite", number)
    return number


def require_seed(seed: object) -> Seed:
    """Return a seed, or raise unless it is one."""
    if isinstance(seed, tuple) and seed:
        return tuple(require_count("seed", part, 0, LARGEST_SEED) for part in seed)
    return require_count("seed", seed, 0, LARGEST_SEED)


@dataclass(frozen=True, slots=True, kw_only=True)
class GeneticSettings:
    """Settings of the search; the defaults are the paper's."""

    population_size: int = 1000  # chromosomes Np
    generations: int = 1000  # generations bred from the initial population
    # shares Pr, Pc, Pm of the next generation that are copied, crossed and mutated; their sum is 1.
    # If the last group cannot be filled, copies take its place
    reproduction: float = 0.45
    crossover: float = 0.45
    mutation: float = 0.1
    mutation_constant: float = 1e-7  # c of Eq. (A2), in the unit of the genes
    # chromosomes in a group of Eq. (A1): 3 in the paper; 2 gives two-parent crossover
    parents: int = 3

    def __post_init__(self) -> None:
        """Check each value, and the values in combination."""
        for name, least in (("population_size", 1), ("generations", 1), ("parents", 2)):
            object.__setattr__(self, name, require_count(name, getattr(self, name), least, MOST))
        for name in (*SHARES, "mutation_constant"):
            object.__setattr__(self, name, _require_finite(name, getattr(self, name)))
        if not self.mutation_constant > 0.0:
            raise InvalidValueError("mutation_constant", "must be positive", self.mutation_constant)
        self._check_shares()
        for what, there in (
            (f"a group of {self.parents}", self.groups or not self.crossover),
            ("a mutant", self.mutants or not self.mutation),
            ("a copy of the best", self.copies >= 1),
        ):
            if not there:
                rule = f"must be large enough for {what}"
                raise InvalidValueError("population_size", rule, self.population_size)

    def _check_shares(self) -> None:
        """Raise unless the shares add up to 1 and leave room for something new."""
        shares = {name: getattr(self, name) for name in SHARES}
        for name, share in shares.items():
            if not 0.0 <= share <= 1.0:
                raise InvalidValueError(name, "must lie in [0, 1]", share)
        if abs((total := sum(shares.values())) - 1.0) > ROUND_OFF:
            raise InvalidValueError(" + ".join(shares), "must be 1", total)
        if not (self.crossover or self.mutation):
            raise InvalidValueError(
                "reproduction", "must leave a share for crossover or mutation", self.reproduction
            )

    @property
    def groups(self) -> int:
        """Groups crossed in a generation."""
        exact = self.crossover * self.population_size / self.parents
        return math.floor(exact + ROUND_OFF)

    @property
    def mutants(self) -> int:
        """Chromosomes mutated in a generation."""
        return round(self.mutation * self.population_size)

    @property
    def copies(self) -> int:
        """Chromosomes copied in a generation."""
        return self.population_size - self.groups * self.parents - self.mutants


@dataclass(frozen=True, slots=True)
class Box:
    """Bounds of the search; a gene whose bounds are equal stays fixed."""

    lower: tuple[float, ...]  # lower and upper bounds of the D genes
    upper: tuple[float, ...]

    def __post_init__(self) -> None:
        """Check the bounds."""
        for field in fields(self):
            bounds: Sequence[float] = getattr(self, field.name)
            checked = tuple(_require_finite(f"{field.name}[{i}]", x) for i, x in enumerate(bounds))
            object.__setattr__(self, field.name, checked)
        if not self.lower:
            raise InvalidValueError("lower", "must have at least one bound", self.lower)
        if len(self.lower) != len(self.upper):
            rule = f"must be as long as lower, which has {len(self.lower)}"
            raise InvalidValueError("upper", rule, len(self.upper))
        for i, (low, high) in enumerate(zip(self.lower, self.upper, strict=True)):
            if low > high:
                raise InvalidValueError(f"upper[{i}]", f"must not be below lower {low}", high)


def tournament(costs: FloatArray, count: int, rng: Generator) -> IndexArray:
    """Select by fitness, `count` times: the cheaper of two chromosomes drawn at random.

    The paper only says "reproduction"; the binary tournament is a decision of this project. It
    depends only on the order of the costs. A chromosome may be drawn against itself.
    """
    first, second = rng.integers(len(costs), size=(2, count))
    winners: IndexArray = np.where(costs[first] <= costs[second], first, second)
    return winners


def multiple_crossover(
    population: FloatArray, costs: FloatArray, groups: IndexArray, rng: Generator
) -> FloatArray:
    """Move every chromosome of a group along the sum of the ways to its fittest, Eq. (A1).

    With `i` the fittest of a group of n, ``x_q' = x_q + rho_q sum_j (x_i - x_j)`` for each q in it,
    `i` included. For n = 3 that is the paper's ``2 x_i - x_j - x_k``; for n = 2 the usual crossover
    of two parents, ``x_i - x_j``. The paper calls each of rho_1, rho_2, rho_3 "a random value": one
    scalar per chromosome, the same for all its genes, so that a child lies on a line.

    population: Chromosomes, shape (P, D).
    costs: Their costs, shape (P,); among equal costs, the first of a group counts as its fittest.
    groups: Indices of the parents, shape (G, n).
    Returns FloatArray: Children, shape (G, n, D), in the places of their parents; not clipped.
    """
    parents = population[groups]
    best = np.argmin(costs[groups], axis=1)
    fittest = parents[np.arange(len(groups)), best]
    direction = np.sum(fittest[:, np.newaxis] - parents, axis=1, keepdims=True)
    moved: FloatArray = parents + rng.random((*groups.shape, 1)) * direction
    return moved


def mutate(chromosomes: FloatArray, constant: float, rng: Generator) -> FloatArray:
    """Shift every chromosome at random, Eq. (A2): ``x' = x + rho c``.

    The paper calls rho "a random value": one scalar per chromosome, as in (A1), so that all its
    genes shift by the same amount.
    """
    return chromosomes + constant * rng.uniform(-1.0, 1.0, (len(chromosomes), 1))


def clip(chromosomes: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Move every gene that left the box to the bound that it crossed."""
    return np.minimum(np.maximum(chromosomes, lower), upper)


WRONG, THEN = "is not a valid checkpoint", "remove it to start again"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SearchState:
    """A search between two generations: all that decides how it continues."""

    schema: Literal[2] = 2
    # settings, bounds and seed by name, as plain data; they may not differ on resumption
    problem: dict[str, Any]
    generation: int  # generations bred and chromosomes evaluated so far
    evaluations: int
    rng: dict[str, Any]  # state of the bit generator, as plain data
    population: FloatArray  # chromosomes, shape (P, D)
    costs: FloatArray  # their costs, shape (P,)
    history: FloatArray  # best cost of each generation, shape (generation + 1,)

    def __post_init__(self) -> None:
        """Check the shapes."""
        size = len(self.costs)
        fits = self.population.ndim == 2 and len(self.population) == size
        if not fits or self.costs.ndim != 1 or self.history.shape != (self.generation + 1,):
            raise ValueError("its arrays must have consistent lengths")


_MISSING = object()


def differences(there: Any, here: Any, place: str = "") -> list[str]:
    """Return the differences of two pieces of plain data, a line for each part, with its name."""
    if isinstance(there, Mapping) and isinstance(here, Mapping):
        parts = [
            (there.get(name, _MISSING), here.get(name, _MISSING), f"{place}.{name}")
            for name in dict.fromkeys((*here, *there))
        ]
    elif isinstance(there, list) and isinstance(here, list) and len(there) == len(here):
        parts = [(*pair, f"{place}[{i}]") for i, pair in enumerate(zip(there, here, strict=True))]
    elif there == here and type(there) is type(here):
        return []
    else:
        was, now = ("missing" if x is _MISSING else shortened(x) for x in (there, here))
        return [f"{place.removeprefix('.')} is {was} there and {now} here"]
    return [line for part in parts for line in differences(*part)]


def save_state(path: Path, state: SearchState) -> None:
    """Write a checkpoint, whole or not at all, into a folder that exists."""
    write_json(path, state, indent=None)


def refuse_existing(path: Path) -> None:
    """Raise FileError if a search left a checkpoint at `path`."""
    if path.exists():
        raise FileError(str(path), "exists: pass resume=True to continue from it, or remove it")


def resumed_state(path: Path, problem: Mapping[str, Any]) -> SearchState | None:
    """Return where the search of `problem` stopped; ``None`` if it left no checkpoint.

    Raise FileError if the checkpoint is invalid or of another problem; it is left as it is.
    """
    if not path.exists():
        return None
    state = read_json(path, SearchState, WRONG, THEN)
    if found := differences(state.problem, json.loads(json.dumps(problem))):
        rule = f"is of another search: {', '.join(found)}; use the same values, or another file"
        raise FileError(str(path), rule)
    return state


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

    problem: Settings, bounds and seed by name.
    generation: Generations bred so far; 0 is the initial population.
    evaluations: Costs evaluated so far.
    population, costs: Chromosomes, shape (P, D), and their costs, shape (P,); empty before the
        first `tell`.
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
        """Take the costs of the chromosomes that `ask` returned, and end the generation."""
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

    def state(self) -> SearchState:
        """Return all that decides how the search continues."""
        if self._asked is not None or not self.evaluations:
            raise AflMujocoError("state", "is complete only after tell")
        return SearchState(
            problem=self.problem,
            generation=self.generation,
            evaluations=self.evaluations,
            rng=dict(self._rng.bit_generator.state),
            population=self.population,
            costs=self.costs,
            history=self.history,
        )

    def restore(self, state: SearchState) -> None:
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
    """What a search found."""

    best: FloatArray  # the best chromosome, shape (D,)
    cost: float  # its cost
    evaluations: int  # numbers of evaluations and generations that it took
    generations: int
    # best cost of each generation, shape (generations + 1,), from the initial population on
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

    cost: Function that returns finite costs, shape (n,), of chromosomes, shape (n, D).
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
            save_state(checkpoint, search.state())
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
        refuse_existing(checkpoint)
    elif (state := resumed_state(checkpoint, search.problem)) is not None:
        with reading(checkpoint, WRONG, THEN):
            search.restore(state)
