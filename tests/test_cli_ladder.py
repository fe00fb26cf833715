"""`afl-mujoco ladder` from the real command line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from page_case import make_curves, make_report
from program import interrupt, run

from afl_mujoco.validation.curves import save_curves

LAW = """\
def push(time, state, belief):
    return 20.0 * state[1] + 4.0 * state[3]
"""


def test_it_writes_numbers_figures_and_a_table_and_a_law_of_ones_own_can_climb(
    tmp_path: Path,
) -> None:
    (tmp_path / "law.py").write_text(LAW)
    (tmp_path / "short.toml").write_text(
        'name = "short"\nduration = 0.5\ninitial_state = [0.0, 0.02, 0.0, 0.0]\n'
    )
    result = run(
        "ladder", "short.toml", "--controllers", "lqr", "law:push",
        "--rungs", "force-limit", "rail", "--seeds", "1", "--scan", "3", "--tolerance", "0.5",
        "--out", "out", cwd=tmp_path,
    )  # fmt: skip
    assert (result.returncode, result.stderr) == (0, "")
    assert "from where the controller no longer survives short" in result.stdout
    assert "afl-mujoco report --survival out puts it on the page" in result.stdout
    content = json.loads((tmp_path / "out" / "ladder.json").read_text())
    assert content["controllers"] == ["lqr", "law.push"]
    assert [r["name"] for r in content["rungs"]] == ["force-limit", "rail"]
    assert content["command"].startswith("afl-mujoco ladder short.toml --controllers lqr law:push")
    assert "--tolerance 0.5" in content["command"] and "--out" not in content["command"]
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert not (tmp_path / "renders").exists()
    figures = {f"ladder-{n}.{k}" for n in ("thresholds", "together") for k in ("svg", "png")}
    assert written == figures | {"ladder.json"}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere"], "scenario must be one of nominal, "),
        (["--controllers", "pid"], "controller must be one of fixed, adaptive, "),
        (["--controllers", "lqr", "lqr"], "controller names must differ, got 'lqr' twice"),
        (["--rungs", "gravity"], "rung must be one of control-period, delay, "),
        (["--seeds", "0"], "seeds must be at least 1, got 0"),
        (["--scan", "1"], "scan must be at least 2, got 1"),
        (["--tolerance", "nan"], "tolerance must lie in 1e-4 to 1, got nan"),
        (["--integrator", "RK5"], "integrator must be one of RK4, Euler"),
        (["--workers", "0"], "workers must be at least 1, got 0"),
        (["--out", "file"], "output folder file cannot be written: file exists"),
        (["real.toml"], "scenario 'real' must be ideal: what departs from it"),
    ],
    ids=str,
)
def test_bad_input_is_one_line_and_nothing_is_written(
    tmp_path: Path, command_line, arguments: list[str], message: str
) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "real.toml").write_text('name = "real"\n[realism]\ndelay = 0.01\n')
    code, output, errors = command_line("ladder", *arguments)
    assert (code, output) == (2, "")
    assert len(errors.splitlines()) == 1
    assert message in errors
    assert {path.name for path in tmp_path.iterdir()} == {"file", "real.toml"}


def test_ctrl_c_is_one_line_exit_130_and_leaves_no_half_file(tmp_path: Path) -> None:
    out = tmp_path / "out"  # it is made when everything is imported and checked
    interrupt("ladder", "--out", "out", cwd=tmp_path, once=out.exists, after=3.0)
    assert list(out.iterdir()) == []


def test_the_page_is_made_anew_only_where_it_was_asked_for(tmp_path: Path, command_line) -> None:
    page_folder = tmp_path / "renders" / "validation"
    page_folder.mkdir(parents=True)
    (page_folder / "report.json").write_text(json.dumps(make_report(second="mine")))
    save_curves(page_folder / "curves.npz", make_curves(second="mine"))
    (tmp_path / "short.toml").write_text("duration = 1.0\n")
    few = ["ladder", "short.toml", "--controllers", "lqr", "--rungs", "rail", "--scan", "2"]
    code, output, errors = command_line(*few, "--tolerance", "1", "--workers", "1", "--out", "own")
    assert (code, errors) == (0, "")
    assert not (page_folder / "report.html").exists()
    code, output, _ = command_line(*few, "--tolerance", "1", "--workers", "1")
    assert code == 0 and "wrote renders/validation/report.html" in output
    page = (page_folder / "report.html").read_text()
    assert 'id="ladder"' in page and "The single flaws of a rig were not tried." in page
    (tmp_path / "renders" / "survival" / "margins.json").write_text("{")
    code, output, errors = command_line(*few)
    assert (code, output) == (2, "")
    assert errors.startswith("afl-mujoco: renders/survival/margins.json is not a survival study")
    assert (page_folder / "report.html").read_text() == page
