"""How every survival command ends: its files said, its study put on the page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from afl_mujoco.cli.terminal import SURVIVAL, VALIDATION
from afl_mujoco.errors import FileError

if TYPE_CHECKING:
    from afl_mujoco.reporting.page.inputs.studies import Study


def studies_in(folder: Path) -> dict[str, Study]:
    """Return the studies that a folder holds; none if nobody asked for one and it is not there.

    Parameters
    ----------
    folder
        As asked for, or `SURVIVAL`.

    Raises
    ------
    FileError
        If it was asked for and is no folder, or what it holds cannot be understood.
    """
    from afl_mujoco.reporting.page.inputs.studies import load_studies

    if folder != SURVIVAL and not folder.is_dir():
        raise FileError(str(folder), "must be a folder of survival studies, is none")
    return load_studies(folder)


def page_folder(out: Path, validation: Path | None) -> Path | None:
    """Return the folder of the report whose page a study is put on, None for no report.

    Parameters
    ----------
    out
        Where the study is written: elsewhere than `SURVIVAL`, nothing but that folder is touched.
    validation
        The folder as asked for, if it was.
    """
    if validation is not None:
        return validation
    return VALIDATION if out == SURVIVAL else None


def require_page(study: str, out: Path, validation: Path | None, films: Path) -> None:
    """Raise at what `finish` could not put on the page, before anything slow.

    Parameters
    ----------
    study
        The one that is about to be made; the others must be readable.
    out, validation, films
        As of `finish`.

    Raises
    ------
    FileError
        If what is there cannot be understood.
    """
    from afl_mujoco.reporting.page.folder import REPORT
    from afl_mujoco.reporting.page.inputs.films import load_films
    from afl_mujoco.reporting.page.inputs.studies import load_studies

    if (out / f"{study}.json").is_dir():
        raise FileError(str(out / f"{study}.json"), "must be a file, is a folder")
    folder = page_folder(out, validation)
    if folder is not None and (folder / REPORT).is_file():
        load_films(films, folder)
        load_studies(out, leave_out=study)


def finish(files: Sequence[Path], out: Path, validation: Path | None, films: Path) -> None:
    """Print what was written, and make the report's page anew if there is a report.

    Parameters
    ----------
    files
        What the command wrote.
    out
        Folder of the survival studies.
    validation
        Folder that `afl-mujoco validate` wrote, as asked for.
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
    folder = page_folder(out, validation)
    if folder is None:
        print(f"afl-mujoco report --survival {out} puts it on the page of a report")
    elif not (folder / REPORT).is_file():
        print(f"no {folder / REPORT}: afl-mujoco validate will put the study on its page")
    else:
        page = write_page(folder, load_films(films, folder), load_studies(out))
        print(f"wrote {page}")
