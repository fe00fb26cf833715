"""Sections on a terminal."""

from __future__ import annotations

import io
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.cells import cell_len
from rich.console import Console
from rich.table import Table as RichTable
from rich.text import Text as RichText

from afl_mujoco.document import blocks
from afl_mujoco.document.markup import CODE, EMPHASIS, spans
from afl_mujoco.errors import printable

WIDTH = 160
"""Number of columns if there is no terminal with a width."""

SHORT = 12
"""Largest width of texts that are not broken into lines [cells]."""

GAP = 3
"""Gap between two columns of a table [cells]."""

STYLES = {CODE: "cyan", EMPHASIS: "italic"}
STATUS_STYLES = {"good": "green", "neutral": "yellow", "bad": "bold red", "open": "magenta"}
MARKS = {"": "", "good": "", "neutral": "◐ ", "bad": "✗ ", "open": "? "}
"""Mark before a cell, so that its status does not depend on colour alone."""

NOT_SHOWN = (blocks.Chart, blocks.Film)
"""Blocks that a terminal cannot show."""


def print_sections(
    sections: Sequence[blocks.Section], folder: Path, console: Console | None = None
) -> None:
    """Print sections with their files in `folder`, without notes and folded sections."""
    for section in sections:
        if not section.folded:
            _print_section(section, folder, console or _console())


def to_text(found: Sequence[blocks.Block]) -> str:
    """Return blocks of text and tables as plain text, as wide as without a terminal."""
    stream = io.StringIO()
    _print_blocks(found, Path(), Console(file=stream, width=WIDTH, highlight=False))
    return "\n".join(line.rstrip() for line in stream.getvalue().strip("\n").splitlines())


def print_verdict(verdict: blocks.Verdict) -> None:
    """Print a verdict in one line."""
    colour = "bold green" if verdict.passed else "bold red"
    _console().print(_text(f"{verdict.word}: {verdict.text}", colour), soft_wrap=True)


def _console() -> Console:
    """Return the terminal, or its replacement of a fixed width."""
    return Console(width=None if sys.stdout.isatty() else WIDTH, highlight=False)


def _print_section(section: blocks.Section, folder: Path, console: Console) -> None:
    """Print a heading and what follows."""
    console.print(_text(f"\n{section.title}", "bold"))
    _print_blocks(section.blocks, folder, console)


def _print_blocks(found: Sequence[blocks.Block], folder: Path, console: Console) -> None:
    """Print blocks one after another."""
    for block in found:
        if isinstance(block, blocks.Section):
            print_sections([block], folder, console)
        elif isinstance(block, NOT_SHOWN) or (isinstance(block, blocks.Text) and block.note):
            continue
        elif isinstance(block, blocks.Table) and not block.summary:
            for part in _tables(block, console.width):
                console.print(part)
        else:
            console.print(_line(block, folder), soft_wrap=isinstance(block, blocks.Command))


def _line(block: blocks.Block, folder: Path) -> RichText:
    """Return a block that is not a table, or the line that replaces a folded table."""
    if isinstance(block, blocks.Finding):
        return RichText.assemble(_text(f"{block.lead}: ", "bold"), _marked(block.text))
    if isinstance(block, blocks.Text):
        return _marked(block.text)
    if isinstance(block, blocks.Command):  # as it is typed, to be copied
        return _text(f"{block.lead}: {block.typed(folder)}")
    if isinstance(block, blocks.Table):
        rows = f"{len(block.rows)} row{'s' * (len(block.rows) != 1)}"
        return _text(f"[{block.summary}: {rows}, not shown here]", "dim")
    if isinstance(block, blocks.Figure):
        return _text(f"[{block.title}: {folder / block.files['png']}]", "dim")
    if isinstance(block, blocks.Verdict):
        return _text(f"{block.word}: {block.text}", "bold")
    if isinstance(block, blocks.Tally):
        said = (f"{count} {meaning}" for (_, meaning), count in block.counts.items())
        return _text(f"{block.title}: {', '.join(said)}")
    if isinstance(block, blocks.Facts):
        return RichText("\n").join(
            RichText.assemble(_text(f"{fact.label}: ", "bold"), _marked(fact.text))
            for fact in block.facts
        )
    raise TypeError(block)


def _text(text: str, style: str = "") -> RichText:
    """Return a text of one style."""
    return RichText(printable(text), style=style)


def _marked(text: str) -> RichText:
    """Return a paragraph with its markup."""
    found = RichText()
    for span in spans(printable(text)):
        found.append(span.text, STYLES.get(span.style, ""))
    return found


def _style(cell: blocks.Cell) -> str:
    """Return the style of a cell."""
    return STATUS_STYLES.get(cell.status, "bold" if cell.strong else "")


def _tables(table: blocks.Table, width: int) -> Iterator[RichTable]:
    """Yield a table in parts that fit a width, each with the columns that name the rows.

    Numbers and words are not broken. A first cell that repeats the one above is left out.
    """
    rows = [
        [(printable(MARKS[cell.status] + cell.text), _style(cell)) for _, cell in row]
        for row in table.cells
    ]
    texts = [[column.title, *(row[k][0] for row in rows)] for k, column in enumerate(table.columns)]
    most = [max(map(cell_len, found)) for found in texts]
    least = [
        full if column.number or full <= SHORT else max(map(_longest_word, found))
        for column, found, full in zip(table.columns, texts, most, strict=True)
    ]
    firsts = [row[0][0] for row in rows]
    names = 2 if len(set(firsts)) < len(firsts) and len(most) > 2 else 1
    title = table.caption
    for part in _parts(least, names, width - 1):
        shown = RichTable(box=SIMPLE_HEAD, title=_text(title), title_justify="left")
        widths = _widths([least[k] for k in part], [most[k] for k in part], width - 1)
        for k, wide in zip(part, widths, strict=True):
            column = table.columns[k]
            side: Any = "right" if column.number else "left"
            shown.add_column(_text(column.title), justify=side, overflow="fold", width=wide)
        above = ""
        for row in rows:
            cells = [RichText(text, style=style) for text, style in (row[k] for k in part)]
            if row[0][0] == above:
                cells[0] = RichText("")
            above = row[0][0]
            shown.add_row(*cells)
        yield shown
        title = f"{table.caption} (continued)"


def _longest_word(text: str) -> int:
    """Return the width of the longest word of a text [cells]."""
    return max(map(cell_len, text.split()), default=0)


def _parts(least: Sequence[int], names: int, width: int) -> list[list[int]]:
    """Return the columns of each part of a table, the first of which name its rows."""
    first = list(range(names))
    parts, room = [[*first]], width - sum(least[k] + GAP for k in first)
    left = room
    for k in range(names, len(least)):
        if least[k] + GAP > left and len(parts[-1]) > names:
            parts.append([*first])
            left = room
        parts[-1].append(k)
        left -= least[k] + GAP
    return parts


def _widths(least: Sequence[int], most: Sequence[int], width: int) -> list[int]:
    """Return the widths of columns: all that they can use, or a fair share of the width."""
    widths = list(most)
    while sum(widths) + GAP * len(widths) > width:
        spare = [(wide - low, k) for k, (wide, low) in enumerate(zip(widths, least, strict=True))]
        most_spare, k = max(spare)
        if most_spare <= 0:
            break
        widths[k] -= 1
    return widths
