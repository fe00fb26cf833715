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
    assert said["What holds"] == (
        "Of 4 single flaws of a good laboratory rig, each at its usual size and the rail aside, "
        "the adaptive controller survives 4, comes to rest under 3, and survives 2 even at ten "
        "times that size."
    )
    assert said["What breaks first"] == (
        "The rail: 1 m to either side, as on a rig, is too short and 3.7 m the least; on an "
        "endless one, rail damping: at 7.3 N s/m, 1.5 times that of a typical rig, the pole falls."
    )
    assert said["At what threshold"] == (
        "A delay of 47 ms or a force limit of 10 N brings it down; a control period of 50 ms does "
        "not; all flaws at once, the rail aside, bring it down at 1.1 times their usual size and "
        "keep it from coming to rest at 0.33 times."
    )
    assert "On 60 random rigs with an endless rail it stays up on 95 %" in said["How sure that is"]
    assert "(exact 95 % interval 86.1 to 99.0 %)" in said["How sure that is"]
    assert "comes to rest on 30 % (18.8 to 43.2 %)" in said["How sure that is"]
    assert "found one that fails" in said["How sure that is"]
    assert "bisected to 2 % on step-step, with 4 seeds" in said["How sure that is"]
    assert "more than LQR on 3, as much on 1 and less on 2" in said["Better than what"]
    assert "it alone stays up on 5, LQR alone on 3 (p = 0.73)" in said["Better than what"]
    assert "linearised, it is unstable on 1 of 6 plants, LQR on 1" in said["Better than what"]


def change(folder: Path, **thresholds: tuple[str, float, bool]) -> None:
    """Give the adaptive controller other thresholds: place, level, whether a typical rig is ok."""
    ladder = survival_case.make_ladder()
    for rise in ladder["rises"]:
        name = rise["rung"].replace("-", "_")
        if rise["controller"] == "adaptive" and name in thresholds:
            place, level, fine = thresholds[name]
            rise["survives"] = survival_case.threshold(place, level)
            rise["typical"] = survival_case.verdict(fine, fine, rise["rung"])
            lost = survival_case.verdict(False, False, rise["rung"])
            rise["failure"] = None if place == "above" else lost
    (folder / "ladder.json").write_text(json.dumps(ladder))


def test_a_worse_number_is_a_worse_sentence(folder: Path) -> None:
    change(folder, delay=("between", 0.001, False))
    said = sentences(folder)
    assert "survives 3, comes" in said["What holds"]
    assert "transport delay: at 1 ms, 0.5 times" in said["What breaks first"]


def test_a_rail_that_suffices_is_not_what_breaks_first(folder: Path) -> None:
    change(folder, rail=("between", 0.2, True))
    assert sentences(folder)["What breaks first"] == (
        "Rail damping: at 7.3 N s/m, 1.5 times that of a typical rig, the pole falls."
    )
    change(folder, rail=("below", 100.0, False))
    assert sentences(folder)["What breaks first"].startswith(
        "The rail: 1 m to either side, as on a rig, is too short; on an endless one, rail damping"
    )


def test_what_no_level_brings_down_and_what_the_mildest_does(folder: Path) -> None:
    bears = ("above", 1.0, True)
    names = ("delay", "control_period", "force_limit", "rail_damping", "rail", "together")
    change(folder, **dict.fromkeys(names, bears))
    said = sentences(folder)
    assert said["What breaks first"] == "Nothing, within the ranges that were tried."
    assert "a force limit of 1 N does not bring it down" in said["At what threshold"]
    assert "only at more than 1 times their size" in said["At what threshold"]
    change(folder, **dict.fromkeys(names, ("below", 0.01, False)))
    assert sentences(folder)["What breaks first"].startswith("Everything that was tried")


@pytest.mark.parametrize("kept", [("together",), ("rail",), ("delay",), ("rail", "together")])
def test_a_ladder_of_few_rungs_has_sentences_too(folder: Path, kept: tuple[str, ...]) -> None:
    ladder = survival_case.make_ladder()
    ladder["rungs"] = [rung for rung in ladder["rungs"] if rung["name"] in kept]
    ladder["rises"] = [rise for rise in ladder["rises"] if rise["rung"] in kept]
    if "delay" not in kept:
        ladder["delay_margins"] = []
    (folder / "ladder.json").write_text(json.dumps(ladder))
    said = sentences(folder)
    assert all(text.endswith(".") for text in said.values())
    page = render_page(make_report(), make_curves(), (), (), studies=load_studies(folder))
    assert 'id="ladder"' in page


def test_other_controllers_are_spoken_of_by_name(folder: Path) -> None:
    ladder = json.loads((folder / "ladder.json").read_text().replace("adaptive", "own.law"))
    (folder / "ladder.json").write_text(json.dumps(ladder))
    (folder / "montecarlo.json").unlink()
    assert "the own.law controller survives" in sentences(folder)["What holds"]


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
    margins = survival_case.make_margins()
    margins["margins"]["lqr"]["sampled"]["gain_increase"] = [[None] * 3] * 2
    assert margin_rows(margins)[1]["gain_up"] == "–"
    said = measured_text(survival_case.make_margins())
    assert "On 1 of 2 plants and laws there are both" in said
    assert "at most 0.5 %" in said and "1 agree within 5 %" in said


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
    studies[name] = Study(name, folder / f"{name}.json", kept, ())
    with pytest.raises(FileError, match=rf"{name}.json is not a survival study: .* is missing"):
        render_page(make_report(), make_curves(), (), (), studies={name: studies[name]})
