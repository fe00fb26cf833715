"""A study is one file: what a toy study gets by being there, and what every study has."""

import re
from dataclasses import fields
from pathlib import Path

import pytest

from afl_mujoco.studies.shared.contract import studies
from afl_mujoco.studies.shared.record import save_record
from tests.study_results import record

ROOT = Path(__file__).parents[2]


def test_the_toy_study_is_one_file_that_nothing_else_names() -> None:
    sources = [*(ROOT / "afl_mujoco").rglob("*.py"), ROOT / "Makefile", ROOT / "pyproject.toml"]
    assert [path for path in sources if re.search(r"\bdice\b", path.read_text())] == []


def test_it_gets_a_command_files_a_terminal_and_markdown(toy, command_line, tmp_path) -> None:
    code, output, errors = command_line(toy, "nominal", "--throws", "3", "--out", "out")
    assert (code, errors) == (0, "") and output.splitlines()[-1] == "The mean is 4.00."
    assert "Every throw" in output and "Fair dice." in output
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written == {*(f"dice.{x}" for x in "json npz md svg png".split()), "report.html"}
    text = (tmp_path / "out" / "dice.md").read_text()
    assert "| 0 | 3 |" in text and "![3 throws.](dice.png)" in text
    assert "Made by `afl-mujoco dice nominal --throws 3`" in text


def test_it_is_put_into_the_page_beside_what_is_there(toy, command_line, tmp_path) -> None:
    folder = tmp_path / "renders" / "validation"
    folder.mkdir(parents=True)
    save_record(record("validate"), folder, figures=False)
    code, output, _ = command_line(toy)
    assert code == 0 and "renders/validation/report.html" in output
    page = (folder / "report.html").read_text()
    assert '<h2 id="dice-title">Dice</h2>' in page and 'href="#dice"' in page
    assert "<em>Fair</em> dice." in page and "CODES AGREE 22/22" in page
    assert page.count("The mean is") == 1 and command_line("report")[0] == 0
    assert (folder / "report.html").read_text() == page
    code, output, _ = command_line(toy, "--out", "own", "--no-page")
    assert code == 0 and not list((tmp_path / "own").glob("*.[hps][tnv][mg]*"))
    assert ".png" not in output + (tmp_path / "own" / "dice.md").read_text()
    assert (folder / "report.html").read_text() == page


@pytest.mark.parametrize("study", studies().values(), ids=list(studies()))
def test_every_study_has_what_the_contract_asks_for(study) -> None:
    assert "Example: afl-mujoco " + study.name in study.parts.Options.__doc__
    assert study.parts.Options()  # every option has a default
    assert fields(study.parts.Result)
