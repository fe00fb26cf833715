"""docs/verification.md says what the criteria say."""

from __future__ import annotations

from pathlib import Path

from afl_mujoco.studies.verification.criteria_table import criteria_table

PAGE = Path(__file__).parents[3] / "docs" / "verification.md"
BEGIN, END = "<!-- criteria -->\n", "<!-- end of criteria -->"


def test_the_table_of_criteria_is_printed_from_the_code() -> None:
    text = PAGE.read_text(encoding="utf-8")
    printed = text.partition(BEGIN)[2].partition(END)[0]
    assert printed == criteria_table(), "run: make docs"
