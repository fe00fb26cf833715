"""The file that keeps the result of a contest: JSON, with its scores for whoever reads it."""

from __future__ import annotations

import json
import math
import re
from dataclasses import asdict
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.gain_function import GAIN_NAMES, shipped_file
from afl_mujoco.errors import reading
from afl_mujoco.output import write_text
from afl_mujoco.tuning.gain_cost import GAIN_BOX
from afl_mujoco.tuning.referee.contest import Contest
from afl_mujoco.tuning.referee.optimisers import OPTIMISERS
from afl_mujoco.tuning.referee.problems import Optimum, Problem
from afl_mujoco.tuning.referee.result import ContestResult
from afl_mujoco.tuning.settings import Box

SCHEMA = 1
ALL = "all"
"""Key of what concerns all problems together."""


def save_result(result: ContestResult, path: Path) -> None:
    """Write the result of a contest as JSON, whole or not at all.

    Parameters
    ----------
    result
        What to write.
    path
        The file.
    """
    text = json.dumps(_to_dict(result), indent=1, allow_nan=False)
    on_one_line = re.sub(r"\[\s+([^][{}]*?)\s+\]", lambda m: f"[{' '.join(m[1].split())}]", text)
    write_text(path, on_one_line + "\n")


def load_result(path: Path) -> ContestResult:
    """Read what `save_result` wrote; the scores are not read but computed anew.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    FileError
        If it cannot be read, or is no result of a contest.
    """
    with reading(path, "is no result of a contest"):
        return _from_dict(json.loads(path.read_text(encoding="utf-8")))


def shipped_result() -> ContestResult:
    """Return the result that comes with the package."""
    with resources.as_file(shipped_file("optimisers.json")) as path:
        return load_result(path)


def summary(result: ContestResult) -> dict[str, dict[str, dict[str, Any]]]:
    """Return the scores as plain data: lists over targets, by optimiser and problem.

    Numbers are rounded to six digits. What is infinite or undefined is ``None``.

    Parameters
    ----------
    result
        Of the contest.
    """
    contest = result.contest
    problems: tuple[Problem | None, ...] = (*contest.problems, None)
    return {
        name: {
            problem.label if problem else ALL: {
                **(_counts(result, a, problem) if problem else {}),
                **(_effects(result, name, problem) if a else {}),
            }
            for problem in problems
        }
        for a, name in enumerate(contest.optimisers)
    }


def _counts(result: ContestResult, optimiser: int, problem: Problem) -> dict[str, list[Any]]:
    """Return successes and ERT of an optimiser on a problem, over targets."""
    place = optimiser, result.contest.problems.index(problem)
    times = result.expected_running_times[place].tolist()
    return {
        "successes": result.successes[place].tolist(),
        "expected_running_time": [_plain(time) for time in times],
    }


def _effects(result: ContestResult, name: str, problem: Problem | None) -> dict[str, list[Any]]:
    """Return the effect sizes of an optimiser on a problem, or on all, over targets."""
    effects = [asdict(result.effect(name, target, problem)) for target in result.contest.targets]
    keys = ("a12", "low", "high", *(("p_value",) if problem else ()))
    return {key: [_plain(effect[key]) for effect in effects] for key in keys}


def _plain(number: float) -> float | None:
    """Return a number rounded to six digits, or ``None`` if it is not finite."""
    return float(f"{number:.6g}") if math.isfinite(number) else None


def _to_dict(result: ContestResult) -> dict[str, Any]:
    """Return all of a result as plain data."""
    contest = result.contest
    table = [
        [[[int(n) if math.isfinite(n) else None for n in runs] for runs in rows] for rows in part]
        for part in result.evaluations.tolist()
    ]
    return {
        "schema": SCHEMA,
        "what": "evaluations that runs took to a cost of f (1 + target), null if never",
        "versions": dict(result.versions),
        "seed": contest.seed,
        "runs": contest.runs,
        "budget": contest.budget,
        "targets": contest.targets,
        "box": {"genes": GAIN_NAMES, **asdict(GAIN_BOX)},
        "problems": [
            {**asdict(problem), "optimum": asdict(optimum), "best_cost": best}
            for problem, optimum, best in zip(
                contest.problems, result.optima, result.best_costs, strict=True
            )
        ],
        "optimisers": {name: dict(OPTIMISERS[name].settings) for name in contest.optimisers},
        "summary": summary(result),
        "evaluations": dict(zip(contest.optimisers, table, strict=True)),
    }


def _from_dict(data: dict[str, Any]) -> ContestResult:
    """Return the result that plain data describe, or raise."""
    if data["schema"] != SCHEMA:
        raise ValueError(f"schema must be {SCHEMA}, got {data['schema']}")
    box = Box(tuple(data["box"]["lower"]), tuple(data["box"]["upper"]))
    if box != GAIN_BOX:
        raise ValueError(f"the box must be {GAIN_BOX}, got {box}")
    for name, settings in data["optimisers"].items():
        if settings != json.loads(json.dumps(dict(OPTIMISERS[name].settings))):
            raise ValueError(f"{name} had other settings: {settings}")
    problems = [dict(problem) for problem in data["problems"]]
    optima = [problem.pop("optimum") for problem in problems]
    best_costs = [float(problem.pop("best_cost")) for problem in problems]
    seed = data["seed"]
    contest = Contest(
        optimisers=tuple(data["evaluations"]),
        problems=tuple(Problem(**problem) for problem in problems),
        targets=tuple(data["targets"]),
        runs=data["runs"],
        budget=data["budget"],
        seed=tuple(seed) if isinstance(seed, list) else seed,
    )
    return ContestResult(
        contest=contest,
        optima=tuple(Optimum(**{**entry, "gains": tuple(entry["gains"])}) for entry in optima),
        best_costs=tuple(best_costs),
        evaluations=_numbers(list(data["evaluations"].values())),
        versions=data["versions"],
    )


def _numbers(table: list[Any]) -> NDArray[np.float64]:
    """Return nested lists as an array, ``None`` as infinity."""
    numbers = np.array(table, dtype=np.float64)  # None becomes NaN
    return np.where(np.isnan(numbers), np.inf, numbers)
