"""Files written whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from afl_mujoco.errors import FileError


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Give a temporary file beside `path` to write, and rename it onto `path` on success.

    Parameters
    ----------
    path
        The file to write; its folder must exist.

    Yields
    ------
    Path
        The temporary file; it is removed if the block raises.

    Raises
    ------
    FileError
        If the folder cannot be written.
    """
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=".", suffix=path.suffix)
    except OSError as error:
        raise FileError.cannot_be("written", path, error) from None
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        temporary.replace(path)
    except OSError as error:
        raise FileError.cannot_be("written", path, error) from None
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file, whole or not at all.

    Parameters
    ----------
    path
        The file.
    text
        Its content.
    """
    with atomic_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def output_folder(path: str | Path) -> Path:
    """Return `path` as a folder that exists and can be written.

    Parameters
    ----------
    path
        The folder; made, with its parents, if missing.

    Raises
    ------
    FileError
        If it is no folder, or cannot be made or written.
    """
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError.cannot_be("written", f"output folder {folder}", error) from None
    if not os.access(folder, os.W_OK | os.X_OK):
        raise FileError(f"output folder {folder}", "cannot be written: permission denied")
    return folder
