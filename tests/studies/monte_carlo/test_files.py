"""The folder of the scenario files: whole, of one campaign, and nobody else's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from afl_mujoco.errors import FileError
from afl_mujoco.scenario.files import Replay, find_replay, load_scenario
from afl_mujoco.scenario.laboratory import LABORATORY
from afl_mujoco.scenario.sample_space import SampleSpace, sample_point, sample_scenario
from afl_mujoco.simulation.judgement import Judgement
from afl_mujoco.studies.monte_carlo import files
from afl_mujoco.studies.monte_carlo.campaign import Campaign
from afl_mujoco.studies.monte_carlo.files import require, write
from afl_mujoco.studies.monte_carlo.result import FOLDER, Result, result_of
from afl_mujoco.studies.monte_carlo.trial import Settings, Trial
from afl_mujoco.studies.monte_carlo.worst_case import HARDEST, Found

SPACE = SampleSpace(LABORATORY)
FALL = Judgement(requirement="completes", limit=20.0, value=1.0, left=-19.0)


def campaign(*failed: int, seed: int = 1, found: Sequence[Found] = (), **options) -> Result:
    trials = [
        Trial(outcome="fell", end_time=1.0, requirements=(FALL,))
        if i in failed
        else Trial(outcome="completed", end_time=1.0)
        for i in range(150)
    ]
    made = Campaign(
        space=SPACE,
        seed=seed,
        settings=Settings(),
        trials={"lqr": trials, "good": trials[:1] * 150},
    )
    return result_of(made, found, **options)


def written(folder) -> set[str]:
    return {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}


def test_every_failure_is_a_file_by_its_number(tmp_path) -> None:
    assert write(campaign(3, 123), tmp_path) == [tmp_path / FOLDER]
    names = {"montecarlo/lqr/failure-0003.toml", "montecarlo/lqr/failure-0123.toml"}
    assert written(tmp_path) == names
    scenario = load_scenario(tmp_path / "montecarlo/lqr/failure-0123.toml")
    assert scenario == sample_scenario(SPACE, 123, 1)
    run = Replay(controller="lqr", integrator="RK4")
    assert find_replay(str(tmp_path / "montecarlo/lqr/failure-0123.toml")) == run
    write(campaign(3, asked={"lqr": "mine:lqr"}), tmp_path)
    again = find_replay(str(tmp_path / "montecarlo/lqr/failure-0003.toml"))
    assert again == replace(run, controller="mine:lqr")


def test_files_of_an_earlier_campaign_do_not_stay(tmp_path) -> None:
    write(campaign(3, 123), tmp_path)
    write(campaign(5, seed=2), tmp_path)
    assert written(tmp_path) == {"montecarlo/lqr/failure-0005.toml"}
    assert sorted(p.name for p in tmp_path.iterdir()) == [FOLDER]


def test_no_more_are_kept_than_asked_for(tmp_path) -> None:
    write(campaign(3, 4, 5, keep=2), tmp_path)
    names = {"montecarlo/lqr/failure-0003.toml", "montecarlo/lqr/failure-0004.toml"}
    assert written(tmp_path) == names
    write(campaign(3, keep=0), tmp_path)
    assert written(tmp_path) == set()


def test_what_a_search_found_is_a_file_too(tmp_path) -> None:
    found = Found(
        question=HARDEST, controller="lqr", point=sample_point(SPACE, 9, 1), noise=9,
        trial=Trial(outcome="fell", end_time=1.0, requirements=(FALL,)), distance=0.1, runs=1,
        changes={},
    )  # fmt: skip
    result = campaign(found=[found])
    write(result, tmp_path)
    scenario = sample_scenario(SPACE, 9, 1)
    expected = replace(scenario, name=f"{scenario.name}-hardest")
    assert load_scenario(tmp_path / result.worst_cases[0].file) == expected
    assert written(tmp_path) == {"montecarlo/lqr/hardest.toml"}


@pytest.mark.parametrize(
    "name", ["notes.txt", "lqr/notes.txt", "lqr/failure-1.toml", "lqr/deep/failure-0001.toml"]
)
def test_a_file_of_somebody_elses_is_not_lost(tmp_path, name: str) -> None:
    write(campaign(3), tmp_path)
    theirs = tmp_path / FOLDER / name
    theirs.parent.mkdir(parents=True, exist_ok=True)
    theirs.write_text("mine")
    with pytest.raises(
        FileError, match=r"was not written by this study, which replaces its folder"
    ):
        write(campaign(5), tmp_path)
    with pytest.raises(FileError):
        require(tmp_path)
    assert theirs.read_text() == "mine"
    assert "montecarlo/lqr/failure-0003.toml" in written(tmp_path)


def test_a_write_that_is_broken_off_leaves_what_was_there(tmp_path, monkeypatch) -> None:
    write(campaign(3), tmp_path)
    calls = []

    def interrupted(*arguments, **options):
        calls.append(arguments)
        if len(calls) == 2:
            raise KeyboardInterrupt
        save(*arguments, **options)

    save = files.save_scenario
    monkeypatch.setattr(files, "save_scenario", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write(campaign(5, 6), tmp_path)
    assert written(tmp_path) == {"montecarlo/lqr/failure-0003.toml"}
    assert sorted(p.name for p in tmp_path.iterdir()) == [FOLDER]


def test_a_ctrl_c_between_the_two_moves_leaves_what_was_there(tmp_path, monkeypatch) -> None:
    write(campaign(3), tmp_path)
    before, moves, rename = written(tmp_path), [], Path.rename

    def interrupted(path: Path, target: Path) -> Path:
        moves.append(path)
        if len(moves) == 2:
            raise KeyboardInterrupt
        return rename(path, target)

    monkeypatch.setattr(Path, "rename", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write(campaign(5), tmp_path)
    assert written(tmp_path) == before
    assert [path.name for path in tmp_path.iterdir()] == [FOLDER]
