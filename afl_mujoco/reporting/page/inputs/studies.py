"""The survival studies of the page: what a folder holds of them, read and held to its form."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from afl_mujoco.document.pictures import Picture, load_picture
from afl_mujoco.errors import reading

NAMES = ("ladder", "montecarlo", "attraction", "margins", "estimation")
"""Of the studies, in the order in which they are read: each has file and command of that name."""

Row = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Study:
    """A survival study.

    Attributes
    ----------
    name
        One of `NAMES`.
    path
        Its file.
    data
        What its file holds.
    pictures
        Its figures.
    """

    name: str
    path: Path
    data: Row
    pictures: tuple[Picture, ...]


def load_studies(folder: Path, *, leave_out: str = "") -> dict[str, Study]:
    """Return the studies that a folder holds, by name.

    Parameters
    ----------
    folder
        Where `afl-mujoco ladder` and its like write; it need not be there.
    leave_out
        A study that is not read.

    Raises
    ------
    FileError
        If a file cannot be read or is no study.
    """
    there = [name for name in NAMES if (folder / f"{name}.json").is_file()]
    return {name: _load(folder, name) for name in there if name != leave_out}


def _load(folder: Path, name: str) -> Study:
    """Read one study."""
    path = folder / f"{name}.json"
    with reading_study(path, name):
        data = json.loads(path.read_text(encoding="utf-8"))
        if (data["schema"], data["study"]) != (1, name):
            raise ValueError(f"it must have schema 1 and be the study {name!r}")
        if not isinstance(data["command"], str):
            raise ValueError("command must be a text")
        pictures = tuple(_pictures(data["figures"], folder))
    return Study(name, path, data, pictures)


def _pictures(entries: Iterable[Row], folder: Path) -> Iterable[Picture]:
    """Return the figures, which must lie beside the file that lists them."""
    for entry in entries:
        for kind in ("svg", "png"):
            if Path(entry[kind]).name != entry[kind]:
                raise ValueError(f"{kind} must lie beside the file, got {entry[kind]!r}")
        yield load_picture(entry, folder, "#survival")


def reading_study(path: Path | str, name: str) -> AbstractContextManager[None]:
    """Turn whatever is wrong with a study that the block reads into one line, as `reading` does.

    Parameters
    ----------
    path
        Its file.
    name
        Its name.
    """
    return reading(path, "is not a survival study", f"run afl-mujoco {name}")
