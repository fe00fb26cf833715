"""The settings of a benchmark, its result with scores, and the JSON file of both."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.gain_function import GAIN_NAMES
from afl_mujoco.errors import InvalidValueError, reading
from afl_mujoco.files import write_text
from afl_mujoco.studies.gain_tuning.gain_cost import GAIN_BOX
from optimisers.problems import PROBLEMS, Optimum, Problem
from optimisers.scores import Effect, effect_size, empirical_distribution, expected_running_time
from optimisers.searches import OPTIMISERS

FloatArray = NDArray[np.float64]

SCHEMA = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Benchmark:
    """The settings of a benchmark; the defaults are those of the shipped result.

    Attributes
    ----------
    optimisers
        Names of `OPTIMISERS`; the others are compared with the first.
    problems
        The plants.
    targets
        How near to the optimal cost f a search must come: to f (1 + target); decreasing.
    runs
        Runs of each optimiser on each problem, each from a seed of its own.
    budget
        Evaluations of the cost that a run may spend.
    seed
        Of them all; a run gives the same whatever else is compared.
    """

    optimisers: tuple[str, ...] = tuple(OPTIMISERS)
    problems: tuple[Problem, ...] = PROBLEMS
    targets: tuple[float, ...] = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5)
    runs: int = 51
    budget: int = 100_000
    seed: int = 0

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
        return np.isfinite(self.evaluations).sum(axis=-1)

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
    with reading(path, "is not a result of bench_optimisers.py"):
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
