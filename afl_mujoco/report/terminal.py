"""Blocks on a terminal."""

from __future__ import annotations

import io
import os
import re
import sys
from collections.abc import Iterator, Sequence
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.cells import cell_len
from rich.console import Console
from rich.markdown import Markdown
from rich.table import Table
from rich.text import Text

from afl_mujoco.errors import printable
from afl_mujoco.report.blocks import Block, Matrix, Report, Section

WIDTH = 160  # number of columns if there is no terminal with a width
SHORT = 12  # largest width of texts that are not broken into lines [cells]
GAP = 3  # gap between two columns of a table [cells]
STYLES = {"good": "green", "neutral": "yellow", "bad": "bold red", "open": "magenta"}


def print_report(report: Report) -> None:
    """Print a report without figures and what is folded; its headline, the answer, stands last."""
    console = _console()
    _print(report.blocks, console)
    word = f"{report.word}: " if report.word else ""
    styles = {"good": "bold green", "bad": "bold red", "neutral": "bold yellow"}
    style = styles.get(report.status, "bold")
    console.print(_text(f"{word}{report.headline}", style), soft_wrap=True)


def print_blocks(found: Sequence[Block]) -> None:
    """Print blocks, without figures and what is folded."""
    _print(found, _console())


def _console() -> Console:
    """Return a console of the terminal's width, or of that of ``COLUMNS``."""
    known = sys.stdout.isatty() or "COLUMNS" in os.environ
    return Console(width=None if known else WIDTH, highlight=False)


def to_text(found: Sequence[Block]) -> str:
    """Return blocks as plain text, as wide as without a terminal."""
    stream = io.StringIO()
    _print(found, Console(file=stream, width=WIDTH, highlight=False))
    return "\n".join(line.rstrip() for line in stream.getvalue().strip("\n").splitlines())


def _print(found: Sequence[Block], console: Console) -> None:
    for block in found:
        if isinstance(block, str):
            if block.startswith("```"):  # a command, to be copied as it is
                console.print(_text("\n".join(block.splitlines()[1:-1])), soft_wrap=True)
            else:
                console.print(Markdown(re.sub(r"\]\(#[^)]*\)", "]", printable(block))))
            console.print()
        elif isinstance(block, Section) and not block.folded:
            console.print(_text(block.title, "bold"))
            _print(block.blocks, console)
        elif isinstance(block, Matrix) and not block.folded:
            if block.caption:
                console.print(_text(block.caption, "italic"))
            for part, needed in _tables(block, console.width):
                console.print(part, width=max(console.width, needed), crop=False)
            console.print()


def _text(text: str, style: str = "") -> Text:
    return Text(printable(text), style=style)


def _tables(matrix: Matrix, width: int) -> Iterator[tuple[Table, int]]:
    """Yield a matrix in parts that fit a width, if they can, and what each needs.

    No number or word is broken: a terminal that is too narrow breaks lines by itself.
    """
    rows = [[(printable(c.marked), STYLES.get(c.status, "")) for c in row] for row in matrix.cells]
    texts = [[head, *(row[k][0] for row in rows)] for k, head in enumerate(matrix.columns)]
    most = [max(map(cell_len, found)) for found in texts]
    words = [[cell_len(word) for text in found for word in text.split()] for found in texts]
    least = [
        full if number or full <= SHORT else max(some, default=0)
        for number, some, full in zip(matrix.numbers, words, most, strict=True)
    ]
    firsts = [row[0][0] for row in rows]
    names = 2 if len(set(firsts)) < len(firsts) and len(most) > 2 else 1
    for part in _parts(least, names, width - 1):
        shown = Table(box=SIMPLE_HEAD, show_edge=False)
        for k in part:
            side: Any = "right" if matrix.numbers[k] else "left"
            head = _text(matrix.columns[k])
            shown.add_column(head, justify=side, overflow="fold", min_width=least[k])
        above = ""
        for row in rows:
            cells = [Text(text, style=style) for text, style in (row[k] for k in part)]
            if row[0][0] == above:
                cells[0] = Text("")
            above = row[0][0]
            shown.add_row(*cells)
        yield shown, sum(least[k] + GAP for k in part) + 1


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
