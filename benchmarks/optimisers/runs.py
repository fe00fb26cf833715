"""The runs of a benchmark, shared among processes, whose number does not change the result."""

from __future__ import annotations

import platform
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from itertools import count, product
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.errors import AflMujocoError
from afl_mujoco.execution.executors import compute_all, open_executor
from afl_mujoco.studies.gain_tuning.gain_cost import GAIN_BOX
from optimisers.problems import RESOLUTION, Optimum, Problem, known_optimum
from optimisers.result import Benchmark, Result
from optimisers.searches import OPTIMISERS, CountedCost, Finished

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
