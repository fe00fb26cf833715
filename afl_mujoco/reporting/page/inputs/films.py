"""The films of the page: small ones inside it, large ones linked beside it."""

from __future__ import annotations

import io
import json
import os
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

from PIL import Image, UnidentifiedImageError

from afl_mujoco.document.numbers import short
from afl_mujoco.document.pictures import data_uri
from afl_mujoco.errors import FileError, reading

SMALL = 1_500_000
"""Size up to which a film is put inside the page [bytes]."""

ROOM = 17_000_000
"""How much of the page films may take before further ones are linked [bytes]."""

POSTER_SIZE, POSTER_QUALITY = (960, 960), 75
"""Into what a poster is fitted [pixels], and its JPEG quality."""

AGAIN = "run afl-mujoco render"

SHOWCASE, COMPARISON = "showcase", "comparison"
_PRIORITY = {SHOWCASE: 0, COMPARISON: 1}  # who comes first where there is no room for all


@dataclass(frozen=True, slots=True, kw_only=True)
class Film:
    """A film as the page shows it.

    Attributes
    ----------
    title, kind, controllers, command
        What it shows, and what made it.
    deployed
        How the law was deployed in it, as a sentence; empty if that is not known.
    scenario
        Its scenario; ``None`` if it shows more than one.
    width, height
        Of a frame [pixels].
    duration
        How long it lasts [s].
    name, size
        Of the file, its size in bytes; 0 if it is not there.
    source
        Its data URI, or its address relative to the page.
    poster
        A still as a data URI; empty if there is none.
    """

    title: str
    kind: str
    scenario: str | None
    controllers: tuple[str, ...]
    width: int
    height: int
    duration: float
    command: str
    deployed: str
    name: str
    size: int
    source: str
    poster: str

    @property
    def embedded(self) -> bool:
        """Whether it is inside the page."""
        return self.source.startswith("data:")

    @property
    def wide(self) -> bool:
        """Whether it needs the whole width."""
        return self.kind in (SHOWCASE, COMPARISON)

    @property
    def megabytes(self) -> float:
        """Size of the file [MB]."""
        return self.size / 1e6


def load_films(folder: Path, page_folder: Path, *, room: int = ROOM) -> tuple[Film, ...]:
    """Return the films that a folder's films.json lists; none without such a file.

    Parameters
    ----------
    room
        How much of the page films may take [bytes].
    """
    listing = folder / "films.json"
    try:
        if not listing.exists():
            return ()
    except OSError as error:
        raise FileError.cannot_be("read", listing, error) from None
    entries = _entries(listing)
    order = sorted(range(len(entries)), key=lambda i: _PRIORITY.get(entries[i]["kind"], 2))
    films: dict[int, Film] = {}
    for index in order:
        try:
            films[index] = _film(entries[index], folder, page_folder, room)
        except OSError as error:
            path = folder / entries[index]["file"]
            raise FileError.cannot_be("read", path, error) from None
        room -= len(films[index].source) + len(films[index].poster)
    return tuple(films[index] for index in range(len(entries)))


def _entries(listing: Path) -> list[dict[str, Any]]:
    """Return the rows of films.json."""
    with reading(listing, "does not list films", AGAIN):
        data = json.loads(listing.read_text(encoding="utf-8"))
        if data["schema"] != 1:
            raise ValueError(f"schema must be 1, got {data['schema']}")
        entries = [_required(entry) for entry in data["films"]]
    return entries


def _required(entry: dict[str, Any]) -> dict[str, Any]:
    """Return an entry if it is of the form that the page needs."""
    for name in ("file", "kind", "title"):
        if not isinstance(entry[name], str):
            raise ValueError(f"{name} must be a text, got {entry[name]!r}")
    for name in ("width", "height", "duration"):
        if not isinstance(entry[name], int | float) or not 0 < entry[name] < 1e9:
            raise ValueError(f"{name} must be a positive number, got {entry[name]!r}")
    for name in ("scenario", "command", "poster"):
        if not isinstance(entry.get(name), str | None):
            raise ValueError(f"{name} must be a text or null, got {entry[name]!r}")
    if not isinstance(entry.get("controllers", []), list):
        raise ValueError(f"controllers must be a list, got {entry['controllers']!r}")
    _require_beside(entry)
    return entry


def _require_beside(entry: dict[str, Any]) -> None:
    """Raise unless the files of an entry lie beside the list, and the film is an MP4."""
    for name in filter(None, (entry["file"], entry.get("poster"))):
        path = Path(name)
        if path.is_absolute() or ".." in path.parts:
            raise ValueError(f"file must lie beside films.json, got {name!r}")
    if not entry["file"].endswith(".mp4"):
        raise ValueError(f"file must end in .mp4, got {entry['file']!r}")


def _film(entry: dict[str, Any], folder: Path, page_folder: Path, room: int) -> Film:
    """Return one film, inside the page if it is small and there is room."""
    path = folder / entry["file"]
    size = path.stat().st_size if path.is_file() else 0
    poster = _poster(folder / entry["poster"]) if entry.get("poster") else ""
    taken = 4 * size // 3 + len(poster)
    if 0 < size <= SMALL and taken <= room:
        source = data_uri("video/mp4", path.read_bytes())
    else:
        source = quote(Path(os.path.relpath(path.resolve(), page_folder.resolve())).as_posix())
    return Film(
        title=entry["title"],
        kind=entry["kind"],
        scenario=entry.get("scenario"),
        controllers=tuple(str(name) for name in entry.get("controllers", ())),
        width=round(entry["width"]),
        height=round(entry["height"]),
        duration=float(entry["duration"]),
        command=entry.get("command") or render_command(entry.get("scenario")),
        deployed=_deployed(entry.get("deployment")),
        name=entry["file"],
        size=size,
        source=source,
        poster=poster,
    )


def render_command(scenario: str | None) -> str:
    """Return the command that makes the films of a scenario, or all of them."""
    return shlex.join(["afl-mujoco", "render", *filter(None, [scenario])])


def _deployed(deployment: object) -> str:
    """Say how the law was deployed in a film."""
    if not isinstance(deployment, dict):
        return ""
    step = deployment.get("timestep")
    period = deployment.get("control_period") or step
    if not (isinstance(step, int | float) and isinstance(period, int | float)):
        return ""
    times = f"{short(1e3 * step)} ms, force held for {short(1e3 * period)} ms."
    return f"{deployment.get('integrator', 'MuJoCo')} at {times}"


def _poster(path: Path) -> str:
    """Return a still as a small JPEG inside a data URI; nothing if there is no such file."""
    if not path.is_file():
        return ""
    try:
        with Image.open(path) as picture:
            small = picture.convert("RGB")
    except (UnidentifiedImageError, OSError) as error:
        raise FileError(str(path), f"must be a picture: {error}: {AGAIN}") from None
    small.thumbnail(POSTER_SIZE)
    stream = io.BytesIO()
    small.save(stream, "JPEG", quality=POSTER_QUALITY)
    return data_uri("image/jpeg", stream.getvalue())
