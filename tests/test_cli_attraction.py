"""`afl-mujoco attraction` from the real command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from program import interrupt, run

from afl_mujoco.validation.attraction.files import load_comparison

ROOT = Path(__file__).parents[1]


def test_it_writes_maps_figures_and_their_numbers(tmp_path: Path) -> None:
    result = run("attraction", "--controllers", "lqr", "--grid", "5", "--out", "out", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""
    assert "how rollouts end" in result.stdout
    maps = {"attraction-states-lqr.npz", "attraction-plants-lqr.npz"}
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written == maps | {"attraction.json"} | {
        f"attraction-{plane}.{kind}" for plane in ("states", "plants") for kind in ("svg", "png")
    }
    content = json.loads((tmp_path / "out" / "attraction.json").read_text())
    planes = [(entry["plane"], entry["controller"], entry["cells"]) for entry in content["maps"]]
    assert planes == [("states", "lqr", 25), ("plants", "lqr", 25)]
    states = load_comparison(tmp_path / "out" / "attraction-states-lqr.npz")
    np.testing.assert_array_equal(states.ode.cells.columns, [-1.55, -0.775, 0.0, 0.775, 1.55])
    np.testing.assert_array_equal(states.ode.cells.plants, [[1.0, 0.5]] * 25)
    plants = load_comparison(tmp_path / "out" / "attraction-plants-lqr.npz")
    assert plants.ode.cells.rows[[0, -1]].tolist() == pytest.approx([0.05, 1.0])
    assert (plants.ode.cells.starts == [0.0, -np.pi / 3, 0.0, 0.0]).all()


def test_the_numbers_do_not_depend_on_the_threads(tmp_path: Path) -> None:
    arguments = ["--controllers", "lqr", "--planes", "states", "--grid", "7", "--horizon", "3"]
    for threads in ("1", "2"):
        result = run("attraction", *arguments, "--threads", threads, "--out", threads, cwd=tmp_path)
        assert result.returncode == 0, result.stderr
    one, two = ((tmp_path / n / "attraction.json").read_bytes() for n in ("1", "2"))
    assert one == two


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--controllers", "pid"], "controller must be one of fixed, adaptive, "),
        (["--controllers", "lqr", "lqr"], "controller names must differ, got 'lqr' twice"),
        (["--planes", "phase"], "plane must be one of states, plants, got 'phase'"),
        (["--grid", "1"], "grid must be at least 2, got 1"),
        (["--mass", "-1"], "mass must be positive, got -1"),
        (["--masses", "2", "0.1"], "masses must rise from its low end 2, got 0.1"),
        (["--masses", "-1", "1"], "mass must be positive, got -1"),
        (["--max-angle", "nan"], "max_angle must be finite, got nan"),
        (["--timestep", "0.003"], "timestep 0.003 s must divide dwell 1 s"),
        (["--horizon", "0.5"], "dwell must be within 0.5 s, got 1"),
        (["--integrator", "RK5"], "integrator must be one of RK4, Euler"),
        (["--threads", "0"], "threads must be at least 1, got 0"),
        (["--out", "file"], "output folder file cannot be written: file exists"),
        (["--controllers", "pushing:force"], "controller 'pushing.force' is written in Python"),
    ],
    ids=str,
)
def test_bad_input_is_one_line_and_nothing_is_written(
    tmp_path: Path, command_line, arguments: list[str], message: str
) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "pushing.py").write_text("def force(time, state, belief): return 0.0\n")
    code, output, errors = command_line("attraction", *arguments)
    assert (code, output) == (2, "")
    assert len(errors.splitlines()) == 1
    assert message in errors
    left = {path.name for path in tmp_path.iterdir()} - {"__pycache__"}
    assert left == {"file", "pushing.py"}


def test_ctrl_c_is_one_line_exit_130_and_leaves_no_half_file(tmp_path: Path) -> None:
    out = tmp_path / "out"  # it is made when everything is imported and checked
    interrupt(
        "attraction", "--grid", "201", "--out", "out", cwd=tmp_path, once=out.exists, after=3.0
    )
    assert list(out.iterdir()) == []


def test_help_shows_an_example(tmp_path: Path) -> None:
    result = run("attraction", "--help", cwd=tmp_path)
    assert result.returncode == 0
    assert "Example: afl-mujoco attraction" in result.stdout
