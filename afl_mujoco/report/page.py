"""Reports as HTML: one self-contained page that works offline."""

from __future__ import annotations

import base64
import hashlib
import json
import os
from collections.abc import Container, Mapping, Sequence
from functools import cache
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

from jinja2 import Environment, PackageLoader, StrictUndefined
from markdown_it import MarkdownIt
from markupsafe import Markup

from afl_mujoco.errors import FileError, reading
from afl_mujoco.files import inside
from afl_mujoco.report.blocks import Figure, Film, Matrix, Replay, Report, Section, drawn_of

PACKAGE = "afl_mujoco.report"

LARGE = 400_000  # size above which a bitmap replaces a vector drawing, if it is smaller [bytes]

_ICON = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 16 16"><rect width="16" height="16" '
    'rx="3" fill="#0b5fb0"/><path d="M3 12h10M8 11 5 3" stroke="#fff" stroke-width="2"/></svg>'
)
_KINDS = {str: "text", Matrix: "matrix", Figure: "figure", Film: "film", Replay: "replay"}


def to_html(
    title: str,
    reports: Mapping[str, Report],
    folder: Path,
    last: Sequence[Section],
    files: Container[str],
) -> str:
    """Return a page of reports by anchor, the same bytes each time.

    Their figures are in the folder of the page, among some files, and become parts of it; others of
    these names are of other results. Films are linked.
    """
    sections = [Section(one.title, anchor, one.blocks) for anchor, one in reports.items()]
    films = [x for x in Section("", "", [*sections, *last]).walk() if isinstance(x, Film)]
    found: dict[type, dict[str, Any]] = {Figure: {}, Replay: {}}
    for one in drawn_of(sections):
        find: Any = _picture if isinstance(one, Figure) else _replay
        paths = {kind: inside(folder, name) for kind, name in one.files.items()}
        there = all(name in files for name in one.files.values())
        found[type(one)][one.name] = find(paths) if there else None
    judged = [report for report in reports.values() if report.passed is not None]
    failed = sum(not report.passed for report in judged)
    assets = resources.files(PACKAGE) / "assets"
    style, script = (
        Markup("".join((assets / name).read_text(encoding="utf-8") for name in names))
        for names in (("page.css", "replay.css"), ("replay.js", "page.js"))
    )
    page = _environment().get_template("page.html.j2")
    text = page.render(
        policy=_content_policy(style, script),
        style=style,
        script=script,
        icon_uri=_data_uri("image/svg+xml", _ICON.encode()),
        generator=f"afl_mujoco {version('afl_mujoco')}",
        title=sections[0].title if len(reports) == 1 else title,
        worst=min(judged, key=lambda report: bool(report.passed), default=None),
        among=f": {failed} of {len(judged)} parts" if failed and len(judged) > 1 else "",
        parts=list(zip(reports.values(), sections, strict=True)),
        last=last,
        pictures=found[Figure],
        films={film.file: linked(film, folder) for film in films},
        replays=found[Replay],
    )
    return text + "\n"


def replay_html(one: Replay) -> str:
    """Return a replay as a part of another page, which has `replay.css` and `replay.js`."""
    made: Any = _environment().get_template("replay.html.j2").module
    return str(made.replay(one, one.compute()))


@cache
def _environment() -> Environment:
    made = Environment(
        loader=PackageLoader(PACKAGE),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    markdown = MarkdownIt("commonmark", {"html": False}).enable("table").disable("image")
    filters: dict[str, Any] = {
        "markdown": lambda text: Markup(markdown.render(text)),
        "kind": lambda block: _KINDS.get(type(block), "section"),
    }
    made.filters.update(filters)
    return made


def _content_policy(style: str, script: str) -> str:
    """Allow what is inside a page by its hash, and pictures and films beside it."""
    of_style, of_script = (
        f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
        for text in (style, script)
    )
    beside = "'self' data: file:"
    return (
        f"default-src 'none'; img-src {beside}; media-src {beside}; "
        f"style-src {of_style}; script-src {of_script}; base-uri 'none'; form-action 'none'"
    )


# --- pictures and films -------------------------------------------------------------------------


class Picture(NamedTuple):
    """A figure as a page includes it."""

    source: str  # its data URI
    width: int  # of the bitmap [px]
    height: int


def _picture(paths: Mapping[str, Path]) -> Picture | None:
    """Return a figure as vectors unless these are large; None if its files are missing."""
    if not all(path.is_file() for path in paths.values()):
        return None
    svg, png = (_read(paths[kind]) for kind in ("svg", "png"))
    width, height = (int.from_bytes(png[at : at + 4], "big") for at in (16, 20))
    vectors = len(svg) <= max(LARGE, len(png))
    shown = _data_uri("image/svg+xml", svg) if vectors else _data_uri("image/png", png)
    return Picture(shown, width, height)


def _replay(paths: Mapping[str, Path]) -> Any:
    """Return what the script draws; None if its file is missing."""
    path = paths["json"]
    if not path.is_file():
        return None
    with reading(path, "is not a replay"):
        return json.loads(_read(path))


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise FileError.cannot_be("read", path, error) from None


def _data_uri(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def linked(film: Film, folder: Path) -> tuple[str, str]:
    """Return the addresses of a film and its still as seen from a folder; "" for what is gone."""

    def address(path: Path | None) -> str:
        if path is None or not path.is_file():
            return ""
        return quote(os.path.relpath(path.resolve(), folder.resolve()))

    return address(film.file), address(film.poster)
