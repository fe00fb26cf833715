"""The pages hold what the code declares and what the results say, and nothing of it is typed."""

from __future__ import annotations

import re
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import jinja2
import pytest

from docs import make_results
from docs.content import DOCS, Content, readme, rewrite
from docs.sources import SOURCES

PAGES = sorted(
    page
    for page in DOCS.rglob("*.md")
    if not {"_build", "jupyter_execute"} & set(page.relative_to(DOCS).parts)
)
CONTENT = Content()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(DOCS)))
def test_every_page_gets_all_that_it_asks_for(page: Path) -> None:
    assert "{{" not in CONTENT.render(page.read_text(encoding="utf-8"))


def test_the_readme_says_what_the_results_say() -> None:
    text = (DOCS.parent / "README.md").read_text(encoding="utf-8")
    assert text == readme(CONTENT, text), "run: make docs"


def test_every_number_that_is_declared_is_in_a_page() -> None:
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    declared = tomllib.loads((DOCS / "numbers.toml").read_text(encoding="utf-8"))
    names = {f"{group}.{name}" for group, numbers in declared.items() for name in numbers}
    assert names - set(re.findall(r"{{ (\w+\.\w+) }}", text)) == set()
    assert set(declared) == set(CONTENT.numbers), "run: make results"


def test_every_result_of_the_pages_has_a_command() -> None:
    there = {path.name for path in (DOCS / "results").iterdir() if path.suffix != ".npz"}
    assert there - {"faults.json", "mutants.json", "mutants_again.json"} == {
        source.file for source in SOURCES
    }
    for source in SOURCES:
        text = (DOCS / "results" / source.file).read_text(encoding="utf-8")
        made = f"$ {source.command}\n" if source.benchmark else f'"command": "{source.command}"'
        assert made in text, source.file


def test_every_cheap_result_is_compared_by_a_number() -> None:
    assert all(CONTENT.numbers[source.name] for source in SOURCES if source.cheap)


def test_a_result_that_cannot_be_made_replaces_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(make_results, "MADE", tmp_path / "made")
    (tmp_path / "made").mkdir()
    (tmp_path / "made" / "margins.json").write_text("of an earlier run")
    (tmp_path / "margins.json").write_text("kept")
    monkeypatch.setattr(sys, "executable", "false")  # ends with 1, as a study that judges may
    with pytest.raises(SystemExit, match="margins ended with 1"):
        make_results.make(next(s for s in SOURCES if s.name == "margins"), tmp_path)
    assert (tmp_path / "margins.json").read_text() == "kept"


def test_a_number_that_nobody_declared_is_an_error() -> None:
    with pytest.raises(jinja2.UndefinedError, match="no_such_number"):
        CONTENT.render("{{ thresholds.no_such_number }}")


def test_a_number_is_news_beyond_its_uncertainty() -> None:
    now = Content()
    numbers = now.numbers["thresholds"]
    delay = numbers["delay_adaptive"]
    numbers["delay_adaptive"] = replace(delay, value=delay.value * (1.0 + 0.9 * delay.within))
    assert make_results.moved(CONTENT, now, ["thresholds"]) == []
    numbers["delay_adaptive"] = replace(delay, value=delay.value / (1.0 + 1.2 * delay.within))
    (said,) = make_results.moved(CONTENT, now, ["thresholds"])
    assert said.startswith(f"thresholds.delay_adaptive was {delay}, is ")


def test_round_off_may_be_ten_times_larger_but_not_a_billion_times() -> None:
    error = CONTENT.numbers["validate"]["b1"]
    assert not error.moved_to(replace(error, value=8.0 * error.value))
    assert error.moved_to(replace(error, value=1e9 * error.value))


def test_a_page_without_its_marks_is_refused() -> None:
    with pytest.raises(ValueError, match="must hold the marks of findings"):
        rewrite("<!-- findings -->\nall of the rest\n", "findings", "text")
