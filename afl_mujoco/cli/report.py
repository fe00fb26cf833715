"""`afl-mujoco report`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from afl_mujoco.cli.terminal import FILMS, ROBUSTNESS, SUCCESS, VALIDATION

Folder = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")]


@dataclass(frozen=True, kw_only=True)
class Report:
    """Make report.html anew from a validation's files, when there are new films or studies.

    Example: afl-mujoco report renders/validation --films renders

    Nothing is computed: report.json, curves.npz and the figures of the folder make the page.
    """

    folder: Folder = VALIDATION
    """Folder that `afl-mujoco validate` wrote."""
    films: Path = FILMS
    """Folder with films.json, which `afl-mujoco render` writes."""
    robustness: Path = ROBUSTNESS
    """Folder with the results of the studies, such as `afl-mujoco thresholds` writes."""

    def run(self) -> int:
        """Read what is there, write the page."""
        from afl_mujoco.cli.study import sections_in
        from afl_mujoco.reporting.page.folder import write_page
        from afl_mujoco.reporting.page.inputs.films import load_films

        films = load_films(self.films, self.folder)
        page = write_page(self.folder, films, sections_in(self.robustness), self.robustness)
        print(f"wrote {page}, {page.stat().st_size / 1e6:.1f} MB")
        return SUCCESS
