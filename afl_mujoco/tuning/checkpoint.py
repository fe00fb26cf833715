"""The file that a search leaves after every generation, so that it can be killed and go on.

The first line names the format and the SHA-256 of all that follows; the second is JSON; then come
population, costs and history as little-endian doubles. The file is whole or missing, never half
written; the one of the generation before stands beside it, and one of the two is there whenever the
process dies: that costs at most one generation. A power cut may cost more, and is noticed.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.errors import FileError, reading

SCHEMA = 1
MAGIC = b"afl-mujoco genetic search"

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SearchState:
    """A search between two generations: all that decides how it goes on.

    Attributes
    ----------
    problem
        Settings, bounds and seed by name, as plain data: what may not differ on resumption.
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

    problem: Mapping[str, Any]
    generation: int
    evaluations: int
    rng: Mapping[str, Any]
    population: FloatArray
    costs: FloatArray
    history: FloatArray


def previous(path: Path) -> Path:
    """Return where the checkpoint of the generation before `path`'s stands."""
    return path.with_name(f"{path.name}.previous")


def save(path: Path, state: SearchState) -> None:
    """Write a checkpoint, whole or not at all, and keep the one that was there as `previous`.

    Parameters
    ----------
    path
        The file; its folder must exist.
    state
        What to write.

    Raises
    ------
    FileError
        If it cannot be written.
    """
    scalars = {
        "problem": state.problem,
        "generation": state.generation,
        "evaluations": state.evaluations,
        "rng": state.rng,
    }
    arrays = (state.population, state.costs, state.history)
    parts = (json.dumps(scalars).encode(), b"\n", *(a.astype("<f8").tobytes() for a in arrays))
    body = b"".join(parts)
    title = b"%s %d %s\n" % (MAGIC, SCHEMA, hashlib.sha256(body).hexdigest().encode())
    try:
        _rotate(path, title + body)
    except OSError as error:
        raise FileError.cannot_be("written", path, error) from None


def _rotate(path: Path, content: bytes) -> None:
    """Make `content` the file at `path`, and what was there its `previous`, or raise OSError.

    The oldest file is overwritten in place under a third name: a new file every
    time, as `atomic_file` makes, takes longer than all the rest of a generation but its costs.
    """
    spare = path.with_name(f"{path.name}.spare")
    if path.exists():  # else `previous` is all there is
        with suppress(FileNotFoundError):
            previous(path).replace(spare)
    with open(os.open(spare, os.O_WRONLY | os.O_CREAT, 0o666), "wb") as stream:
        stream.write(content)
        stream.truncate()
    with suppress(FileNotFoundError):
        path.replace(previous(path))
    spare.replace(path)  # killed before this, it leaves `previous`: `resume` knows


def load(path: Path) -> SearchState:
    """Read one checkpoint.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    FileError
        If it cannot be read, or is not what `save` wrote.
    """
    with reading(path, "is no sound checkpoint"):
        return _parse(path.read_bytes())


def _parse(content: bytes) -> SearchState:
    """Return the state that a file's bytes hold, or raise ValueError, KeyError or TypeError."""
    title, _, body = content.partition(b"\n")
    name, *versions = title.rsplit(b" ", 2)
    if name != MAGIC or len(versions) != 2:
        raise ValueError("it does not begin as one")
    if versions[0] != b"%d" % SCHEMA:
        raise ValueError(f"its schema must be {SCHEMA}, got {versions[0].decode(errors='replace')}")
    if versions[1] != hashlib.sha256(body).hexdigest().encode():
        raise ValueError("it is cut short or altered")
    scalars, _, raw = body.partition(b"\n")
    head = json.loads(scalars)
    size, genes = head["problem"]["population_size"], len(head["problem"]["lower"])
    numbers = np.frombuffer(raw, dtype="<f8").astype(np.float64)
    population, costs, history = np.split(numbers, [size * genes, size * (genes + 1)])
    if len(history) != head["generation"] + 1:
        raise ValueError("its arrays are not as long as it says")
    return SearchState(
        **head, population=population.reshape(size, genes), costs=costs, history=history
    )


def refuse_existing(path: Path) -> None:
    """Raise if a search left a checkpoint at `path`, or only its `previous`.

    Raises
    ------
    FileError
        Naming the file.
    """
    for file in (path, previous(path)):
        if file.exists():
            raise FileError(str(file), "exists: pass resume=True to go on from it, or remove it")


def resume(path: Path, problem: Mapping[str, Any]) -> SearchState | None:
    """Return where the search of `problem` stopped; ``None`` if it left no checkpoint.

    Parameters
    ----------
    path
        The checkpoint; if it is missing, `previous` stands in.
    problem
        As in `SearchState`.

    Raises
    ------
    FileError
        If the checkpoint is unsound, or of another problem. It is left as it is.
    """
    file = path if path.exists() else previous(path)
    if not file.exists():
        return None
    try:
        state = load(file)
    except FileError as error:
        raise FileError(error.thing, f"{error.rule}; {_way_out(file, previous(path))}") from None
    _require_same(file, state.problem, json.loads(json.dumps(problem)))
    return state


def _way_out(unsound: Path, fallback: Path) -> str:
    """Return what to do about an unsound checkpoint."""
    if unsound != fallback:
        with suppress(FileError):
            generation = load(fallback).generation
            return f"remove it to resume from generation {generation}, which {fallback} holds"
    return "remove it to begin anew"


def _require_same(path: Path, there: Mapping[str, Any], here: Mapping[str, Any]) -> None:
    """Raise, naming every field, if a checkpoint's problem is not the one asked for."""
    differences = [
        f"{name} is {there.get(name)} in it and {here.get(name)} here"
        for name in dict.fromkeys((*here, *there))
        if there.get(name) != here.get(name)
    ]
    if differences:
        rule = f"is of another search: {', '.join(differences)}; give the same, or another file"
        raise FileError(str(path), rule)
