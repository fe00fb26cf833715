"""A record comes back from its files; what an older one wrote goes, and nothing else."""

import json
from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest

from afl_mujoco.errors import FileError
from afl_mujoco.report import figures
from afl_mujoco.studies.shared import record as record_module
from afl_mujoco.studies.shared.contract import find_study
from afl_mujoco.studies.shared.record import load_record, load_records, remove_record, save_record
from tests import study_results
from tests.messages import line


def names(folder) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


def same(one, other) -> bool:
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and np.array_equal(one, other, equal_nan=True)
    if is_dataclass(one):
        pairs = [(getattr(one, x.name), getattr(other, x.name)) for x in fields(one)]
        return type(one) is type(other) and all(same(*pair) for pair in pairs)
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    return bool(one == other)


@pytest.mark.parametrize("name", study_results.RESULTS)
def test_a_record_comes_back_as_it_was(name: str, tmp_path) -> None:
    record = study_results.record(name)
    assert save_record(record, tmp_path, figures=False)[0] == tmp_path / f"{record.study.stem}.json"
    again = load_record(record.study, tmp_path)
    assert same(again.result, record.result)
    assert (again.command, dict(again.versions)) == (record.command, dict(record.versions))
    assert again.report.headline == record.report.headline


def test_a_record_takes_the_place_of_an_older_one_and_of_nothing_else(tmp_path) -> None:
    users = {"margins-notes.png", "margins.txt", "thresholds.json", "attraction-mine.npz"}
    for name in users:
        (tmp_path / name).write_text("mine")
    record = study_results.record("margins")
    for one in (record, replace(record, result=replace(record.result, rows=()))):
        written = {path.name for path in save_record(one, tmp_path)}
        assert names(tmp_path) == users | written
        assert "margins.md" in written and ("margins-delay.svg" in written) == (one is record)


FOREIGN = dict.fromkeys(["../margins-x.svg", "thresholds.png", "margins-a/x.svg"], "")


@pytest.mark.parametrize("text", ["", "[]", '{"files": 3}', json.dumps({"files": FOREIGN})])
def test_a_list_that_names_what_is_no_file_of_the_study_removes_nothing(tmp_path, text) -> None:
    folder = tmp_path / "out"
    (folder / "margins-a").mkdir(parents=True)
    others = [folder / name for name in FOREIGN]
    for other in others:
        other.write_text("mine")
    (folder / "margins.json").write_text(text)
    remove_record(find_study("margins"), folder)
    assert not (folder / "margins.json").exists() and all(other.exists() for other in others)


def broken_off(folder, monkeypatch, part: str, error) -> None:
    def stop(*arguments: object) -> None:
        raise error

    new = replace(study_results.record("margins"), command="the new one")
    made = {"figures": (figures, "save_figure"), "text": (record_module, "write_text")}[part]
    with monkeypatch.context() as patch, pytest.raises(type(error)):
        patch.setattr(*made, stop)
        save_record(new, folder)
    assert all(path.is_file() for path in folder.iterdir())  # nothing is left of what was staged


@pytest.mark.parametrize("older", [False, True])
def test_what_cannot_be_drawn_does_not_cost_the_numbers(tmp_path, monkeypatch, older):
    if older:
        save_record(study_results.record("margins"), tmp_path)
        (tmp_path / "report.html").write_text("the page of the older one")
        (tmp_path / "margins-partial.json").write_text("what was done when it was interrupted")
    broken_off(tmp_path, monkeypatch, "figures", ValueError())
    assert names(tmp_path) == {"margins.json", "margins.md"}
    assert load_record(find_study("margins"), tmp_path).command == "the new one"


@pytest.mark.parametrize(("part", "error"), [
    *(("text", error) for error in (KeyboardInterrupt(), FileError("x", "full"))),
    ("figures", KeyboardInterrupt()),
])  # fmt: skip
def test_a_ctrl_c_or_a_full_disk_leaves_the_older_record(tmp_path, monkeypatch, part, error):
    save_record(study_results.record("margins"), tmp_path)
    (tmp_path / "report.html").write_text("the page")
    before = {name: (tmp_path / name).read_bytes() for name in names(tmp_path)}
    broken_off(tmp_path, monkeypatch, part, error)
    assert {name: (tmp_path / name).read_bytes() for name in names(tmp_path)} == before


@pytest.mark.parametrize("name", ["compare.npz", "compare-1.svg"])
def test_files_of_another_run_are_refused(tmp_path, name: str) -> None:
    save_record(study_results.record("compare"), tmp_path)
    with (tmp_path / name).open("ab") as file:
        file.write(b" ")
    with pytest.raises(FileError, match=f"{name} beside it must be unchanged since it was written"):
        load_records(tmp_path)


LONG = {"schema": 5, "study": "margins", "command": "", "scenario": "s", "control_period": "long",
        "versions": {}, "inputs": {}, "files": {}}  # fmt: skip


@pytest.mark.parametrize(("content", "rule"), [
    ("{", "is not a result of afl-mujoco margins: "), ("[1]", "must be an object"),
    ('{"schema": 1, "study": "margins"}', "must be of 'margins' and have schema 5, got 'mar"),
    ('{"schema": 5, "study": "margins"}', "command is missing"),
    (json.dumps(LONG), "control_period must be a valid number, got 'lo"),
    ('{"schema": NaN}', "NaN is not a JSON number"),
], ids=lambda text: text[:36])  # fmt: skip
def test_a_file_that_is_no_record_is_one_line_with_what_mends_it(tmp_path, content, rule) -> None:
    (tmp_path / "margins.json").write_text(content)
    said = line(f"{tmp_path}/margins.json", ..., rule, ..., "run afl-mujoco margins")
    with pytest.raises(FileError, match=said):
        load_records(tmp_path)


@pytest.mark.parametrize("spoil", [
    lambda path: path.write_bytes(path.read_bytes()[:500]),
    lambda path: np.savez(path, other=np.ones(2)), lambda path: path.unlink(),
], ids=["truncated", "other names", "gone"])  # fmt: skip
def test_arrays_that_are_spoilt_are_one_line_with_what_mends_it(tmp_path, spoil) -> None:
    save_record(study_results.record("compare"), tmp_path, figures=False)
    spoil(tmp_path / "compare.npz")
    said = line(f"{tmp_path}/compare.json", ..., "run afl-mujoco compare")
    with pytest.raises(FileError, match=said):
        load_records(tmp_path)
