"""The films of a page: small ones inside it, large ones linked."""

from __future__ import annotations

import io
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from PIL import Image, UnidentifiedImageError

from afl_mujoco.document.blocks import Film
from afl_mujoco.document.pictures import data_uri
from afl_mujoco.errors import FileError

SMALL = 1_500_000
"""Largest size of a film that is put inside the page [bytes]."""

ROOM = 17_000_000
"""Space in the page for films, after which further ones are linked [bytes]."""

POSTER_SIZE, POSTER_QUALITY = (960, 960), 75
"""Largest size of a poster [px], and its JPEG quality."""


@dataclass(frozen=True, slots=True)
class Shown:
    """A film as a page includes it.

    Attributes
    ----------
    size
        Size of the file [bytes]; 0 if there is none.
    source
        Its data URI, or its address relative to the page.
    poster
        A still as a data URI; empty if there is none.
    """

    size: int
    source: str
    poster: str

    @property
    def embedded(self) -> bool:
        """Whether it is inside the page."""
        return self.source.startswith("data:")

    @property
    def megabytes(self) -> float:
        """Size of the file [MB]."""
        return self.size / 1e6


def show_films(films: Sequence[Film], page_folder: Path, room: int = ROOM) -> dict[Path, Shown]:
    """Return how a page includes each film, by its file; wide ones come first if room is short."""
    shown: dict[Path, Shown] = {}
    for film in sorted(films, key=lambda film: not film.wide):
        try:
            shown[film.file] = _show(film, page_folder, room)
        except OSError as error:
            raise FileError.cannot_be("read", film.file, error) from None
        room -= len(shown[film.file].source) + len(shown[film.file].poster)
    return shown


def _show(film: Film, page_folder: Path, room: int) -> Shown:
    """Return how a page includes a film."""
    size = film.file.stat().st_size if film.file.is_file() else 0
    poster = _poster(film.poster) if film.poster else ""
    if 0 < size <= SMALL and 4 * size // 3 + len(poster) <= room:
        return Shown(size, data_uri("video/mp4", film.file.read_bytes()), poster)
    beside = Path(os.path.relpath(film.file.resolve(), page_folder.resolve()))
    return Shown(size, quote(beside.as_posix()), poster)


def _poster(path: Path) -> str:
    """Return a still as a small JPEG inside a data URI; nothing if there is no such file."""
    if not path.is_file():
        return ""
    try:
        with Image.open(path) as picture:
            small = picture.convert("RGB")
    except (UnidentifiedImageError, OSError) as error:
        raise FileError(str(path), f"must be a picture: {error}: run afl-mujoco render") from None
    small.thumbnail(POSTER_SIZE)
    stream = io.BytesIO()
    small.save(stream, "JPEG", quality=POSTER_QUALITY)
    return data_uri("image/jpeg", stream.getvalue())
