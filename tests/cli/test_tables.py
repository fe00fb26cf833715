"""The documentation says what the code declares."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from afl_mujoco.cli.tables import claims_table, measured_tables, tables
from afl_mujoco.document.markdown import rewrite
from afl_mujoco.errors import FileError
from afl_mujoco.studies.record import save_record
from tests.study_results import record
from tests.verification_result import make_result

DOCS = Path(__file__).parents[2] / "docs"
TABLES = {**tables(), **measured_tables(DOCS)}


@pytest.mark.parametrize(("page", "name"), TABLES)
def test_a_table_of_the_documentation_is_that_of_the_code(page: str, name: str) -> None:
    text = (DOCS / page).read_text(encoding="utf-8")
    printed = text.partition(f"<!-- {name} -->\n")[2].partition(f"<!-- end of {name} -->")[0]
    assert printed == TABLES[page, name], "run: make docs"


def test_a_page_gets_the_claims_of_a_report_between_its_marks(tmp_path: Path) -> None:
    report = save_record(record("validate"), tmp_path, figures=False)[0]
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- claims -->\nold\n<!-- end of claims -->\nafter\n")
    rewrite(page, "claims", claims_table(report))
    text = page.read_text()
    assert text.startswith("before\n<!-- claims -->\n|  | claim | paper | here |")
    row = "| C3 | claim 3 has \\|F\\| & <angles>; *improvement of the objective (O1) [%]* | 38.03 |"
    assert row in text
    assert "old" not in text
    assert text.endswith("<!-- end of claims -->\nafter\n")


def test_a_page_without_its_marks_and_a_report_without_claims_are_refused(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("<!-- claims -->\nall of the rest\n")
    with pytest.raises(FileError, match="must have the two marks of claims"):
        rewrite(page, "claims", "text")
    assert page.read_text() == "<!-- claims -->\nall of the rest\n"
    bare = replace(record("validate"), result=make_result(full=False))
    report = save_record(bare, tmp_path, figures=False)[0]
    with pytest.raises(FileError, match="must hold claims"):
        claims_table(report)
