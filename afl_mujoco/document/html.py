"""Sections as HTML: a part of a page, or one page that holds all it needs and works offline."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from jinja2 import BaseLoader, ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from afl_mujoco.document import blocks, numbers
from afl_mujoco.document.markup import CODE, EMPHASIS, LINK, spans
from afl_mujoco.document.pictures import Picture, data_uri, find_picture

PACKAGE = "afl_mujoco.document"

_ICON = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 16 16"><rect width="16" height="16" '
    'rx="3" fill="#0b5fb0"/><path d="M3 12h10M8 11 5 3" stroke="#fff" stroke-width="2"/></svg>'
)
_TAGS = {CODE: "code", EMPHASIS: "em"}


def write_sections(sections: Sequence[blocks.Section], folder: Path, level: int = 2) -> Markup:
    """Return sections as a part of a page, its first headings of a level from 1 to 6.

    The pictures, from the files in `folder`, are inside it; a missing one is said to be missing.
    """
    pictures = {figure.name: _picture(figure, folder) for figure in blocks.figures_of(sections)}
    template = environment().get_template("sections.html.j2")
    return Markup(template.render(sections=sections, pictures=pictures, folder=folder, level=level))


def to_html(title: str, sections: Sequence[blocks.Section], folder: Path) -> str:
    """Return sections as a page of its own; arguments as of `write_sections`."""
    body = write_sections(sections, folder)
    template = environment().get_template("document.html.j2")
    return template.render(**frame(), title=title, sections=sections, body=body) + "\n"


def frame() -> Mapping[str, Any]:
    """Return what every page has around its content: policy, style, script, icon."""
    style, script = _style(), _script()
    policy, icon = content_policy(style, script), data_uri("image/svg+xml", _ICON.encode())
    return {"policy": policy, "style": style, "script": script, "icon": icon}


def environment(*loaders: BaseLoader) -> Environment:
    """Return the templates of `loaders` and this package, which escape whatever they are given."""
    made = Environment(
        loader=ChoiceLoader([*loaders, PackageLoader(PACKAGE)]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters.update(
        short=numbers.short,
        fixed=numbers.fixed,
        percent=numbers.percent,
        upper_first=numbers.sentence,
        marked=_marked,
    )
    return made


def content_policy(style: str, script: str) -> str:
    """Return a page's Content-Security-Policy: what is inside it, pictures and films beside it."""
    beside = "'self' data: file:"
    return (
        f"default-src 'none'; img-src {beside}; media-src {beside}; "
        f"style-src {_hash(style)}; script-src {_hash(script)}; base-uri 'none'; form-action 'none'"
    )


def _picture(figure: blocks.Figure, folder: Path) -> Picture | None:
    """Return a figure's picture, if its files are there."""
    words = {"title": figure.title, "caption": figure.caption, "alt": figure.alt}
    return find_picture({**words, **figure.files}, folder)


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
    """Return a text's hash as a policy names it."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


@cache
def _asset(name: str) -> str:
    """Return a file of the package."""
    return resources.files(PACKAGE).joinpath(name).read_text(encoding="utf-8")


def _style() -> Markup:
    """Return the style sheet."""
    return Markup(_asset("vendor/uPlot.min.css") + "\n" + _asset("assets/page.css"))


def _script() -> Markup:
    """Return the script, with the licence of what is in it."""
    licence = f"/*! uPlot\n{_asset('vendor/uPlot.LICENSE')}*/\n"
    parts = ("vendor/uPlot.iife.min.js", "assets/charts.js", "assets/page.js")
    return Markup(licence + "\n".join(_asset(part) for part in parts))
