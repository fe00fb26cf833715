"""Sections as HTML: one self-contained page that works offline."""

from __future__ import annotations

import base64
import hashlib
import itertools
from collections.abc import Iterator, Sequence
from functools import cache
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from typing import TypeAlias

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from afl_mujoco.document import blocks, numbers
from afl_mujoco.document.films import show_films
from afl_mujoco.document.markup import CODE, EMPHASIS, LINK, spans
from afl_mujoco.document.pictures import data_uri, find_picture

PACKAGE = "afl_mujoco.document"

Part: TypeAlias = tuple[Sequence[blocks.Section], Path]
"""Sections, and the folder of their figures."""

_ICON = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 16 16"><rect width="16" height="16" '
    'rx="3" fill="#0b5fb0"/><path d="M3 12h10M8 11 5 3" stroke="#fff" stroke-width="2"/></svg>'
)
_TAGS = {CODE: "code", EMPHASIS: "em"}


def to_html(
    title: str,
    parts: Sequence[Part],
    page_folder: Path,
    *,
    lede: str = "",
    verdict: blocks.Verdict | None = None,
    ahead: Path | None = None,
) -> str:
    """Return a page, the same bytes each time.

    Pictures and small films are inside it; it says which ones are missing.

    Parameters
    ----------
    page_folder
        Where the page will be: large films are linked from there.
    lede
        Text below the title.
    verdict
        Verdict that the title and the contents show.
    ahead
        Folder of pictures that are to replace those of the same names.
    """
    sections = [section for found, _ in parts for section in found]
    every = [block for section in sections for block in section.walk()]
    films = show_films([block for block in every if isinstance(block, blocks.Film)], page_folder)
    template = _environment().get_template("sections.html.j2")
    body = [
        template.render(
            sections=found, folder=folder, films=films,
            pictures={
                figure.name: (ahead and find_picture(figure.files, ahead))
                or find_picture(figure.files, folder)
                for figure in blocks.figures_of(found)
            },
        )
        for found, folder in parts
    ]  # fmt: skip
    style, script = _style(), _script()
    return (
        _environment()
        .get_template("document.html.j2")
        .render(
            policy=content_policy(style, script),
            style=style,
            script=script,
            icon=data_uri("image/svg+xml", _ICON.encode()),
            generator=f"afl_mujoco {version('afl_mujoco')}",
            title=title,
            lede=lede,
            verdict=verdict,
            contents=sections,
            body=Markup("\n".join(body)),
            charts=[block for block in every if isinstance(block, blocks.Chart)],
        )
        + "\n"
    )


@cache
def _environment() -> Environment:
    """Return the templates, which escape all values."""
    made = Environment(
        loader=PackageLoader(PACKAGE),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters.update(short=numbers.short, fixed=numbers.fixed, marked=_marked, runs=_runs)
    return made


def _runs(found: Sequence[blocks.Block]) -> Iterator[tuple[str, list[blocks.Block]]]:
    """Yield runs of consecutive blocks of one kind."""
    for kind, run in itertools.groupby(found, key=lambda block: block.kind):
        yield kind, list(run)


def content_policy(style: str, script: str) -> str:
    """Return a page's Content-Security-Policy: what is inside it, pictures and films beside it."""
    beside = "'self' data: file:"
    return (
        f"default-src 'none'; img-src {beside}; media-src {beside}; "
        f"style-src {_hash(style)}; script-src {_hash(script)}; base-uri 'none'; form-action 'none'"
    )


def _marked(text: str) -> Markup:
    """Return a paragraph with its markup."""
    parts = []
    for span in spans(text):
        said = escape(span.text)
        if span.style == LINK:
            said = Markup(f'<a href="#{escape(span.anchor)}">{said}</a>')
        elif tag := _TAGS.get(span.style):
            said = Markup(f"<{tag}>{said}</{tag}>")
        parts.append(said)
    return Markup("").join(parts)


def _hash(text: str) -> str:
    """Return the hash of a text in the notation of a policy."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


@cache
def _asset(name: str) -> str:
    """Return a file of the package."""
    return resources.files(PACKAGE).joinpath(name).read_text(encoding="utf-8")


def _style() -> Markup:
    """Return the style sheet."""
    return Markup(_asset("vendor/uPlot.min.css") + "\n" + _asset("assets/page.css"))


def _script() -> Markup:
    """Return the script, with the licence of the library in it."""
    licence = f"/*! uPlot\n{_asset('vendor/uPlot.LICENSE')}*/\n"
    parts = ("vendor/uPlot.iife.min.js", "assets/charts.js", "assets/page.js")
    return Markup(licence + "\n".join(_asset(part) for part in parts))
