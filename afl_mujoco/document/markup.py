"""The markup inside a paragraph: `code`, *emphasis*, and [links](#anchor) within the report."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

PLAIN, CODE, EMPHASIS, LINK = "plain", "code", "emphasis", "link"

_MARKED = re.compile(
    r"`(?P<code>[^`]+)`"
    r"|(?<![\w*])\*(?P<emphasis>[^*\s](?:[^*]*[^*\s])?)\*(?!\w)"
    r"|\[(?P<link>[^\[\]]+)\]\(#(?P<anchor>[\w-]+)\)"
)


class Span(NamedTuple):
    """A stretch of text in one style: `PLAIN`, `CODE`, `EMPHASIS`, or `LINK` with its anchor."""

    text: str
    style: str
    anchor: str = ""


def spans(text: str) -> Iterator[Span]:
    """Yield a paragraph as stretches of one style each."""
    end = 0
    for found in _MARKED.finditer(text):
        if found.start() > end:
            yield Span(text[end : found.start()], PLAIN)
        style = next(name for name in (CODE, EMPHASIS, LINK) if found[name] is not None)
        yield Span(found[style], style, found["anchor"] or "")
        end = found.end()
    if end < len(text):
        yield Span(text[end:], PLAIN)
