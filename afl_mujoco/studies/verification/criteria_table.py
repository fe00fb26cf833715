"""The table of criteria of docs/verification.md, printed from the code."""

from __future__ import annotations

import sys
from pathlib import Path

from afl_mujoco.errors import FileError
from afl_mujoco.files import write_text
from afl_mujoco.studies.verification.criteria import CRITERIA


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
    name
        Of the marks, ``<!-- name -->`` and ``<!-- end of name -->``.
    """
    begin, end = f"<!-- {name} -->\n", f"<!-- end of {name} -->"
    before, found, rest = page.read_text(encoding="utf-8").partition(begin)
    _, closed, after = rest.partition(end)
    if not (found and closed):
        raise FileError(str(page), f"must hold the marks of {name}, one after the other")
    write_text(page, before + begin + text + end + after)


if __name__ == "__main__":
    rewrite(Path(sys.argv[1]), "criteria", criteria_table())
