"""The table of criteria of docs/verification.md, printed from the code."""

from __future__ import annotations

import sys
from pathlib import Path

from afl_mujoco.output import write_text
from afl_mujoco.validation.criteria import CRITERIA

BEGIN, END = "<!-- criteria -->\n", "<!-- end of criteria -->"


def criteria_table() -> str:
    """Return every criterion as a Markdown table."""
    header = ("check", "quantity", "unit", "limit", "why this limit", "proves", "leaves open")
    rows = [
        (c.id, c.quantity, c.unit, f"{c.limit:g}", c.reason, c.proves, c.leaves_open)
        for c in CRITERIA.values()
    ]
    lines = [header, ("---",) * len(header), *rows]
    cells = [[cell.replace("|", "\\|") for cell in line] for line in lines]
    return "".join("| " + " | ".join(line) + " |\n" for line in cells)


def rewrite(page: Path) -> None:
    """Put the table between its two marks in a page.

    Parameters
    ----------
    page
        The Markdown file.
    """
    before, _, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    write_text(page, before + BEGIN + criteria_table() + END + rest.partition(END)[2])


if __name__ == "__main__":
    rewrite(Path(sys.argv[1]))
