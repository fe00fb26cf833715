"""The markup inside a paragraph: `code` and *emphasis*."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

PLAIN, CODE, EMPHASIS = "plain", "code", "emphasis"

_MARKED = re.compile(r"`(?P<code>[^`]+)`|(?<![\w*])\*(?P<emphasis>[^*\s](?:[^*]*[^*\s])?)\*(?!\w)")


class Span(NamedTuple):
    """A stretch of text in one style: `PLAIN`, `CODE` or `EMPHASIS`."""

    text: str
    style: str


def spans(text: str) -> Iterator[Span]:
    """Return a paragraph as stretches of one style each."""
    end = 0
    for found in _MARKED.finditer(text):
        if found.start() > end:
            yield Span(text[end : found.start()], PLAIN)
        yield Span(found[str(found.lastgroup)], str(found.lastgroup))
        end = found.end()
    if end < len(text):
        yield Span(text[end:], PLAIN)
