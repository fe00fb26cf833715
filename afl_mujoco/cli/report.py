"""`afl-mujoco report`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from afl_mujoco.cli.terminal import FILMS, SUCCESS, SURVIVAL, VALIDATION

Folder = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")]


@dataclass(frozen=True, kw_only=True)
class Report:
    """Make report.html anew from what a validation left, when there are new films or studies.

    Example: afl-mujoco report renders/validation --films renders

    Nothing is computed: report.json, curves.npz and the figures of the folder make the page.
    """

    folder: Folder = VALIDATION
    """Folder that `afl-mujoco validate` wrote."""
    films: Path = FILMS
    """Folder with films.json, which `afl-mujoco render` writes."""

    survival: Path = SURVIVAL
    """Folder with the survival studies, which `afl-mujoco ladder` and its like write."""

    def run(self) -> int:
        """Read what is there, write the page."""
        from afl_mujoco.cli.survival.ending import studies_in
        from afl_mujoco.reporting.page.folder import write_page
        from afl_mujoco.reporting.page.inputs.films import load_films

        films = load_films(self.films, self.folder)
        page = write_page(self.folder, films, studies_in(self.survival))
        print(f"wrote {page}, {page.stat().st_size / 1e6:.1f} MB")
        return SUCCESS
