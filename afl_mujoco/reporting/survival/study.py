"""The files of a survival study: its numbers as JSON, its figures as SVG and PNG."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from afl_mujoco.errors import FileError, reading
from afl_mujoco.files import write_text
from afl_mujoco.reporting.figures.style import Drawn, write_drawn

SCHEMA = 1

_PACKAGES = ("afl_mujoco", "control", "mujoco", "numpy", "scipy", "numba")


def remove_study(study: str, folder: Path) -> None:
    """Remove what an older study wrote: its JSON, and the files beside it that this lists.

    Parameters
    ----------
    study
        Its name, with which the names of its files begin.
    folder
        Where it is, if it is there.
    """
    path = folder / f"{study}.json"
    try:
        with reading(path, "is no study"):
            data = json.loads(path.read_text(encoding="utf-8"))
            listed = [str(entry[kind]) for entry in data["figures"] for kind in ("svg", "png")]
            listed += [str(name) for name in data.get("files", ())]
    except FileError:
        listed = []
    ours = [
        name
        for name in listed
        if Path(name).name == name and name.split(".")[0].split("-")[0] == study
    ]
    for old in (
        path,
        *(folder / name for name in ours),
    ):  # the list first, lest it tell what is gone
        try:
            old.unlink(missing_ok=True)
        except OSError as error:
            raise FileError.cannot_be("written", old, error) from None


def write_study(
    study: str,
    content: Mapping[str, Any],
    figures: Sequence[Drawn],
    folder: Path,
    *,
    command: str,
    files: Sequence[Path] = (),
) -> list[Path]:
    """Write the figures of a study, then its JSON, which lists them, in place of an older one's.

    Parameters
    ----------
    study
        Its name, of which its file has its own.
    content
        What was found, as plain data without NaN.
    figures
        What shows it.
    folder
        Where to; it must exist.
    command
        What found it, as typed into a shell.
    files
        What else the study has written there.

    Returns
    -------
    list of Path
        All its files.
    """
    path = folder / f"{study}.json"
    remove_study(study, folder)
    entries = [write_drawn(drawn, folder) for drawn in figures]
    data = {
        "schema": SCHEMA,
        "study": study,
        "command": command,
        "versions": {
            **{name: version(name) for name in _PACKAGES},
            "python": platform.python_version(),
        },
        **content,
        "files": [file.name for file in files],
        "figures": entries,
    }
    write_text(path, json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False) + "\n")
    return [path, *files, *(folder / entry[kind] for entry in entries for kind in ("svg", "png"))]
