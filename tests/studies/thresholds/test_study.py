"""`afl-mujoco thresholds` from the real command line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.program import interrupt, run

pytestmark = pytest.mark.slow

CONTROLLER = """\
def push(time, state, belief):
    return 20.0 * state[1] + 4.0 * state[3]
"""


def test_it_writes_numbers_figures_and_a_table_and_a_controller_of_ones_own_is_studied(
    tmp_path: Path,
) -> None:
    (tmp_path / "controller.py").write_text(CONTROLLER)
    (tmp_path / "short.toml").write_text(
        'name = "short"\nduration = 0.5\ninitial_state = [0.0, 0.02, 0.0, 0.0]\n'
    )
    result = run(
        "thresholds", "short.toml", "--controllers", "lqr", "controller:push",
        "--imperfections", "force-limit", "rail", "--seeds", "1", "--scan", "3",
        "--tolerance", "0.5", "--out", "out", cwd=tmp_path,
    )  # fmt: skip
    assert (result.returncode, result.stderr) == (0, "")
    assert "Level at which each controller no longer survives on short" in result.stdout
    assert "out/thresholds.json" in result.stdout and "out/report.html" in result.stdout
    content = json.loads((tmp_path / "out" / "thresholds.json").read_text())
    assert content["controllers"] == ["lqr", "controller.push"]
    assert [r["name"] for r in content["imperfections"]] == ["force-limit", "rail"]
    assert content["command"].startswith(
        "afl-mujoco thresholds short.toml --controllers lqr controller:push"
    )
    assert "--tolerance 0.5" in content["command"] and "--out" not in content["command"]
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert not (tmp_path / "renders").exists()
    names = ("thresholds",)  # all combined was not asked for
    figures = {f"{name}.{suffix}" for name in names for suffix in ("svg", "png")}
    assert written == figures | {"thresholds.json", "thresholds.md", "report.html"}


def test_ctrl_c_is_one_line_exit_130_and_leaves_no_half_file(tmp_path: Path) -> None:
    out = tmp_path / "out"  # it is made when everything is imported and checked
    interrupt("thresholds", "--out", "out", cwd=tmp_path, once=out.exists, after=3.0)
    assert list(out.iterdir()) == []
