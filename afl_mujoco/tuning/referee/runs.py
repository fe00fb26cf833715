"""The runs of a contest, shared among processes; their results do not depend on how many."""

from __future__ import annotations

import platform
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from itertools import count, product
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.errors import AflMujocoError
from afl_mujoco.sweep.executors import open_executor
from afl_mujoco.sweep.sweep import compute_all
from afl_mujoco.tuning.gain_cost import GAIN_BOX
from afl_mujoco.tuning.referee.contest import Contest
from afl_mujoco.tuning.referee.optimisers import OPTIMISERS, CountedCost, Finished
from afl_mujoco.tuning.referee.problems import RESOLUTION, Optimum, Problem, known_optimum
from afl_mujoco.tuning.referee.result import ContestResult

PACKAGES = ("afl-mujoco", "cma", "numba", "numpy", "scipy")


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """One run, from its seed until its last threshold or its budget.

    Attributes
    ----------
    optimiser
        Its name.
    problem
        What it searches.
    thresholds
        Costs to reach, shape (T,).
    budget
        Evaluations it may spend.
    seed
        Its own.
    """

    optimiser: str
    problem: Problem
    thresholds: tuple[float, ...]
    budget: int
    seed: tuple[int, ...]


def perform(run: Run) -> tuple[NDArray[np.float64], float]:
    """Return the evaluations that a run took to each threshold, and its least cost.

    Parameters
    ----------
    run
        What to do.
    """
    cost = CountedCost(run.problem.cost, run.thresholds, run.budget)
    try:
        OPTIMISERS[run.optimiser].search(cost, GAIN_BOX, run.seed)
    except Finished:
        return cost.reached, cost.best


def hold_contest(
    contest: Contest,
    *,
    workers: int = 1,
    progress: Callable[[int, int], None] = lambda finished, of: None,
) -> ContestResult:
    """Hold a contest.

    Parameters
    ----------
    contest
        What is compared.
    workers
        Processes to share the runs among; one runs them in this process.
    progress
        Told after every run how many are finished, and of how many.

    Raises
    ------
    AflMujocoError
        If an optimiser needs a package that is missing, or a run comes below what was taken for the
        optimum.
    """
    _require_packages(contest.optimisers)
    finished = count(1)
    with open_executor(workers) as executor:
        optima = tuple(compute_all(known_optimum, contest.problems, executor))
        runs = _runs_of(contest, optima)
        outcomes = compute_all(
            perform, runs, executor, lambda _: progress(next(finished), len(runs))
        )
    optimisers, problems, targets, repeats = contest.shape
    reached = np.array([taken for taken, _ in outcomes])
    table = reached.reshape(optimisers, problems, repeats, targets).swapaxes(2, 3)
    costs = np.array([cost for _, cost in outcomes]).reshape(optimisers, problems, repeats)
    best_costs = tuple(costs.min(axis=(0, 2)).tolist())
    for problem, optimum, best in zip(contest.problems, optima, best_costs, strict=True):
        if best < optimum.cost * (1.0 - RESOLUTION):
            thing = f"optimum of {problem.label}"
            raise AflMujocoError(thing, f"must not lie above a cost that a run met: {best}")
    return ContestResult(
        contest=contest,
        optima=optima,
        best_costs=best_costs,
        evaluations=np.ascontiguousarray(table),
        versions=_versions(),
    )


def _runs_of(contest: Contest, optima: Sequence[Optimum]) -> list[Run]:
    """Return the runs of a contest, the optimisers' one after another."""
    root = contest.seed if isinstance(contest.seed, tuple) else (contest.seed,)
    return [
        Run(
            optimiser=name,
            problem=problem,
            thresholds=tuple(optimum.cost * (1.0 + target) for target in contest.targets),
            budget=contest.budget,
            seed=(*root, crc32(name.encode()), crc32(problem.label.encode()), repeat),
        )
        for name, (problem, optimum), repeat in product(
            contest.optimisers, zip(contest.problems, optima, strict=True), range(contest.runs)
        )
    ]


def _require_packages(optimisers: Sequence[str]) -> None:
    """Raise if an optimiser needs a package that is not there."""
    for name in optimisers:
        package = OPTIMISERS[name].package
        if package is not None and find_spec(package) is None:
            rule = f"needs the package {package}: pip install {package}"
            raise AflMujocoError(name, rule)


def _versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that are there."""
    versions = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            continue
    return versions
