"""Checkpoints of a search, from which a killed search continues to the same bits."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from afl_mujoco.errors import FileError
from afl_mujoco.files import FloatArray, differences, read_json, write_json

WRONG, THEN = "is not a valid checkpoint", "remove it to start again"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SearchState:
    """A search between two generations: all that decides how it continues.

    Attributes
    ----------
    problem
        Settings, bounds and seed by name, as plain data; they may not differ on resumption.
    generation, evaluations
        Generations bred and chromosomes evaluated so far.
    rng
        State of the bit generator, as plain data.
    population
        Chromosomes, shape (P, D).
    costs
        Their costs, shape (P,).
    history
        Best cost of each generation, shape (generation + 1,).
    """

    schema: Literal[2] = 2
    problem: dict[str, Any]
    generation: int
    evaluations: int
    rng: dict[str, Any]
    population: FloatArray
    costs: FloatArray
    history: FloatArray

    def __post_init__(self) -> None:
        """Check the shapes."""
        size = len(self.costs)
        fits = self.population.ndim == 2 and len(self.population) == size
        if not fits or self.costs.ndim != 1 or self.history.shape != (self.generation + 1,):
            raise ValueError("its arrays must have consistent lengths")


def save(path: Path, state: SearchState) -> None:
    """Write a checkpoint, whole or not at all, into a folder that exists."""
    write_json(path, state, indent=None)


def refuse_existing(path: Path) -> None:
    """Raise FileError if a search left a checkpoint at `path`."""
    if path.exists():
        raise FileError(str(path), "exists: pass resume=True to continue from it, or remove it")


def resume(path: Path, problem: Mapping[str, Any]) -> SearchState | None:
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
