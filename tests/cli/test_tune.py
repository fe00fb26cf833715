"""`afl-mujoco tune` as a user runs it: resumed to the same bits, bad input in one line."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from afl_mujoco.control.gain_table import GainTable
from tests.program import interrupt, run

pytestmark = pytest.mark.slow

SMALL = (
    "--cart-masses",
    "0.5",
    "1.0",
    "--half-lengths",
    "0.5",
    "--population",
    "60",
    "--workers",
    "1",
)
HAS_DASK = subprocess.run([sys.executable, "-c", "import distributed"], capture_output=True)


def refused(cwd: Path, message: str, *arguments: str) -> None:
    result = run("tune", *arguments, cwd=cwd)
    assert result.returncode == 2, result.stderr
    assert result.stdout == ""
    assert len(result.stderr.splitlines()) == 1
    assert message in result.stderr


def test_an_interrupted_table_goes_on_to_the_same_bytes(tmp_path: Path) -> None:
    table = ("table", *SMALL, "--generations", "1500")
    whole = run("tune", *table, "--out", "whole", cwd=tmp_path)
    assert whole.returncode == 0, whole.stderr
    checkpoints = tmp_path / "broken" / "searches" / "checkpoints"
    interrupt(
        "tune", *table, "--out", "broken", cwd=tmp_path,
        once=lambda: checkpoints.exists() and list(checkpoints.iterdir()),
    )  # fmt: skip
    assert not (tmp_path / "broken" / "gain_table.json").exists()

    refused(tmp_path, "has a search: pass --resume to continue it", *table, "--out", "broken")
    other = ("table", *SMALL, "--generations", "1501", "--resume", "--out", "broken")
    refused(tmp_path, "settings.generations is 1500 there and 1501 here", *other)
    resumed = run("tune", *table, "--resume", "--out", "broken", cwd=tmp_path)
    assert resumed.returncode == 0, resumed.stderr
    one, other_one = (tmp_path / name / "gain_table.json" for name in ("whole", "broken"))
    assert one.read_bytes() == other_one.read_bytes()
    assert len(GainTable.load(one).rows) == 2


def test_a_grid_in_another_order_is_another_search(tmp_path: Path) -> None:
    grid = (
        "table",
        "--half-lengths",
        "0.5",
        "--population",
        "20",
        "--workers",
        "1",
        "--out",
        "out",
    )
    first = run("tune", *grid, "--generations", "2", "--cart-masses", "1", "2", cwd=tmp_path)
    assert first.returncode == 0, first.stderr
    other = (*grid, "--generations", "2", "--cart-masses", "2", "1", "--resume")
    refused(tmp_path, "cart_masses", *other)


def test_a_plant_that_falls_in_mujoco_has_no_objective_there(tmp_path: Path) -> None:
    gains = ("--lower", "100", "1000", "90", "--upper", "100", "1000", "90")
    small = (
        "--cart-masses",
        "1",
        "--half-lengths",
        "0.5",
        "--population",
        "20",
        "--generations",
        "1",
    )
    result = run("tune", "table", *gains, *small, "--workers", "1", "--out", "out", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    content = json.loads((tmp_path / "out" / "gain_table.json").read_text())
    assert content["rows"][0][-1] is None
    assert content["rows"][0][-2] >= 1e9


def test_a_table_is_fitted_and_its_gains_are_written(tmp_path: Path) -> None:
    result = run("tune", "fit", "--out", "out", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "slope          least squares" in result.stdout
    written = json.loads((tmp_path / "out" / "gain_functions.json").read_text())
    assert written["fixed"]["switching"] == pytest.approx(100.0)


BAD = {
    "box upside down": (
        ["table", "--lower", "100", "5", "90", "--upper", "200", "1", "110"],
        "upper[1] must not be below lower 5.0, got 1.0",
    ),
    "empty grid": (
        ["table", "--cart-masses"],
        "cart mass of the grid must have at least one value",
    ),
    "negative mass": (
        [
            "table",
            "--cart-masses",
            "-1",
            "--half-lengths",
            "0.5",
            "--population",
            "20",
            "--workers",
            "1",
        ],
        "cart mass of the grid must be positive",
    ),
    "negative seed": (["table", "--seed", "-1"], "seed must be at least 0, got -1"),
    "box below zero": (
        ["table", "--lower", "100", "-5", "90"],
        "lower bound of slope must be positive, got -5",
    ),
    "box too stiff": (
        ["table", "--upper", "1e12", "5", "110"],
        "would take as many steps",
    ),
    "mass given twice": (["table", "--cart-masses", "1", "1"], "cart mass of the grid must differ"),
    "no population": (["table", "--population", "0"], "population_size must be at least 1"),
    "no workers": (["table", "--workers", "0"], "workers must be at least 1, got 0"),
    "missing table": (["fit", "--table", "none.json"], "none.json cannot be read: no such file"),
    "no such tuning": (["tabel"], "must be one of table, fit"),
}


@pytest.mark.parametrize("case", BAD, ids=str)
def test_bad_input_is_one_line_and_leaves_nothing(tmp_path: Path, case: str) -> None:
    arguments, message = BAD[case]
    refused(tmp_path, message, *arguments)


@pytest.mark.skipif(HAS_DASK.returncode != 0, reason="Dask is not installed: make cluster")
def test_a_cluster_that_cannot_be_reached_is_one_line_and_soon(tmp_path: Path) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    began = time.monotonic()
    refused(tmp_path, address, "table", *SMALL, "--cluster", address)
    assert time.monotonic() - began < 30.0  # a step of reaching it has 3 s
    assert not (tmp_path / "renders" / "tuning" / "searches").exists()


@pytest.mark.parametrize("what", [[], ["table"], ["fit"]], ids=str)
def test_help_shows_an_example(tmp_path: Path, what: list[str]) -> None:
    result = run("tune", *what, "--help", cwd=tmp_path)
    assert result.returncode == 0
    assert "Example: afl-mujoco tune" in result.stdout
