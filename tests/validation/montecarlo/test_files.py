"""The folder of the scenario files: whole, of one campaign, and nobody else's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from afl_mujoco.errors import FileError
from afl_mujoco.scenario.files import Replay, find_replay, load_scenario
from afl_mujoco.validation.montecarlo import files
from afl_mujoco.validation.montecarlo.campaign import Campaign
from afl_mujoco.validation.montecarlo.files import FOLDER, require_ours, write_scenarios
from afl_mujoco.validation.montecarlo.space import SampleSpace, sample_scenario
from afl_mujoco.validation.montecarlo.trial import Settings, Trial
from afl_mujoco.validation.montecarlo.worst_case import HARDEST, Found

SPACE = SampleSpace()


def campaign(*failed: int, seed: int = 1) -> Campaign:
    trials = [
        Trial(outcome="fell" if i in failed else "completed", end_time=1.0) for i in range(150)
    ]
    return Campaign(
        space=SPACE,
        seed=seed,
        settings=Settings(),
        trials={"lqr": trials, "good": trials[:1] * 150},
    )


def written(folder) -> set[str]:
    return {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}


def test_every_failure_is_a_file_by_its_number(tmp_path) -> None:
    assert write_scenarios(campaign(3, 123), [], tmp_path) == tmp_path / FOLDER
    names = {"montecarlo/lqr/failure-0003.toml", "montecarlo/lqr/failure-0123.toml"}
    assert written(tmp_path) == names
    rig = load_scenario(tmp_path / "montecarlo/lqr/failure-0123.toml")
    assert rig == sample_scenario(SPACE, 123, 1)
    run = Replay(controller="lqr", integrator="RK4")
    assert find_replay(str(tmp_path / "montecarlo/lqr/failure-0123.toml")) == run
    write_scenarios(campaign(3), [], tmp_path, asked={"lqr": "mine:lqr"})
    again = find_replay(str(tmp_path / "montecarlo/lqr/failure-0003.toml"))
    assert again == replace(run, controller="mine:lqr")


def test_files_of_an_earlier_campaign_do_not_stay(tmp_path) -> None:
    write_scenarios(campaign(3, 123), [], tmp_path)
    write_scenarios(campaign(5, seed=2), [], tmp_path)
    assert written(tmp_path) == {"montecarlo/lqr/failure-0005.toml"}
    assert sorted(p.name for p in tmp_path.iterdir()) == [FOLDER]


def test_no_more_are_kept_than_asked_for(tmp_path) -> None:
    write_scenarios(campaign(3, 4, 5), [], tmp_path, keep=2)
    names = {"montecarlo/lqr/failure-0003.toml", "montecarlo/lqr/failure-0004.toml"}
    assert written(tmp_path) == names
    write_scenarios(campaign(3), [], tmp_path, keep=0)
    assert written(tmp_path) == set()


def test_what_a_search_found_is_a_file_too(tmp_path) -> None:
    rig = sample_scenario(SPACE, 9, 1)
    found = Found(
        question=HARDEST, controller="lqr", scenario=rig, trial=Trial(outcome="fell"),
        distance=0.1, runs=1, changes={},
    )  # fmt: skip
    write_scenarios(campaign(), [found], tmp_path)
    assert load_scenario(tmp_path / files.found_file(found)) == rig
    assert written(tmp_path) == {"montecarlo/lqr/hardest.toml"}


@pytest.mark.parametrize(
    "name", ["notes.txt", "lqr/notes.txt", "lqr/failure-1.toml", "lqr/deep/failure-0001.toml"]
)
def test_a_file_of_somebody_elses_is_not_lost(tmp_path, name: str) -> None:
    write_scenarios(campaign(3), [], tmp_path)
    theirs = tmp_path / FOLDER / name
    theirs.parent.mkdir(parents=True, exist_ok=True)
    theirs.write_text("mine")
    with pytest.raises(FileError, match=r"is not of this study, which replaces its folder"):
        write_scenarios(campaign(5), [], tmp_path)
    with pytest.raises(FileError):
        require_ours(tmp_path)
    assert theirs.read_text() == "mine"
    assert "montecarlo/lqr/failure-0003.toml" in written(tmp_path)


def test_a_write_that_is_broken_off_leaves_what_was_there(tmp_path, monkeypatch) -> None:
    write_scenarios(campaign(3), [], tmp_path)
    calls = []

    def interrupted(*arguments, **options):
        calls.append(arguments)
        if len(calls) == 2:
            raise KeyboardInterrupt
        save(*arguments, **options)

    save = files.save_scenario
    monkeypatch.setattr(files, "save_scenario", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_scenarios(campaign(5, 6), [], tmp_path)
    assert written(tmp_path) == {"montecarlo/lqr/failure-0003.toml"}
    assert sorted(p.name for p in tmp_path.iterdir()) == [FOLDER]


def test_a_ctrl_c_between_the_two_moves_leaves_what_was_there(tmp_path, monkeypatch) -> None:
    write_scenarios(campaign(3), [], tmp_path)
    before, moves, rename = written(tmp_path), [], Path.rename

    def interrupted(path: Path, target: Path) -> Path:
        moves.append(path)
        if len(moves) == 2:
            raise KeyboardInterrupt
        return rename(path, target)

    monkeypatch.setattr(Path, "rename", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_scenarios(campaign(5), [], tmp_path)
    assert written(tmp_path) == before
    assert [path.name for path in tmp_path.iterdir()] == [FOLDER]
