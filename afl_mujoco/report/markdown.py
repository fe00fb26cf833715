"""Blocks as GitHub-flavoured Markdown."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from afl_mujoco.report.blocks import Block, Figure, Film, Matrix, Replay, Section

_SPECIAL = re.compile(r"([\\`*_{}\[\]<>|])")


def to_markdown(found: Sequence[Block], level: int = 1) -> str:
    """Return blocks as Markdown, with headings from a level on; pictures are linked."""
    return "\n\n".join(_parts(found, level)) + "\n"


def _parts(found: Sequence[Block], level: int) -> Iterator[str]:
    for block in found:
        if isinstance(block, str):
            yield block
        elif isinstance(block, Section):
            yield f"{'#' * level} {plain(block.title)}"
            yield from _parts(block.blocks, level + 1)
        elif isinstance(block, Matrix):
            yield _table(block)
        elif isinstance(block, Figure):
            picture = f"![{plain(block.alt)}]({block.files['png'].replace(' ', '%20')})"
            yield f"{picture}\n\n**{plain(block.title)}.** {plain(block.caption)}".rstrip()
        elif isinstance(block, Film):
            said = f"**{plain(block.title)}.** {plain(block.caption)}"
            yield f"{said} {code(block.command)} makes it."
        elif not isinstance(block, Replay):  # it needs a page's script
            raise TypeError(block)


def _table(matrix: Matrix) -> str:
    """Return a matrix under its caption, folded where the page folds it."""
    sides = ("---:" if number else "---" for number in matrix.numbers)
    rows = [[plain(cell.marked).replace("\n", " ") for cell in row] for row in matrix.cells]
    lines = [[plain(header) for header in matrix.columns], [*sides], *rows]
    table = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    text = f"*{plain(matrix.caption)}*\n\n{table}" if matrix.caption else table
    if not matrix.folded:
        return text
    return f"<details><summary>{plain(matrix.folded)}</summary>\n\n{text}\n\n</details>"


def code(text: str) -> str:
    """Return text as code, even if it has backticks."""
    return f"`{text}`" if "`" not in text else f"`` {text} ``"


def plain(text: str) -> str:
    """Return text that is taken literally."""
    return _SPECIAL.sub(r"\\\1", text)
