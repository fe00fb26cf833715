"""The page is made from a folder's files, or refused in one line that says what to do."""

from __future__ import annotations

import copy
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import page_case
import pytest

from afl_mujoco.errors import FileError
from afl_mujoco.reporting.page.folder import load_pictures, write_gallery, write_page
from afl_mujoco.reporting.page.inputs.report_data import REQUIRED, require_report
from afl_mujoco.studies.verification.curves import Curves, save_curves
from afl_mujoco.studies.verification.figures import gallery


def make_report(**changes: Any) -> dict[str, Any]:
    return page_case.make_report(second="my case", **changes)


def make_curves() -> tuple[Curves, ...]:
    return page_case.make_curves(second="my case")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a report and its curves."""
    return fill(tmp_path)


def fill(folder: Path) -> Path:
    (folder / "report.json").write_text(json.dumps(make_report()))
    save_curves(folder / "curves.npz", make_curves())
    return folder


@pytest.fixture(scope="module")
def gallery_of_two(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two of the figures as well."""
    chosen = ("budget", "response-step-step")
    plans = gallery.plans

    def few(*data: Any) -> dict[str, Any]:
        return {name: plan for name, plan in plans(*data).items() if name in chosen}

    folder = fill(tmp_path_factory.mktemp("drawn"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(gallery, "plans", few)
        write_gallery(folder, make_report(), make_curves())
    return folder


@pytest.fixture
def drawn(gallery_of_two: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    return Path(shutil.copytree(gallery_of_two, tmp_path / "copy"))


def test_a_page_is_written_from_report_and_curves_alone(folder: Path) -> None:
    page = write_page(folder)
    text = page.read_text(encoding="utf-8")
    assert page == folder / "report.html"
    assert "<title>PASS: " in text
    assert '<a href="curves.npz">' in text
    assert '<a href="junit.xml">' not in text


def test_the_same_files_give_the_same_bytes(drawn: Path) -> None:
    first = write_page(drawn).read_bytes()
    assert write_page(drawn).read_bytes() == first
    assert b"data:image/svg+xml" in first


def test_figures_find_their_place(drawn: Path) -> None:
    pictures = load_pictures(drawn, ["step-step"])
    assert {picture.title: picture.place for picture in pictures} == {
        "step-step": "step-step",
        "What the difference consists of": "#budget",
    }
    text = write_page(drawn).read_text(encoding="utf-8")
    budget = text.partition('<h2 id="budget">')[2].partition("</section>")[0]
    assert "<strong>What the difference consists of.</strong>" in budget
    assert all(picture.alt and picture.width > 300 for picture in pictures)


def test_figures_of_another_run_are_refused(drawn: Path) -> None:
    (drawn / "report.json").write_text(json.dumps(make_report(b3=1e-10)))
    with pytest.raises(FileError, match=r"drawn from report\.json .*: run afl-mujoco validate$"):
        write_page(drawn)
    assert not (drawn / "report.html").exists()


@pytest.mark.parametrize(
    "spoil",
    [
        lambda path: path.write_text("["),
        lambda path: path.write_text("[]"),
        lambda path: path.write_text(path.read_text().replace('"alt"', '"old"')),
    ],
    ids=["no JSON", "no table", "no alt"],
)
def test_a_list_of_figures_that_is_not_understood_is_refused(
    drawn: Path, spoil: Callable[[Path], None]
) -> None:
    spoil(drawn / "figures" / "figures.json")
    with pytest.raises(FileError, match=r"figures\.json does not list figures"):
        write_page(drawn)


def test_a_figure_that_is_missing_is_named(drawn: Path) -> None:
    (drawn / "figures" / "budget.svg").unlink()
    with pytest.raises(FileError, match=r"budget\.svg cannot be read: no such file"):
        write_page(drawn)


BAD_REPORTS = {
    "no file": (None, "cannot be read: no such file or directory"),
    "no JSON": ("{", "is not a report: Expecting"),
    "no text": (b"\xff\xfe", "is not a report: 'utf-8' codec can't decode"),
    "not a number": ('{"schema": NaN}', "is not a report: NaN is no number of JSON"),
    "a list": ("[]", "it must be a table, got list"),
    "another schema": ('{"schema": 2}', "schema must be 1, got 2"),
    "no checks": ('{"schema": 1}', "checks must be a list, got NoneType"),
}


@pytest.mark.parametrize("case", BAD_REPORTS, ids=str)
def test_a_report_that_is_none_is_refused_in_one_line(folder: Path, case: str) -> None:
    content, message = BAD_REPORTS[case]
    path = folder / "report.json"
    path.unlink()
    if content is not None:
        path.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(FileError) as refusal:
        write_page(folder)
    said = str(refusal.value)
    assert message in said
    assert said.endswith(": run afl-mujoco validate")
    assert "\n" not in said
    assert not (folder / "report.html").exists()


@pytest.mark.parametrize("rows", REQUIRED, ids=str)
def test_every_key_of_every_row_is_needed_and_held_to_its_kind(rows: str) -> None:
    for key in REQUIRED[rows]:
        for spoiled in ({}, {key: object()}):
            report = make_report()
            row = report[rows][0]
            del row[key]
            row |= spoiled
            with pytest.raises(ValueError, match=rf"{rows}\[0\]\.{key} must be "):
                require_report(report)


SPOILT: dict[str, tuple[Callable[[dict[str, Any]], Any], str]] = {
    "a verdict that its checks deny": (
        lambda r: r.update(verdict="fail"),
        "verdict must be 'pass', as its checks say, got 'fail'",
    ),
    "an interval of one number": (
        lambda r: r["random_schedules"]["retuned"].update(interval=[0.5]),
        r"random_schedules\.retuned\.interval must be two numbers",
    ),
    "a worst place without a state": (
        lambda r: r["error_budgets"][0].update(at_worst={}),
        r"error_budgets\[0\]\.at_worst\.state must be a text",
    ),
    "a metric that is a text": (
        lambda r: r["runs"][3]["metrics"].update(objective="good"),
        r"runs\[3\]\.metrics\.objective must be a number or null, got good",
    ),
    "a version that is a number": (
        lambda r: r["versions"].update(mujoco=3.17),
        r"versions\.mujoco must be a text, got 3\.17",
    ),
    "no command": (lambda r: r.pop("command"), "command must be a text, got nothing"),
    "no settings": (lambda r: r.pop("settings"), "settings must be a table, got nothing"),
}


@pytest.mark.parametrize("case", SPOILT, ids=str)
def test_a_report_that_would_mislead_is_refused(case: str) -> None:
    spoil, message = SPOILT[case]
    report = copy.deepcopy(make_report())
    spoil(report)
    with pytest.raises(ValueError, match=message):
        require_report(report)


def test_curves_that_are_missing_malformed_or_of_another_run_are_refused(folder: Path) -> None:
    path = folder / "curves.npz"
    save_curves(path, make_curves()[:3])
    with pytest.raises(FileError, match=r"curves\.npz must hold the runs of report\.json"):
        write_page(folder)
    path.write_text("text")
    with pytest.raises(FileError, match=r"does not hold curves: .*: run afl-mujoco validate$"):
        write_page(folder)
    path.unlink()
    with pytest.raises(FileError, match=r"cannot be read: no such file .*afl-mujoco validate$"):
        write_page(folder)
