"""`afl-mujoco report`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from afl_mujoco.cli.terminal import FILMS, RESULTS, SUCCESS

Folder = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")]


@dataclass(frozen=True, kw_only=True)
class Report:
    """Make report.html anew from every result of a folder, as when there are new films.

    Example: afl-mujoco report renders/validation --films renders

    Nothing is computed: the results and figures of the folder make the page.
    """

    folder: Folder = RESULTS
    """Folder that the studies wrote, `afl-mujoco validate` among them."""
    films: Path = FILMS
    """Folder with films.json, which `afl-mujoco render` writes."""

    def run(self) -> int:
        """Read what is there, write the page."""
        from afl_mujoco.cli.page import write_page

        page = write_page(self.folder, self.films)
        print(f"wrote {page}, {page.stat().st_size / 1e6:.1f} MB")
        return SUCCESS
