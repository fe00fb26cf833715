"""The files of a survival study: its numbers as JSON, its figures as SVG and PNG."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from afl_mujoco.output import write_text
from afl_mujoco.reporting.figures.style import Drawn, write_drawn

SCHEMA = 1

_PACKAGES = ("afl_mujoco", "control", "mujoco", "numpy", "scipy", "numba")


def write_study(
    study: str, content: Mapping[str, Any], figures: Sequence[Drawn], folder: Path, *, command: str
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

    Returns
    -------
    list of Path
        The files.
    """
    path = folder / f"{study}.json"
    path.unlink(missing_ok=True)  # lest it list figures of another study
    for old in (*folder.glob(f"{study}*.svg"), *folder.glob(f"{study}*.png")):
        old.unlink()
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
        "figures": entries,
    }
    write_text(path, json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False) + "\n")
    return [path, *(folder / entry[kind] for entry in entries for kind in ("svg", "png"))]
