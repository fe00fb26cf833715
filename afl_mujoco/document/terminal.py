"""Sections on a terminal."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table as RichTable
from rich.text import Text as RichText

from afl_mujoco.document import blocks
from afl_mujoco.document.markup import CODE, EMPHASIS, spans

WIDTH = 160
"""Columns where there is no terminal that has a width."""

STYLES = {CODE: "cyan", EMPHASIS: "italic"}
STATUS_STYLES = {"good": "green", "neutral": "yellow", "bad": "bold red", "open": "magenta"}
MARKS = {"": "", "good": "", "neutral": "◐ ", "bad": "✗ ", "open": "? "}
"""Before a cell, so that its status does not depend on colour alone."""

NOT_SHOWN = (blocks.Chart, blocks.Film)
"""What a terminal has no way to show."""


def print_sections(
    sections: Sequence[blocks.Section], folder: Path, console: Console | None = None
) -> None:
    """Print sections, their files in `folder`: no notes, and of what is folded only what it is."""
    for section in sections:
        if not section.folded:
            _print_section(section, folder, console or _console())


def print_verdict(verdict: blocks.Verdict) -> None:
    """Print a verdict in one line."""
    colour = "bold green" if verdict.passed else "bold red"
    _console().print(RichText(f"{verdict.word}: {verdict.text}", style=colour), soft_wrap=True)


def _console() -> Console:
    """Return the terminal, or what stands for one."""
    return Console(width=None if sys.stdout.isatty() else WIDTH, highlight=False)


def _print_section(section: blocks.Section, folder: Path, console: Console) -> None:
    """Print a heading and what follows."""
    console.print(RichText(f"\n{section.title}", style="bold"))
    for block in section.blocks:
        if isinstance(block, blocks.Section):
            print_sections([block], folder, console)
        elif isinstance(block, NOT_SHOWN) or (isinstance(block, blocks.Text) and block.note):
            continue
        elif isinstance(block, blocks.Table) and not block.summary:
            console.print(_table(block))
        else:
            console.print(_line(block, folder), soft_wrap=isinstance(block, blocks.Command))


def _line(block: blocks.Block, folder: Path) -> RichText:
    """Return a block other than a table that is shown."""
    if isinstance(block, blocks.Finding):
        return RichText.assemble((f"{block.lead}: ", "bold"), _marked(block.text))
    if isinstance(block, blocks.Text):
        return _marked(block.text)
    if isinstance(block, blocks.Command):  # as it is typed, to be copied
        return RichText(f"{block.lead}: {block.typed(folder)}")
    if isinstance(block, blocks.Table):
        rows = f"{len(block.rows)} row{'s' * (len(block.rows) != 1)}"
        return RichText(f"[{block.summary}: {rows}, not shown here]", style="dim")
    if isinstance(block, blocks.Figure):
        return RichText(f"[{block.title}: {folder / block.files['png']}]", style="dim")
    if isinstance(block, blocks.Verdict):
        return RichText(f"{block.word}: {block.text}", style="bold")
    if isinstance(block, blocks.Tally):
        said = (f"{count} {meaning}" for (_, meaning), count in block.counts.items())
        return RichText(f"{block.title}: {', '.join(said)}")
    if isinstance(block, blocks.Facts):
        return RichText("\n").join(
            RichText.assemble((f"{fact.label}: ", "bold"), _marked(fact.text))
            for fact in block.facts
        )
    raise TypeError(block)


def _marked(text: str) -> RichText:
    """Return a paragraph with its markup."""
    found = RichText()
    for span in spans(text):
        found.append(span.text, STYLES.get(span.style, ""))
    return found


def _style(cell: blocks.Cell) -> str:
    """Return the style of a cell."""
    return STATUS_STYLES.get(cell.status, "bold" if cell.strong else "")


def _table(table: blocks.Table) -> RichTable:
    """Return a table; what leads in a row and repeats the row above is left out."""
    shown = RichTable(box=SIMPLE_HEAD, title=RichText(table.caption), title_justify="left")
    for column in table.columns:
        side: Any = "right" if column.number else "left"
        shown.add_column(RichText(column.title), justify=side, overflow="fold")
    above: list[str] = []
    for row in table.cells:
        texts = [MARKS[cell.status] + cell.text for _, cell in row]
        styles = [_style(cell) for _, cell in row]
        repeated = texts[0] if above[:1] == texts[:1] else None
        above = list(texts)
        if repeated is not None:
            texts[0] = ""
        shown.add_row(*(RichText(t, style=s) for t, s in zip(texts, styles, strict=True)))
    return shown
