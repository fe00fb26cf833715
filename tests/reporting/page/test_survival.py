"""What the page says of the survival studies: sentences and tables from made-up numbers."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
import survival_case
from page_case import NASTY, make_curves, make_report

from afl_mujoco.errors import FileError
from afl_mujoco.reporting.page.inputs.studies import NAMES, Study, load_studies
from afl_mujoco.reporting.page.page import render_page
from afl_mujoco.reporting.page.survival.sentences import survival_sentences
from afl_mujoco.reporting.page.survival.tables import delay_rows, margin_rows, measured_text


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return survival_case.write_studies(tmp_path)


def sentences(folder: Path) -> dict[str, str]:
    return {s.lead: s.text for s in survival_sentences(load_studies(folder))}


def plain(page: str) -> str:
    return re.sub(r"\s+", " ", re.sub(r"<[^>]*>", "", page))


def test_the_first_page_answers_in_five_sentences(folder: Path) -> None:
    said = sentences(folder)
    assert list(said) == [
        "What holds", "What breaks first", "At what threshold", "How sure that is",
        "Better than what",
    ]  # fmt: skip
    assert "stays up on 4 of 4 rungs and also comes to rest on 3; on 2 it" in said["What holds"]
    assert said["What breaks first"] == (
        "The rail: it must reach 3.7 m to either side, where a rig has 1 m. On an endless rail it "
        "is rail damping: at 7.3 N s/m, 1.5 times that of a typical rig, the pole falls."
    )
    assert said["At what threshold"] == (
        "A delay of 47 ms or a force limit of 10 N brings it down; a control period of 50 ms does "
        "not; all flaws at once do at 1.1 times those of a typical rig, and keep it from coming to "
        "rest at 0.33 times."
    )
    assert "On 60 random rigs it stays up on 95 %" in said["How sure that is"]
    assert "(exact 95 % interval 86.1 to 99.0 %)" in said["How sure that is"]
    assert "found one that fails" in said["How sure that is"]
    assert "bisected to 2 % on step-step, with 4 seeds" in said["How sure that is"]
    assert "more than LQR on 3 rungs, as much on 1 and less on 2" in said["Better than what"]
    assert "it alone stays up on 5, LQR alone on 3 (p = 0.73)" in said["Better than what"]
    assert "least disk margin is 0.40, LQR's 0.40" in said["Better than what"]


def test_a_worse_number_is_a_worse_sentence(folder: Path) -> None:
    ladder = survival_case.make_ladder()
    rise = next(r for r in ladder["rises"] if r["rung"] == "delay")
    rise["typical"] = survival_case.verdict(False, False)
    rise["survives"] = survival_case.threshold("between", 0.001)
    rise["failure"] = survival_case.verdict(False, False)
    (folder / "ladder.json").write_text(json.dumps(ladder))
    said = sentences(folder)
    assert "stays up on 3 of 4 rungs" in said["What holds"]
    assert "it is transport delay: at 1 ms, 0.5 times" in said["What breaks first"]


def test_what_was_not_studied_names_the_command_that_would(folder: Path) -> None:
    (folder / "ladder.json").unlink()
    (folder / "montecarlo.json").unlink()
    said = sentences(folder)
    assert said["What holds"] == "Not known here: afl-mujoco ladder finds out."
    assert said["How sure that is"].startswith("Not known here: afl-mujoco montecarlo")
    for name in NAMES:
        (folder / f"{name}.json").unlink(missing_ok=True)
    assert sentences(folder) == {}


def test_the_page_shows_every_study_and_escapes_what_it_is_given(folder: Path) -> None:
    studies = load_studies(folder)
    page = render_page(make_report(), make_curves(), (), (), studies=studies)
    assert page == render_page(make_report(), make_curves(), (), (), studies=studies)
    for name in studies:
        assert f'id="{name}"' in page
        assert f'href="#{name}"' in page
        assert f"afl-mujoco {name} --made-up" in page
        assert f"Line of {name}" in page
    assert NASTY not in page
    text = plain(page)
    assert "Does it survive real physics?" in text
    assert "settles in 6.6 s" in text and "does not settle" in text
    assert "57 of 60" in text and "fell at 9.90 s" in text
    assert "80 %" in text and "2 of 25" in text
    assert len(re.findall(r'id="(\w+)"', page)) == len(set(re.findall(r'id="(\w+)"', page)))


def test_a_page_without_studies_says_how_to_make_them() -> None:
    text = plain(render_page(make_report(), make_curves(), (), ()))
    assert "No survival study is here. make survival makes them" in text
    assert "Does it survive real physics?" not in text


def test_the_margin_on_the_way_stands_beside_the_ladder() -> None:
    adaptive, lqr = delay_rows(survival_case.make_ladder())
    assert adaptive["margin"] == "32.3" and adaptive["ladder"] == "47"
    assert adaptive["ratio"] == "1.46"
    assert lqr["margin"] == "0.0" and lqr["ratio"] == "–"


def test_the_worst_margin_is_of_stable_plants_and_what_is_infinite_is_none() -> None:
    row = margin_rows(survival_case.make_margins())[0]
    assert (row["unstable"], row["gain_down"], row["gain_up"]) == ("1", "0.60", "16.6")
    assert (row["disk"], row["delay"]) == ("0.40", "12.0")
    said = measured_text(survival_case.make_margins())
    assert "at most 0.5 %" in said and "agree on 1 of 2" in said


@pytest.mark.parametrize(
    ("content", "rule"),
    [
        ("{", "is not a survival study: "),
        ("[]", "is not a survival study: "),
        ('{"schema": 2, "study": "ladder"}', "must have schema 1 and be the study 'ladder'"),
        ('{"schema": 1, "study": "margins"}', "must have schema 1 and be the study 'ladder'"),
        ('{"schema": 1, "study": "ladder"}', "'command' is missing"),
        ('{"schema": 1, "study": "ladder", "command": 3}', "command must be a text"),
        (
            '{"schema": 1, "study": "ladder", "command": "", "figures": '
            '[{"svg": "../x.svg", "png": "y.png"}]}',
            "svg must lie beside the file, got '../x.svg'",
        ),
    ],
)
def test_a_file_that_is_no_study_is_named_with_what_mends_it(
    tmp_path: Path, content: str, rule: str
) -> None:
    (tmp_path / "ladder.json").write_text(content)
    with pytest.raises(FileError) as error:
        load_studies(tmp_path)
    assert rule in str(error.value)
    assert str(error.value).startswith(str(tmp_path / "ladder.json"))
    assert str(error.value).endswith("run afl-mujoco ladder")


@pytest.mark.parametrize("name", ["ladder", "montecarlo", "attraction", "margins"])
def test_a_study_without_what_its_table_needs_is_refused(folder: Path, name: str) -> None:
    studies = dict(load_studies(folder))
    kept = {key: studies[name].data[key] for key in ("schema", "study", "command", "figures")}
    studies[name] = Study(name, kept, ())
    with pytest.raises(FileError, match=rf"^{name}.json is not a survival study: .* is missing"):
        render_page(make_report(), make_curves(), (), (), studies={name: studies[name]})
