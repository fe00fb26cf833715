"""The files of a study: whose are removed with an older one, and whose are not."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from afl_mujoco.document.style import Drawn
from afl_mujoco.reporting.survival.study import remove_study, write_study


def drawn(name: str) -> Drawn:
    figure = Figure()
    figure.subplots().plot([0.0, 1.0])
    return Drawn(name=name, title=name, figure=figure, caption="A line.", alt="A line.")


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_a_study_takes_the_place_of_an_older_one_and_of_nothing_else(tmp_path: Path) -> None:
    users = {"margins-notes.png", "margins.txt", "ladder.json", "attraction-mine.npz"}
    for name in users:
        (tmp_path / name).write_text("mine")
    (tmp_path / "margins-map.npz").write_text("")
    first = write_study(
        "margins", {}, [drawn("margins-old"), drawn("margins")], tmp_path, command="x",
        files=[tmp_path / "margins-map.npz"],
    )  # fmt: skip
    assert names(tmp_path) == users | {path.name for path in first}
    assert "margins-map.npz" in {path.name for path in first}
    second = write_study("margins", {}, [drawn("margins-new")], tmp_path, command="x")
    assert {path.name for path in second} == {"margins.json", "margins-new.svg", "margins-new.png"}
    assert names(tmp_path) == users | {path.name for path in second}


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        '{"figures": []}',
        json.dumps(
            {
                "figures": [{"svg": "../margins-x.svg", "png": "ladder.png"}],
                "files": ["margins-a/x.svg"],
            }
        ),
    ],
)
def test_a_list_that_names_what_is_no_file_of_the_study_removes_nothing(
    tmp_path: Path, text: str
) -> None:
    folder = tmp_path / "out"
    (folder / "margins-a").mkdir(parents=True)
    others = [tmp_path / "margins-x.svg", folder / "ladder.png", folder / "margins-a" / "x.svg"]
    for other in others:
        other.write_text("mine")
    (folder / "margins.json").write_text(text)
    remove_study("margins", folder)
    assert not (folder / "margins.json").exists()
    assert all(other.exists() for other in others)


def test_there_need_be_no_older_study(tmp_path: Path) -> None:
    remove_study("margins", tmp_path)
    assert names(tmp_path) == set()
