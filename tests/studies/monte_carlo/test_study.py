"""`afl-mujoco montecarlo` from the real command line."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import numpy as np
import pytest

import afl_mujoco as afl
from tests.program import interrupt, run

pytestmark = pytest.mark.slow

REPLAY = "Replay a failure of "
FEW = ["--samples", "16", "--integrator", "Euler", "--out", "out"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where a campaign with searches has been written."""
    path = tmp_path_factory.mktemp("montecarlo")
    result = run("montecarlo", "--generations", "1", *FEW, cwd=path)
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""
    (path / "said").write_text(result.stdout)
    return path


def study(folder: Path) -> dict:
    return json.loads((folder / "out" / "montecarlo.json").read_text())


def test_it_writes_the_study_its_figures_and_a_file_for_every_failure(folder: Path) -> None:
    content = json.loads((folder / "out" / "montecarlo.json").read_text())
    assert content["study"] == "montecarlo"
    assert content["command"] == (
        "afl-mujoco montecarlo --samples 16 --generations 1 --integrator Euler"
    )
    result = content
    assert [entry["controller"] for entry in result["controllers"]] == ["adaptive", "lqr"]
    files = {f["file"] for entry in result["controllers"] for f in entry["failures"]}
    files |= {entry["file"] for entry in result["worst_cases"]}
    out = folder / "out"
    written = {str(p.relative_to(out)) for p in out.rglob("*") if p.is_file()}
    assert written == {*content["files"], *files, "montecarlo.json", "report.html"}
    assert {"montecarlo.md", "montecarlo-rates.svg"} < written
    assert sum(entry["passed"] for entry in result["controllers"]) < 32
    said = (folder / "said").read_text()
    assert "16 random samples of laboratory (seed 1)" in said
    assert "search by CMA-ES" in said
    assert "montecarlo.json" in said.splitlines()[-1] and "report.html" in said.splitlines()[-1]


def test_the_command_that_it_prints_replays_the_failure(folder: Path) -> None:
    lines = (folder / "said").read_text().splitlines()
    printed = [line.partition(" to the last bit: ")[2] for line in lines if line.startswith(REPLAY)]
    assert printed
    program, command, *arguments = shlex.split(printed[0])
    assert (program, command) == ("afl-mujoco", "simulate")
    result = run("simulate", *arguments, "--out", "shown", cwd=folder)
    assert result.returncode == 1, result.stderr  # it falls again
    controller = arguments[arguments.index("--controller") + 1]
    entry = next(e for e in study(folder)["controllers"] if e["controller"] == controller)
    failure = entry["failures"][0]
    (file,) = (folder / "shown").glob("*.npz")
    shown = afl.Trajectory.load(file)
    assert (shown.outcome.kind, shown.outcome.time) == (failure["outcome"], failure["end_time"])
    scenario = afl.load_scenario(folder / "out" / failure["file"])
    alone = afl.simulate_mujoco(
        scenario, afl.CONTROLLERS[controller], "sampled", integrator="Euler"
    )
    assert np.array_equal(shown.state, alone.state)
    bare = run("simulate", arguments[0], "--out", "bare", cwd=folder)
    assert bare.returncode == 1, bare.stderr
    (file,) = (folder / "bare").glob("*.npz")
    assert np.array_equal(afl.Trajectory.load(file).state, alone.state)


def test_one_worker_gives_the_same_bytes_as_two(folder: Path) -> None:
    result = run("montecarlo", "--generations", "1", *FEW[:-1], "one", "--workers", "1", cwd=folder)
    assert result.returncode == 0, result.stderr
    for two in (folder / "out").rglob("*"):
        if two.is_file() and two.suffix != ".html":  # the page names its folder
            one = folder / "one" / two.relative_to(folder / "out")
            assert one.read_bytes() == two.read_bytes(), two


def test_a_controller_that_breaks_down_is_an_outcome_with_its_message(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "def controller(t, state, belief):\n    raise OSError('unplugged')\n"
    )
    controllers = ["--controllers", "mine:controller", "lqr"]
    result = run(
        "montecarlo",
        *controllers,
        "--samples",
        "3",
        "--out",
        "out",
        "--no-worst-case",
        cwd=tmp_path,
    )
    assert result.returncode == 0, result.stderr
    content = study(tmp_path)
    assert "mine:controller lqr --samples 3 --no-worst-case" in result.stdout
    broken = content["controllers"][0]
    assert broken["failures_by_kind"] == {"controller failed": 3}
    said = "controller 'mine.controller' raised OSError at t = 0 s: unplugged"
    assert [failure["message"] for failure in broken["failures"]] == [said] * 3
    assert content["worst_cases"] == []
    assert said in " ".join(result.stdout.split())
    (replay,) = [line for line in result.stdout.splitlines() if line.startswith(REPLAY)]
    again = run(
        "simulate", *shlex.split(replay.partition(" to the last bit: ")[2])[2:], cwd=tmp_path
    )
    assert again.returncode == 2
    assert said in again.stderr


@pytest.mark.parametrize("workers", ["1", "2"])
def test_ctrl_c_is_one_line_exit_130_and_nothing_written(tmp_path: Path, workers: str) -> None:
    out = tmp_path / "out"
    command = ("montecarlo", "--workers", workers, "--out", "out")
    interrupt(*command, cwd=tmp_path, once=out.exists, after=2.0)
    assert list(out.iterdir()) == []


def test_a_scenario_of_ones_own_is_drawn_from_and_its_hardest_sample_filmed(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text(
        "duration = 1.0\ninitial_state = [0, 0.2, 0, 0]\nrequirements.max_position = 0.6\n"
        "[ranges]\ncart_mass = [0.5, 2.0]\nchanges = 4\ncart_mass_rate = 8.0\n"
    )
    result = run(
        "montecarlo", "own.toml", "--controllers", "lqr", "--samples", "4", "--generations", "1",
        "--film", "--out", "out", cwd=tmp_path,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert "afl-mujoco montecarlo own.toml --controllers lqr" in result.stdout
    content = study(tmp_path)
    hardest = content["worst_cases"][0]
    assert hardest["margin"] is not None
    films = json.loads((tmp_path / "out" / "films.json").read_text())["films"]
    assert [film["controllers"] for film in films] == [["lqr"]]
    assert (tmp_path / "out" / films[0]["file"]).stat().st_size > 10_000
    assert "Films" in (tmp_path / "out" / "report.html").read_text()
    scenario = afl.load_scenario(tmp_path / "out" / hardest["file"])
    assert films[0]["scenario"] == scenario.name
    assert len(scenario.cart_mass.times) >= 5
