"""The pictures of a page, inside it."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from afl_mujoco.errors import FileError

LARGE = 400_000
"""Size from which a vector drawing gives way to its bitmap, if that is smaller [bytes]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """A figure as a page shows it.

    Attributes
    ----------
    place
        Where it belongs, for a page that sorts its figures; empty elsewhere.
    title, caption, alt
        What it shows.
    source
        Its data URI.
    width, height
        Of the bitmap [pixels].
    """

    kind: ClassVar[str] = "picture"

    place: str
    title: str
    caption: str
    alt: str
    source: str
    width: int
    height: int


def find_picture(entry: Mapping[str, Any], folder: Path) -> Picture | None:
    """Return a figure, None if its files are not there; arguments as of `load_picture`."""
    there = all((folder / entry[kind]).exists() for kind in ("svg", "png"))
    return load_picture(entry, folder) if there else None


def load_picture(entry: Mapping[str, Any], folder: Path, place: str = "") -> Picture:
    """Read a figure, as vectors unless these are large."""
    svg, png = (_read(folder / entry[kind]) for kind in ("svg", "png"))
    vectors = len(svg) <= max(LARGE, len(png))
    width, height = (int.from_bytes(png[at : at + 4], "big") for at in (16, 20))
    return Picture(
        place=place,
        title=entry["title"],
        caption=entry["caption"],
        alt=entry["alt"],
        source=data_uri("image/svg+xml", svg) if vectors else data_uri("image/png", png),
        width=width,
        height=height,
    )


def _read(path: Path) -> bytes:
    """Return the content of a file."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise FileError.cannot_be("read", path, error) from None


def data_uri(kind: str, content: bytes) -> str:
    """Return content of a media type as an address that holds it."""
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"
