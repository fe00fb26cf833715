"""`afl-mujoco report`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from afl_mujoco.cli.terminal import FILMS, RESULTS, SUCCESS, say

Folder = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")]


@dataclass(frozen=True, kw_only=True)
class Report:
    """Make report.html again from every result of a folder, for example after new films.

    Example: afl-mujoco report renders/validation --films renders

    Nothing is computed: the page is made from the results and figures in the folder.
    """

    folder: Folder = RESULTS
    """Folder with the results of studies, such as `afl-mujoco validate`."""
    films: Path = FILMS
    """Folder with films.json, which `afl-mujoco render` writes."""

    def run(self) -> int:
        """Read the folder, write the page."""
        from afl_mujoco.cli.page import write_page

        page = write_page(self.folder, self.films)
        say(f"wrote {page}, {page.stat().st_size / 1e6:.1f} MB")
        return SUCCESS
