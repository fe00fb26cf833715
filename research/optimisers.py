"""The contest of optimisers: does the paper's find the optimal gains, and which is the fastest.

Run: python -m research.optimisers [--runs 51] [--budget 100000] [--workers 2] [--out DIR]

Every optimiser searches the same box on the same plants, from a seed of its own in each run, until
it comes within the last target of the optimal cost or has spent its budget of evaluations. With
--out, DIR receives the result, optimisers.json, and the figure optimisers.png. The default settings
take some minutes on two cores; the result does not depend on the number of workers.
"""

from __future__ import annotations

import argparse
import functools
import json
import math
import platform
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from itertools import count, product
from pathlib import Path
from types import MappingProxyType
from typing import Any, NoReturn
from zlib import crc32

import cma
import numpy as np
from numpy.random import Generator, default_rng
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import Bounds, differential_evolution, minimize
from scipy.stats import binomtest, bootstrap, mannwhitneyu, qmc

from afl_mujoco.control.gains import GAIN_NAMES
from afl_mujoco.errors import AflMujocoError, InvalidValueError, reading
from afl_mujoco.files import output_folder, write_text
from afl_mujoco.pool import compute_all, open_executor
from afl_mujoco.report.figures import save_figure
from research.batch import closed_loop_terms, penalised_objective
from research.command import Parser, run_command
from research.gain_tuning import GAIN_BOX, HORIZON, Cost, gain_cost, paper_scales
from research.genetic import Box, FloatArray, GeneticSettings, MultipleCrossoverGA

Search = Callable[[Cost, Box, tuple[int, ...]], NoReturn]

RESOLUTION = 1e-6
"""Relative accuracy of an optimal cost: a tighter tolerance of the simulation moves it by up to
8e-7. A target nearer to the optimum than that is meaningless."""

TIGHT_TOLERANCE = 1e-8
"""Local error of a step at which the optimum is refined; the searches have 2e-6."""

DESIGN_SIZE = 4096
"""Points of the design from which the refinement starts."""

POLISHES: tuple[tuple[Any, Any], ...] = (
    ("Nelder-Mead", {"xatol": 1e-6, "fatol": 1e-9}),
    ("L-BFGS-B", {"eps": 1e-5}),
)
"""Local searches that refine the optimum, on a box scaled to a unit cube."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Problem:
    """The search for the gains of one plant, M [kg] and l [m], in the box of decision D8."""

    cart_mass: float
    half_length: float

    @property
    def label(self) -> str:
        """The plant in words."""
        return f"M = {self.cart_mass:g} kg, l = {self.half_length:g} m"

    @property
    def cost(self) -> Cost:
        """The cost that the searches see."""
        return gain_cost(self.cart_mass, self.half_length)

    @property
    def tight_cost(self) -> Cost:
        """The same cost from a simulation of a tighter tolerance."""

        def cost(gains: NDArray[np.float64]) -> NDArray[np.float64]:
            plant = (self.cart_mass, self.half_length)
            terms = closed_loop_terms(gains, plant, duration=HORIZON, tolerance=TIGHT_TOLERANCE)
            return penalised_objective(terms, paper_scales(), HORIZON)

        return cost


PROBLEMS = tuple(
    Problem(cart_mass=mass, half_length=length)
    for mass, length in ((1.0, 0.5), (2.0, 1.0), (0.1, 0.65), (0.5, 0.2), (0.1, 0.05))
)
"""Plants; the optimal lambda is inside the box for the first three, else on its bound."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Optimum:
    """The optimal gains (K, lambda, Phi), their cost as the searches see it, and the tight cost."""

    gains: tuple[float, float, float]
    cost: float
    tight_cost: float


@functools.cache
def known_optimum(problem: Problem) -> Optimum:
    """Return the best that local searches find, started in each octant of the box.

    The start in an octant is its best point of a Sobol' design.
    """
    lower, upper = np.array(GAIN_BOX.lower), np.array(GAIN_BOX.upper)
    tight = problem.tight_cost

    def gains_at(unit: NDArray[np.float64]) -> NDArray[np.float64]:
        gains: NDArray[np.float64] = np.clip(lower + (upper - lower) * unit, lower, upper)
        return gains

    def cost_at(unit: NDArray[np.float64]) -> float:
        return float(tight(gains_at(unit)[None])[0])

    design = qmc.Sobol(len(lower), scramble=False).random(DESIGN_SIZE)
    costs = problem.cost(gains_at(design))
    octants = (design > 0.5) @ (1, 2, 4)
    starts = [min(np.flatnonzero(octants == k), key=costs.__getitem__) for k in range(8)]
    unit_cube = [(0.0, 1.0)] * len(lower)
    found = [
        minimize(cost_at, design[start], method=method, bounds=unit_cube, options=options)
        for start in starts
        for method, options in POLISHES
    ]
    best = gains_at(min(found, key=lambda end: end.fun).x)
    switching, slope, boundary_layer = best.tolist()
    return Optimum(
        gains=(switching, slope, boundary_layer),
        cost=float(problem.cost(best[None])[0]),
        tight_cost=float(tight(best[None])[0]),
    )


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
    """A cost that records when each threshold was first met, and ends the search.

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

    def costs_of(points: Any) -> Any:
        return cost(np.ascontiguousarray(points.T))

    differential_evolution(
        costs_of,
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


CONFIDENCE = 0.95
RESAMPLES = 2000


def expected_running_time(evaluations: ArrayLike, budget: int) -> float:
    """Return the fixed-target expected running time (ERT), in evaluations.

    All that the runs, shape (R,), spent, up to the target or to the budget, over the number that
    reached it: what it takes on average to reach it with a restart after each failure. Infinite if
    no run reached it. N. Hansen et al., COCO: Performance Assessment, 2016.
    """
    taken = np.asarray(evaluations, dtype=np.float64)
    solved = int(np.isfinite(taken).sum())
    return float(np.minimum(taken, budget).sum() / solved) if solved else float("inf")


def empirical_distribution(evaluations: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return where the share of solved (problem, target, run) rises, and the share from then on."""
    taken = np.ravel(np.asarray(evaluations, dtype=np.float64))
    values, counts = np.unique(taken[np.isfinite(taken)], return_counts=True)
    return values, np.cumsum(counts) / len(taken)


def superiority(evaluations: FloatArray, reference: FloatArray) -> FloatArray:
    """Return Vargha and Delaney's A12: the probability that a run is faster than one of another.

    Ties count half. 0.5: no difference; 1: always sooner; 0: never. Shapes (..., R) and (..., S)
    give shape (...).
    """
    mine, theirs = evaluations[..., :, None], reference[..., None, :]
    return np.asarray(((mine < theirs) + 0.5 * (mine == theirs)).mean(axis=(-2, -1)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Effect:
    """How a search compares with another: A12 averaged over problems, and its interval.

    `p_value` is of the two-sided Mann-Whitney test of no difference, uncorrected for the number of
    tests; ``None`` for several problems combined.
    """

    a12: float
    low: float
    high: float
    p_value: float | None


def effect_size(
    evaluations: Sequence[ArrayLike], reference: Sequence[ArrayLike], *, seed: int = 0
) -> Effect:
    """Return how a search compares with another on one problem, or on several equally weighted.

    For each problem, `evaluations` and `reference` hold those of the runs, shape (R,). The interval
    is a percentile bootstrap, resampled within each problem. Where every run of one is sooner than
    every run of the other, on each problem, a bootstrap cannot vary; the interval is then the exact
    binomial one of runs paired off, which is wider than need be.
    """
    mine = [np.asarray(runs, dtype=np.float64) for runs in evaluations]
    theirs = [np.asarray(runs, dtype=np.float64) for runs in reference]

    def mean(*samples: FloatArray, axis: int = -1) -> FloatArray:
        halves = zip(samples[: len(mine)], samples[len(mine) :], strict=True)
        average: FloatArray = np.mean([superiority(x, y) for x, y in halves], axis=0)
        return average

    a12 = float(mean(*mine, *theirs))
    pairs = sum(min(len(x), len(y)) for x, y in zip(mine, theirs, strict=True))
    if a12 in (0.0, 1.0):
        exact = binomtest(round(a12 * pairs), pairs)
        interval = exact.proportion_ci(CONFIDENCE, method="exact")
    else:
        interval = bootstrap(
            (*mine, *theirs),
            mean,
            n_resamples=RESAMPLES,
            batch=500,
            vectorized=True,
            confidence_level=CONFIDENCE,
            method="percentile",
            rng=seed,
        ).confidence_interval
    p_value = float(mannwhitneyu(mine[0], theirs[0]).pvalue) if len(mine) == 1 else None
    return Effect(a12=a12, low=float(interval.low), high=float(interval.high), p_value=p_value)


SCHEMA = 1
COMMAND = "python -m research.optimisers"


@dataclass(frozen=True, slots=True, kw_only=True)
class Benchmark:
    """The settings of a benchmark; the defaults are those of the shipped result."""

    # names of `OPTIMISERS`; the others are compared with the first
    optimisers: tuple[str, ...] = tuple(OPTIMISERS)
    problems: tuple[Problem, ...] = PROBLEMS  # the plants
    # how near to the optimal cost f a search must come: to f (1 + target); decreasing
    targets: tuple[float, ...] = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5)
    runs: int = 51  # runs of each optimiser on each problem, each from a seed of its own
    budget: int = 100_000  # evaluations of the cost that a run may spend
    seed: int = 0  # of them all; a run gives the same whatever else is compared

    def __post_init__(self) -> None:
        for name, least in (("runs", 2), ("budget", 1), ("seed", 0)):
            if getattr(self, name) < least:
                raise InvalidValueError(name, f"must be at least {least}", getattr(self, name))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Result:
    """The result of a benchmark.

    Attributes
    ----------
    benchmark
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

    benchmark: Benchmark
    optima: tuple[Optimum, ...]
    best_costs: tuple[float, ...]
    evaluations: FloatArray
    versions: Mapping[str, str]

    @property
    def successes(self) -> NDArray[np.intp]:
        """Runs that reached each target, shape (optimisers, problems, targets)."""
        return np.asarray(np.isfinite(self.evaluations).sum(axis=-1))

    @property
    def expected_running_times(self) -> FloatArray:
        """ERT [evaluations], shape (optimisers, problems, targets); infinite without success."""
        rows = self.evaluations.reshape(-1, self.benchmark.runs)
        times = [expected_running_time(runs, self.benchmark.budget) for runs in rows]
        return np.array(times).reshape(self.evaluations.shape[:-1])

    def distribution(self, optimiser: str) -> tuple[FloatArray, FloatArray]:
        """Return the share of (problem, target, run) that a search has solved over evaluations."""
        return empirical_distribution(self.evaluations[self._place(optimiser)])

    def effect(self, optimiser: str, target: float, problem: Problem | None = None) -> Effect:
        """Compare a search with the first: how fast it reaches a target on one or all problems."""
        problems = self.benchmark.problems
        which = range(len(problems)) if problem is None else [problems.index(problem)]
        row = self.benchmark.targets.index(target)
        mine, theirs = self.evaluations[self._place(optimiser)], self.evaluations[0]
        return effect_size([mine[p, row] for p in which], [theirs[p, row] for p in which])

    def _place(self, optimiser: str) -> int:
        return self.benchmark.optimisers.index(optimiser)


def summary(result: Result) -> dict[str, dict[str, dict[str, Any]]]:
    """Return the scores as plain data: lists over targets, by optimiser and problem or "all".

    Numbers are rounded to six digits. What is infinite or undefined is ``None``.
    """
    names, problems = result.benchmark.optimisers, result.benchmark.problems
    scores: dict[str, dict[str, dict[str, Any]]] = {name: {} for name in names}
    for a, name in enumerate(names):
        for p, problem in enumerate(problems):
            scores[name][problem.label] = {
                "successes": result.successes[a, p].tolist(),
                "expected_running_time": [
                    _plain(time) for time in result.expected_running_times[a, p]
                ],
                **(_effects(result, name, problem) if a else {}),
            }
        scores[name]["all"] = _effects(result, name, None) if a else {}
    return scores


def _effects(result: Result, name: str, problem: Problem | None) -> dict[str, list[Any]]:
    """Return the effect sizes of an optimiser on a problem, or on all, over targets."""
    effects = [asdict(result.effect(name, target, problem)) for target in result.benchmark.targets]
    keys = ("a12", "low", "high", *(("p_value",) if problem else ()))
    return {key: [_plain(effect[key]) for effect in effects] for key in keys}


def _plain(number: float) -> float | None:
    """Return a number rounded to six digits, or ``None`` if it is not finite."""
    return float(f"{number:.6g}") if math.isfinite(number) else None


def save_result(result: Result, path: Path) -> None:
    """Write a result with its scores, completely or not at all."""
    benchmark = result.benchmark
    table = np.where(np.isfinite(result.evaluations), result.evaluations, -1).astype(int).tolist()
    content = {
        "schema": SCHEMA,
        "command": COMMAND,
        "what": "evaluations that runs took to a cost of f (1 + target), null if never",
        "versions": dict(result.versions),
        "seed": benchmark.seed,
        "runs": benchmark.runs,
        "budget": benchmark.budget,
        "targets": benchmark.targets,
        "box": {"genes": GAIN_NAMES, **asdict(GAIN_BOX)},
        "problems": [
            {**asdict(problem), "optimum": asdict(optimum), "best_cost": best}
            for problem, optimum, best in zip(
                benchmark.problems, result.optima, result.best_costs, strict=True
            )
        ],
        "optimisers": {name: dict(OPTIMISERS[name].settings) for name in benchmark.optimisers},
        "summary": summary(result),
        "evaluations": dict(zip(benchmark.optimisers, _never_as_none(table), strict=True)),
    }
    text = json.dumps(content, indent=1, allow_nan=False)
    on_one_line = re.sub(r"\[\s+([^][{}]*?)\s+\]", lambda m: f"[{' '.join(m[1].split())}]", text)
    write_text(path, on_one_line + "\n")


def _never_as_none(table: Any) -> Any:
    """Return nested lists with ``None`` in place of -1."""
    if isinstance(table, list):
        return [_never_as_none(row) for row in table]
    return None if table == -1 else table


def load_result(path: Path) -> Result:
    """Read what `save_result` wrote; the scores are computed again."""
    with reading(path, "is not a result of research.optimisers"):
        data = json.loads(path.read_text(encoding="utf-8"))
        problems = [dict(problem) for problem in data["problems"]]
        optima = [problem.pop("optimum") for problem in problems]
        best_costs = tuple(problem.pop("best_cost") for problem in problems)
        benchmark = Benchmark(
            optimisers=tuple(data["evaluations"]),
            problems=tuple(Problem(**problem) for problem in problems),
            targets=tuple(data["targets"]),
            runs=data["runs"],
            budget=data["budget"],
            seed=data["seed"],
        )
        evaluations = np.array(list(data["evaluations"].values()), dtype=np.float64)
        return Result(
            benchmark=benchmark,
            optima=tuple(Optimum(**{**entry, "gains": tuple(entry["gains"])}) for entry in optima),
            best_costs=best_costs,
            evaluations=np.where(np.isnan(evaluations), np.inf, evaluations),  # NaN was None
            versions=data["versions"],
        )


PACKAGES = ("afl-mujoco", "cma", "numba", "numpy", "scipy")


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """One run, from its seed until its last threshold [cost] or its budget [evaluations]."""

    optimiser: str
    problem: Problem
    thresholds: tuple[float, ...]
    budget: int
    seed: tuple[int, ...]


def perform(run: Run) -> tuple[NDArray[np.float64], float]:
    """Return the evaluations that a run took to each threshold, and its least cost."""
    cost = CountedCost(run.problem.cost, run.thresholds, run.budget)
    try:
        OPTIMISERS[run.optimiser].search(cost, GAIN_BOX, run.seed)
    except Finished:
        return cost.reached, cost.best


def run_benchmark(
    benchmark: Benchmark,
    *,
    workers: int = 1,
    progress: Callable[[int, int], None] = lambda finished, of: None,
) -> Result:
    """Run a benchmark; after every run, `progress` gets the number of finished runs and of all.

    A run that comes below what was taken for the optimum is an `AflMujocoError`.
    """
    finished = count(1)
    with open_executor(workers) as executor:
        optima = tuple(compute_all(known_optimum, benchmark.problems, executor))
        runs = _runs_of(benchmark, optima)
        outcomes = compute_all(
            perform, runs, executor, lambda _: progress(next(finished), len(runs))
        )
    shape = len(benchmark.optimisers), len(benchmark.problems), benchmark.runs
    reached = np.array([taken for taken, _ in outcomes])
    costs = np.array([cost for _, cost in outcomes]).reshape(shape)
    best_costs = tuple(costs.min(axis=(0, 2)).tolist())
    for problem, optimum, best in zip(benchmark.problems, optima, best_costs, strict=True):
        if best < optimum.cost * (1.0 - RESOLUTION):
            thing = f"optimum of {problem.label}"
            raise AflMujocoError(thing, f"must not lie above a cost that a run met: {best}")
    return Result(
        benchmark=benchmark,
        optima=optima,
        best_costs=best_costs,
        evaluations=np.ascontiguousarray(reached.reshape(*shape, -1).swapaxes(2, 3)),
        versions={
            "python": platform.python_version(),
            **{package: version(package) for package in PACKAGES},
        },
    )


def _runs_of(benchmark: Benchmark, optima: Sequence[Optimum]) -> list[Run]:
    """Return the runs, the optimisers' one after another, each with a seed of its own names."""
    return [
        Run(
            optimiser=name,
            problem=problem,
            thresholds=tuple(optimum.cost * (1.0 + target) for target in benchmark.targets),
            budget=benchmark.budget,
            seed=(benchmark.seed, crc32(name.encode()), crc32(problem.label.encode()), repeat),
        )
        for name, (problem, optimum), repeat in product(
            benchmark.optimisers,
            zip(benchmark.problems, optima, strict=True),
            range(benchmark.runs),
        )
    ]


WIDTH = 34


def in_words(evaluations: float) -> str:
    """Return evaluations with at least three digits, or a dash for infinitely many."""
    return f"{evaluations:,.0f}" if math.isfinite(evaluations) else "-"


def print_problems(result: Result) -> None:
    """Print the optimum of each problem, and the evaluations of each optimiser."""
    benchmark = result.benchmark
    for p, (problem, optimum) in enumerate(zip(benchmark.problems, result.optima, strict=True)):
        gains = ", ".join(f"{gain:.4f}" for gain in optimum.gains)
        moved = abs(optimum.cost / optimum.tight_cost - 1.0)
        print(f"\n{problem.label}: optimal cost {optimum.cost:.7f} at (K, λ, Φ) = ({gains});")
        print(f"a tighter tolerance moves it by {moved:.1e}, relatively")
        print("   expected evaluations to the target [runs that reached it]")
        print(f"  {'':<{WIDTH}}" + "".join(f"{f'1 + {t:g}':>15}" for t in benchmark.targets))
        for a, name in enumerate(benchmark.optimisers):
            cells = zip(result.expected_running_times[a, p], result.successes[a, p], strict=True)
            row = "".join(f"{f'{in_words(ert)} [{reached}]':>15}" for ert, reached in cells)
            print(f"  {name:<{WIDTH}}{row}")


def print_effects(result: Result) -> None:
    """Print the probability that a run of each optimiser is faster than one of the first."""
    benchmark = result.benchmark
    first, *others = benchmark.optimisers
    if not others:
        return
    print(f"\nA12: probability that a run is faster than one of {first}")
    print("   mean over the plants [95 % interval]")
    print(f"  {'':<{WIDTH}}" + "".join(f"{f'1 + {t:g}':>19}" for t in benchmark.targets))
    for name in others:
        effects = [result.effect(name, target) for target in benchmark.targets]
        row = "".join(f"{f'{e.a12:.2f} [{e.low:.2f}, {e.high:.2f}]':>19}" for e in effects)
        print(f"  {name:<{WIDTH}}{row}")
    last = benchmark.targets[-1]
    print(f"   to 1 + {last:g} on each plant [95 % interval], p of Mann and Whitney's test")
    for name in others:
        print(f"  {name}")
        for problem in benchmark.problems:
            e = result.effect(name, last, problem)
            row = f"{e.a12:.2f} [{e.low:.2f}, {e.high:.2f}]   p = {e.p_value:.1e}"
            print(f"    {problem.label:<{WIDTH - 2}}{row}")


def show_progress(finished: int, of: int) -> None:
    """Rewrite one line of a terminal."""
    if sys.stderr.isatty():
        print(f"\r{finished} of {of} runs", end="\n" if finished == of else "", file=sys.stderr)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the contest, print its tables and write its files."""
    from research.figures import draw_contest

    look = argparse.RawDescriptionHelpFormatter
    parser = Parser(prog="optimisers", description=__doc__, formatter_class=look)
    parser.add_argument("--runs", type=int, default=Benchmark().runs)
    parser.add_argument("--budget", type=int, default=Benchmark().budget)
    parser.add_argument("--seed", type=int, default=Benchmark().seed)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args(arguments)
    benchmark = Benchmark(runs=options.runs, budget=options.budget, seed=options.seed)
    folder = options.out and output_folder(options.out)
    result = run_benchmark(benchmark, workers=options.workers, progress=show_progress)
    print_problems(result)
    print_effects(result)
    if folder:
        save_result(result, folder / "optimisers.json")
        save_figure(draw_contest(result), folder / "optimisers.png")
        print(f"\nwrote optimisers.json and optimisers.png to {folder}")


if __name__ == "__main__":
    run_command(main)
