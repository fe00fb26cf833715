"""How every survival command ends: its files said, its study put on the page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path


def finish(files: Sequence[Path], validation: Path, films: Path) -> None:
    """Print what was written, and make the report's page anew if there is a report.

    Parameters
    ----------
    files
        What the command wrote, all in one folder: that of the survival studies.
    validation
        Folder that `afl-mujoco validate` wrote, if it did.
    films
        Folder with films.json, if there are films.

    Raises
    ------
    FileError
        If what is there cannot be understood.
    """
    from afl_mujoco.reporting.page.folder import REPORT, write_page
    from afl_mujoco.reporting.page.inputs.films import load_films
    from afl_mujoco.reporting.page.inputs.studies import load_studies

    print(f"wrote {', '.join(str(file) for file in files)}")
    if not (validation / REPORT).is_file():
        print(f"no {validation / REPORT}: afl-mujoco validate will put the study on its page")
        return
    studies = load_studies(files[0].parent)
    page = write_page(validation, load_films(films, validation), studies)
    print(f"wrote {page}")


def require_films(validation: Path, films: Path) -> None:
    """Raise at a list of films that `finish` could not read, before anything slow.

    Parameters
    ----------
    validation, films
        As of `finish`.

    Raises
    ------
    FileError
        If what is there cannot be understood.
    """
    from afl_mujoco.reporting.page.folder import REPORT
    from afl_mujoco.reporting.page.inputs.films import load_films

    if (validation / REPORT).is_file():
        load_films(films, validation)
