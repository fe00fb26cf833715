"""The files of the maps of attraction."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from afl_mujoco.errors import reading
from afl_mujoco.files import atomic_file
from afl_mujoco.simulation.attraction.cells import FOUND, AttractionMap, Cells
from afl_mujoco.validation.attraction.comparison import Comparison

_PLACES = ("columns", "rows", "starts", "plants")


def save_comparisons(comparisons: Sequence[Comparison], folder: Path) -> list[Path]:
    """Write an npz of both maps for each comparison.

    Parameters
    ----------
    comparisons
        What was found.
    folder
        Where to.

    Returns
    -------
    list of Path
        The files.
    """
    files = [folder / f"{comparison.name}.npz" for comparison in comparisons]
    for comparison, file in zip(comparisons, files, strict=True):
        _save(comparison, file)
    return files


def _save(comparison: Comparison, path: Path) -> None:
    """Write both maps to an npz file."""
    cells = comparison.ode.cells
    arrays = {name: getattr(cells, name) for name in _PLACES}
    for found in (comparison.ode, comparison.mujoco):
        arrays |= {f"{found.simulator}_{name}": getattr(found, name) for name in FOUND}
    meta = {
        "plane": cells.plane,
        "controller": comparison.ode.controller,
        "constants": {"pole_mass": cells.pole_mass, "gravity": cells.gravity},
        "ode": dict(comparison.ode.settings),
        "mujoco": dict(comparison.mujoco.settings),
    }
    with atomic_file(path) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, **arrays, meta=np.array(json.dumps(meta)))


def load_comparison(path: str | Path) -> Comparison:
    """Read an npz file that `save_comparisons` wrote.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    FileError
        If it cannot be read or is no such file.
    """
    with reading(path, "is no saved map of attraction"):
        with Path(path).open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            meta = json.loads(str(file["meta"]))
            arrays = {name: file[name] for name in file.files if name != "meta"}
        places = {name: arrays[name] for name in _PLACES}
        cells = Cells(plane=meta["plane"], **places, **meta["constants"])
        return Comparison(_map("ode", meta, cells, arrays), _map("mujoco", meta, cells, arrays))


def _map(
    simulator: str, meta: Mapping[str, Any], cells: Cells, arrays: Mapping[str, Any]
) -> AttractionMap:
    """Return one of the two maps of a file."""
    return AttractionMap(
        cells=cells,
        controller=meta["controller"],
        simulator=simulator,
        settings=meta[simulator],
        **{name: arrays[f"{simulator}_{name}"] for name in FOUND},
    )
