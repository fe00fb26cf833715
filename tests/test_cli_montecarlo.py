"""`afl-mujoco montecarlo` from the real command line."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import numpy as np
import pytest
from program import interrupt, run

import afl_mujoco as afl

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
    content = study(folder)
    assert content["study"] == "montecarlo"
    assert content["command"] == (
        "afl-mujoco montecarlo --samples 16 --generations 1 --integrator Euler"
    )
    assert [entry["controller"] for entry in content["controllers"]] == ["adaptive", "lqr"]
    named = {entry[kind] for entry in content["figures"] for kind in ("svg", "png")}
    files = {f["file"] for entry in content["controllers"] for f in entry["failures"]}
    files |= {entry["file"] for entry in content["worst_cases"]}
    out = folder / "out"
    written = {str(p.relative_to(out)) for p in out.rglob("*") if p.is_file()}
    assert written == named | files | {"montecarlo.json"}
    assert sum(entry["survived"] for entry in content["controllers"]) < 32
    said = (folder / "said").read_text()
    assert "16 rigs, seed 1" in said
    assert "worst cases by CMA-ES" in said
    assert said.rstrip().endswith("--survival out puts it on the page of a report")


def test_the_command_that_it_prints_replays_the_failure(folder: Path) -> None:
    lines = (folder / "said").read_text().splitlines()
    printed = [line.removeprefix("replay: ") for line in lines if line.startswith("replay: ")]
    assert printed
    program, command, *arguments = shlex.split(printed[0])
    assert (program, command) == ("afl-mujoco", "simulate")
    result = run("simulate", *arguments, "--out", "shown", cwd=folder)
    assert result.returncode == 0, result.stderr
    controller = arguments[arguments.index("--controller") + 1]
    entry = next(e for e in study(folder)["controllers"] if e["controller"] == controller)
    failure = entry["failures"][0]
    (file,) = (folder / "shown").glob("*.npz")
    shown = afl.Trajectory.load(file)
    assert (shown.outcome.kind, shown.outcome.time) == (failure["outcome"], failure["end_time"])
    rig = afl.load_scenario(folder / "out" / failure["file"])
    alone = afl.simulate_mujoco(rig, afl.CONTROLLERS[controller], "sampled", integrator="Euler")
    assert np.array_equal(shown.state, alone.state)
    bare = run("simulate", arguments[0], "--out", "bare", cwd=folder)
    assert bare.returncode == 0, bare.stderr
    (file,) = (folder / "bare").glob("*.npz")
    assert np.array_equal(afl.Trajectory.load(file).state, alone.state)


def test_one_worker_gives_the_same_bytes_as_two(folder: Path) -> None:
    result = run("montecarlo", "--generations", "1", *FEW[:-1], "one", "--workers", "1", cwd=folder)
    assert result.returncode == 0, result.stderr
    for two in (folder / "out").rglob("*"):
        if two.is_file():
            one = folder / "one" / two.relative_to(folder / "out")
            assert one.read_bytes() == two.read_bytes(), two


def test_a_law_that_breaks_down_is_an_outcome_with_its_message(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "def law(t, state, belief):\n    raise OSError('unplugged')\n"
    )
    laws = ["--controllers", "mine:law", "lqr"]
    result = run(
        "montecarlo", *laws, "--samples", "3", "--out", "out", "--no-worst-case", cwd=tmp_path
    )
    assert result.returncode == 0, result.stderr
    content = study(tmp_path)
    assert content["command"].endswith("mine:law lqr --samples 3 --no-worst-case")
    broken = content["controllers"][0]
    assert broken["failures_by_outcome"] == {"fell": 0, "diverged": 0, "law failed": 3}
    said = "controller 'mine.law' raised OSError at t = 0 s: unplugged"
    assert [failure["message"] for failure in broken["failures"]] == [said] * 3
    assert content["worst_cases"] == []
    assert said in " ".join(result.stdout.split())
    (replay,) = [line for line in result.stdout.splitlines() if line.startswith("replay: ")]
    again = run("simulate", *shlex.split(replay)[3:], cwd=tmp_path)
    assert again.returncode == 2
    assert said in again.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--controllers", "pid"], "controller must be one of fixed, adaptive, "),
        (["--controllers", "lqr", "lqr"], "controller names must differ, got 'lqr' twice"),
        (["--controllers", "nowhere:law"], "controller 'nowhere:law' must be in a module"),
        (["--samples", "0"], "samples must be at least 1, got 0"),
        (["--seed", "-1"], "seed must lie in 0 to 2**63 - 1, got -1"),
        (["--generations", "0"], "generations must be at least 1, got 0"),
        (["--integrator", "verlet"], "integrator must be one of "),
        (["--keep", "-1"], "keep must be at least 0, got -1"),
        (["--workers", "0"], "workers must be at least 1, got 0"),
        (
            ["--cluster", "nowhere"],
            "cluster must be the address of a Dask scheduler, such as tcp://host:8786",
        ),
        (["--out", "taken"], "taken/montecarlo/notes.txt is not of this study"),
        (
            ["--validation", "page", "--films", "page"],
            "page/films.json does not list films: 'schema' is missing",
        ),
    ],
    ids=lambda x: " ".join(x) if isinstance(x, list) else "",
)
def test_bad_input_is_one_line_exit_2_and_nothing_written(
    arguments: list[str], message: str, tmp_path: Path, command_line
) -> None:
    (tmp_path / "taken" / "montecarlo").mkdir(parents=True)
    (tmp_path / "taken" / "montecarlo" / "notes.txt").write_text("mine")
    (tmp_path / "page").mkdir()
    for name in ("report.json", "films.json"):
        (tmp_path / "page" / name).write_text("{}")
    before = sorted(p for p in tmp_path.rglob("*") if p.is_file())
    code, output, errors = command_line("montecarlo", *arguments)
    assert (code, output) == (2, "")
    (line,) = errors.splitlines()
    assert line.startswith(f"afl-mujoco: {message}")
    assert sorted(p for p in tmp_path.rglob("*") if p.is_file()) == before


@pytest.mark.parametrize("workers", ["1", "2"])
def test_ctrl_c_is_one_line_exit_130_and_nothing_written(tmp_path: Path, workers: str) -> None:
    out = tmp_path / "out"
    command = ("montecarlo", "--workers", workers, "--out", "out")
    interrupt(*command, cwd=tmp_path, once=out.exists, after=2.0)
    assert list(out.iterdir()) == []
