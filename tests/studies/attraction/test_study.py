"""`afl-mujoco attraction` from the real command line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from afl_mujoco.studies.record import load_record
from afl_mujoco.studies.registry import find_study
from tests.program import interrupt, run

pytestmark = pytest.mark.slow


def test_it_writes_maps_figures_and_their_numbers(tmp_path: Path) -> None:
    result = run("attraction", "--controllers", "lqr", "--grid", "5", "--out", "out", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""
    assert "How rollouts end" in result.stdout
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written == {"attraction.json", "attraction.npz", "attraction.md", "report.html"} | {
        f"attraction-{plane}.{kind}" for plane in ("states", "plants") for kind in ("svg", "png")
    }
    states, plants = load_record(find_study("attraction"), tmp_path / "out").result.maps
    found = [(pair.plane, pair.controller, pair.points) for pair in (states, plants)]
    assert found == [("states", "lqr", 25), ("plants", "lqr", 25)]
    np.testing.assert_array_equal(states.columns, [-1.55, -0.775, 0.0, 0.775, 1.55])
    np.testing.assert_array_equal(states.plants, [[1.0, 0.5]] * 25)
    assert plants.rows[[0, -1]].tolist() == pytest.approx([0.05, 1.0])
    assert (plants.starts == [0.0, -np.pi / 3, 0.0, 0.0]).all()


def test_the_figure_of_plants_names_the_angle_that_they_start_from(tmp_path: Path) -> None:
    arguments = ["--controllers", "lqr", "--planes", "plants", "--grid", "3", "--horizon", "3"]
    result = run("attraction", *arguments, "--start-angle", "-0.5", "--out", "out", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "On which plants each controller settles from -29°" in result.stdout


def test_the_numbers_do_not_depend_on_the_threads(tmp_path: Path) -> None:
    arguments = ["--controllers", "lqr", "--planes", "states", "--grid", "7", "--horizon", "3"]
    for threads in ("1", "2"):
        result = run("attraction", *arguments, "--workers", threads, "--out", threads, cwd=tmp_path)
        assert result.returncode == 0, result.stderr
    for name in ("attraction.json", "attraction.npz"):
        one, two = ((tmp_path / n / name).read_bytes() for n in ("1", "2"))
        assert one == two


def test_ctrl_c_is_one_line_exit_130_and_leaves_no_half_file(tmp_path: Path) -> None:
    out = tmp_path / "out"  # it is made when everything is imported and checked
    interrupt(
        "attraction", "--grid", "201", "--out", "out", cwd=tmp_path, once=out.exists, after=3.0
    )
    assert list(out.iterdir()) == []
