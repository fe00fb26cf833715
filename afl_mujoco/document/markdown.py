"""Sections as GitHub-flavoured Markdown."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import PurePath

from afl_mujoco.document import blocks
from afl_mujoco.document.markup import CODE, EMPHASIS, Span, spans

MARKS = {"": "", "good": "✓ ", "neutral": "◐ ", "bad": "✗ ", "open": "? "}

_SPECIAL = re.compile(r"([\\`*_{}\[\]<>|])")


def to_markdown(sections: Sequence[blocks.Section], level: int = 1) -> str:
    """Return sections as Markdown, with headings from a level on; pictures are linked."""
    return "\n\n".join(part for section in sections for part in _section(section, level)) + "\n"


def _section(section: blocks.Section, level: int) -> list[str]:
    """Return a section's paragraphs."""
    parts = [f"{'#' * level} {_plain(section.title)}"]
    for block in section.blocks:
        if isinstance(block, blocks.Section):
            parts += _section(block, level + 1)
        elif not isinstance(block, blocks.Chart):  # it needs a page's script
            parts.append(as_paragraph(block))
    return parts


def as_paragraph(block: blocks.Block) -> str:
    """Return a block that is not a section as a paragraph."""
    if isinstance(block, blocks.Finding):
        return f"**{_plain(block.lead)}.** {_marked(block.text)}"
    if isinstance(block, blocks.Text):
        return _marked(block.text)
    if isinstance(block, blocks.Command):
        return f"{_plain(block.lead)}:\n\n```sh\n{block.typed(PurePath())}\n```"
    if isinstance(block, blocks.Figure):
        picture = f"![{_plain(block.alt)}]({block.files['png'].replace(' ', '%20')})"
        return f"{picture}\n\n**{_plain(block.title)}.** {_plain(block.caption)}"
    if isinstance(block, blocks.Verdict):
        return f"**{block.word}**: {_plain(block.text)}. {_marked(block.meaning)}".rstrip()
    if isinstance(block, blocks.Tally):
        said = (f"{MARKS[tag.status]}{_plain(tag.name)} {tag.meaning}" for tag in block.tags)
        return f"{_plain(block.title)}: {'; '.join(said)}"
    if isinstance(block, blocks.Facts):
        return "\n".join(f"- **{_plain(f.label)}** {_marked(f.text)}" for f in block.facts)
    if isinstance(block, blocks.Film):
        return f"**{_plain(block.title)}.** {_marked(block.caption)} `{block.command}` makes it."
    if isinstance(block, blocks.Table):
        return _table(block)
    raise TypeError(block)


def _table(table: blocks.Table) -> str:
    """Return a table under its caption, folded where the page folds it."""
    lines = [
        "| " + " | ".join(_plain(column.title) for column in table.columns) + " |",
        "| " + " | ".join("---:" if c.number else "---" for c in table.columns) + " |",
    ]
    lines += ["| " + " | ".join(_cell(cell) for _, cell in row) + " |" for row in table.cells]
    text = f"*{_plain(table.caption)}*\n\n" + "\n".join(lines)
    if not table.summary:
        return text
    return f"<details><summary>{_plain(table.summary)}</summary>\n\n{text}\n\n</details>"


def _cell(cell: blocks.Cell) -> str:
    """Return a cell with its status."""
    text = MARKS[cell.status] + _styled(cell, cell.text.replace("\n", " "))
    return f"{text}<br>{_marked(cell.note)}".replace("\n", " ") if cell.note else text


def _styled(cell: blocks.Cell, text: str) -> str:
    """Return the text of a cell in its style."""
    if cell.code:
        return _code(text).replace("|", "\\|")
    return f"**{_plain(text)}**" if cell.strong else _plain(text)


def _marked(text: str) -> str:
    """Return a paragraph with its markup."""
    return "".join(_span(span) for span in spans(text))


def _span(span: Span) -> str:
    """Return a stretch of text in its style; a link is only text, as Markdown has no anchors."""
    if span.style == CODE:
        return _code(span.text)
    return f"*{_plain(span.text)}*" if span.style == EMPHASIS else _plain(span.text)


def _code(text: str) -> str:
    """Return text as code, even if it has backticks."""
    return f"`{text}`" if "`" not in text else f"`` {text} ``"


def _plain(text: str) -> str:
    """Return text that is taken literally."""
    return _SPECIAL.sub(r"\\\1", text)
