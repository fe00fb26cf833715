"""The pictures that are inside a page."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from afl_mujoco.errors import FileError
from afl_mujoco.files import inside

LARGE = 400_000
"""Size above which a bitmap replaces a vector drawing, if it is smaller [bytes]."""


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure as a page includes it: its data URI, and the size of the bitmap [px]."""

    source: str
    width: int
    height: int


def find_picture(files: Mapping[str, str], folder: Path) -> Picture | None:
    """Return a figure as vectors unless these are large; None if its files are missing."""
    paths = {kind: inside(folder, name) for kind, name in files.items()}
    if not all(path.is_file() for path in paths.values()):
        return None
    svg, png = (_read(paths[kind]) for kind in ("svg", "png"))
    vectors = len(svg) <= max(LARGE, len(png))
    width, height = (int.from_bytes(png[at : at + 4], "big") for at in (16, 20))
    source = data_uri("image/svg+xml", svg) if vectors else data_uri("image/png", png)
    return Picture(source, width, height)


def _read(path: Path) -> bytes:
    """Return the content of a file."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise FileError.cannot_be("read", path, error) from None


def data_uri(kind: str, content: bytes) -> str:
    """Return content of a media type as a data URI."""
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"
