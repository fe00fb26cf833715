"""The pages hold what the code declares and what the results say, and nothing of it is typed."""

import json
import re
import sys
import tomllib
from dataclasses import fields

import jinja2
import pytest

from afl_mujoco.identification.prediction import ESTIMATES
from afl_mujoco.scenario.imperfections import Imperfections
from afl_mujoco.studies.shared.contract import studies
from docs import make_results
from docs.content import DOCS, FIGURES, PAGES, README, Content, rewrite, shown_in
from docs.sources import SOURCES
from docs.tables import cells_as_table, tables
from tests.planted_faults import load_faults

CONTENT, IDENTIFIED = Content(), DOCS / "results" / "identify.json"


@pytest.fixture(scope="module")
def made():
    return CONTENT.pages()


def test_a_page_is_as_it_is_made_asks_for_nothing_and_has_every_figure_that_it_shows(made) -> None:
    for page, text in made.items():
        assert page.read_text(encoding="utf-8") == text, f"{page.name}: run make docs"
    pages = {page for page in DOCS.rglob("*.md") if "_build" not in page.parts} | {README}
    there = {page for page in pages if PAGES not in page.parents}
    assert {page for page in made if page.suffix == ".md"} < there
    assert [page for page in there if "{{ " in page.read_text(encoding="utf-8")] == []
    there = {path.stem for path in (DOCS / FIGURES).iterdir()}
    assert there == shown_in(made.values()), "run: make docs"


def test_links_go_by_the_way_from_their_page_and_every_number_is_in_one(made) -> None:
    finding = "(docs/explanation/claims.md#random-schedules)"
    assert finding in made[README] and finding.replace("docs/", "") in made[DOCS / "index.md"]
    assert "](../figures/thresholds.png)" in made[DOCS / "explanation" / "robustness.md"]
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES.rglob("*.md"))
    declared = tomllib.loads((DOCS / "numbers.toml").read_text(encoding="utf-8"))
    names = {f"{group}.{name}" for group, numbers in declared.items() for name in numbers}
    assert names - set(re.findall(r"{{ (\w+\.\w+) }}", text)) == set()
    assert set(declared) == set(CONTENT.numbers), "run: make results"
    cheap = [source.name for source in SOURCES if source.cheap and not source.script]
    assert all(CONTENT.numbers[name] for name in cheap)


def test_every_result_has_a_command_and_a_failure_replaces_nothing(tmp_path, monkeypatch):
    there = {path.name for path in (DOCS / "results").iterdir() if path.suffix != ".npz"}
    listed = {source.file for source in SOURCES}
    assert there - {"faults.json", "mutants.json", "mutants_again.json"} == listed
    for source in SOURCES:
        text = (DOCS / "results" / source.file).read_text(encoding="utf-8")
        made = f"$ {source.command}\n" if source.script else f'"command": "{source.command}"'
        assert made in text, source.file
    monkeypatch.setattr(make_results, "MADE", tmp_path / "made")
    (tmp_path / "made").mkdir()
    (tmp_path / "made" / "margins.json").write_text("of an earlier run")
    (tmp_path / "margins.json").write_text("kept")
    monkeypatch.setattr(sys, "executable", "false")  # ends with 1, as a study that judges may
    with pytest.raises(SystemExit, match="margins ended with 1"):
        make_results.make(next(s for s in SOURCES if s.name == "margins"), tmp_path)
    assert (tmp_path / "margins.json").read_text() == "kept"


def test_a_number_that_nobody_declared_and_a_page_without_its_marks_are_refused() -> None:
    with pytest.raises(jinja2.UndefinedError, match="no_such_number"):
        CONTENT.render("{{ thresholds.no_such_number }}")
    with pytest.raises(ValueError, match="must hold the marks of findings"):
        rewrite("<!-- findings -->\nall of the rest\n", "findings", "text")


def test_every_imperfection_result_and_fault_has_a_row_and_a_cell_may_hold_a_bar() -> None:
    found = tables()
    assert all(f"| `{one.name}` |" in found["imperfections"] for one in fields(Imperfections))
    assert all(f"`{study.stem}.json`" in found["result files"] for study in studies().values())
    rows = CONTENT.table("faults")
    assert "not run" not in rows, "run: make faults"
    assert [f.name for f in load_faults() if f"| {f.name} |" not in rows.replace("\\|", "|")] == []
    assert cells_as_table(("a",), [("|x|",)]) == "| a |\n| --- |\n| \\|x\\| |\n"


def test_the_estimates_that_ship_are_those_of_the_page_on_identification() -> None:
    shipped, made = (json.loads(x.read_text("utf-8")) for x in (ESTIMATES, IDENTIFIED))
    assert shipped == made["identified"]  # else: copy estimates.json, which identify writes
