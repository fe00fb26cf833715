"""The documentation says what the code declares."""

from __future__ import annotations

from pathlib import Path

import pytest

from afl_mujoco.cli.tables import tables

DOCS = Path(__file__).parents[1] / "docs"
TABLES = tables()


@pytest.mark.parametrize(("page", "name"), TABLES)
def test_a_table_of_the_documentation_is_that_of_the_code(page: str, name: str) -> None:
    text = (DOCS / page).read_text(encoding="utf-8")
    printed = text.partition(f"<!-- {name} -->\n")[2].partition(f"<!-- end of {name} -->")[0]
    assert printed == TABLES[page, name], "run: make docs"
