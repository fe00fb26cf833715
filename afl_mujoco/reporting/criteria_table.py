"""The table of criteria of docs/verification.md, printed from the code."""

from __future__ import annotations

import sys
from pathlib import Path

from afl_mujoco.output import write_text
from afl_mujoco.validation.criteria import CRITERIA


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


def rewrite(page: Path, name: str, text: str) -> None:
    """Put a text between its two marks in a page.

    Parameters
    ----------
    page
        The Markdown file.
    name
        Of the marks, ``<!-- name -->`` and ``<!-- end of name -->``.
    text
        What to put there.
    """
    begin, end = f"<!-- {name} -->\n", f"<!-- end of {name} -->"
    before, _, rest = page.read_text(encoding="utf-8").partition(begin)
    write_text(page, before + begin + text + end + rest.partition(end)[2])


if __name__ == "__main__":
    rewrite(Path(sys.argv[1]), "criteria", criteria_table())
