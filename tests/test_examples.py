from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import pytest

import afl_mujoco as afl
from tests.feedback import force_of

pytestmark = pytest.mark.slow

EXAMPLES = Path(__file__).parents[1] / "examples"
BROKEN = """
import math

def raises(time, state, belief):
    return 0.0 if time < 0.05 else 1.0 / 0.0
def shape(time, state, belief):
    return state
def hangs(time, state, belief):
    while time > 0.0:  # the first call may take a minute
        pass
    return 0.0
def leaves(time, state, belief):
    raise SystemExit(0)
def nothing(time, state, belief):
    return math.nan
"""
SAID = {
    "raises": "controller 'broken.raises' raised ZeroDivisionError at t = 0.05",
    "shape": "controller 'broken.shape' must return one number at t = 0 s, got an array of shape",
    "hangs": "controller 'broken.hangs' must answer within 1 s (--call-limit), but did not at t = ",
    "leaves": "controller 'broken.leaves' raised SystemExit at t = 0 s: 0",
}


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "short.toml").write_text("duration = 0.3\n")
    (tmp_path / "broken.py").write_text(BROKEN)
    shutil.copy(EXAMPLES / "own_controller.py", tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    return tmp_path


@pytest.mark.parametrize("mode", ["exact", "continuous", "sampled"])
def test_the_example_balances_in_every_mode(mode: str, folder: Path, command_line) -> None:
    asked = ("--simulator", mode, "--controller", "own_controller:force", "--no-page")
    code, _, errors = command_line("simulate", "step-step", *asked, "--out", "out")
    assert (code, errors) == (0, "")
    saved = afl.Trajectory.load(folder / "out" / f"step-step-own_controller.force-{mode}.npz")
    assert str(saved.outcome) == "completed" and abs(saved.state[-1]).max() < 0.01
    assert saved.provenance["controller"]["function"] == "own_controller.force"


@pytest.mark.parametrize("controller", SAID)
def test_a_controller_that_goes_wrong_is_one_line_and_leaves_nothing(
    controller, folder, command_line
):
    asked = ("--controller", f"broken:{controller}", "--out", "out")
    code, output, errors = command_line("simulate", "short.toml", *asked)
    assert (code, output) == (2, "") and errors.startswith(f"afl-mujoco: {SAID[controller]}")
    assert len(errors.splitlines()) == 1 and not list(folder.glob("out/*"))


@pytest.mark.parametrize("how", ["raises", "nothing"])
def test_a_film_of_others_is_kept_where_one_goes_wrong(graphics, how, folder, command_line) -> None:
    asked = ("--size", "160x128", "--fps", "10", "--controllers", f"fixed,broken:{how}")
    code, _, _ = command_line("render", "short.toml", *asked, "--workers", "1", "--out", "out")
    assert code == (2 if how == "raises" else 0)
    films = json.loads((folder / "out" / "films.json").read_text())["films"]
    assert "short-fixed.mp4" in [film["file"] for film in films]


@pytest.mark.parametrize(("controller", "code", "ended"), [
    ("own_controller:force", 0, "completed"), ("broken:nothing", 1, "diverged at t = 0 s"),
])  # fmt: skip
def test_a_controller_of_one_s_own_is_validated(controller, code, ended, folder, command_line):
    asked = ("validate", "short.toml", "--workers", "2", "--controllers", "fixed", controller)
    assert command_line(*asked, "--out", "out")[::2] == (code, "")
    report = json.loads((folder / "out" / "report.json").read_text())
    name = controller.replace(":", ".")
    assert {r["outcome"] for r in report["runs"] if r["controller"] == name} == {ended}
    judged = {c["id"] for c in report["checks"] if c["controller"] == name}
    assert code or judged == {"A5", "B1", "B2b", "B3", "B5"}
    assert name in (folder / "out" / "report.html").read_text()


def test_a_learned_policy_runs_as_a_controller(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a stand-in for what learns: the example's own lines, the scenario and its ranges."""

    def predict(seen, deterministic: bool):
        *state, mass, length = seen * [4.0, 2.0, 8.0, 8.0, 2.0, 1.0]
        plant = afl.CartPoleParameters(cart_mass=mass, half_length=length)
        return np.array([force_of(afl.CONTROLLERS["lqr"], np.array(state), plant) / 32.0]), None

    baselines = MagicMock()
    baselines.PPO.load.return_value.predict = predict
    for name in ("", ".common", ".common.env_util"):
        monkeypatch.setitem(sys.modules, f"stable_baselines3{name}", baselines)
    monkeypatch.syspath_prepend(str(EXAMPLES))
    import learned_policy

    learned_policy.train(10)
    (environment,), asked = baselines.make_vec_env.call_args
    seen, info = environment(**asked["env_kwargs"]).reset(seed=1)
    assert seen.shape == (6,) and info["sample"].startswith("rl-0-")
    result = afl.compare(EXAMPLES / "rl.toml", [learned_policy.controller, "lqr"])
    assert result.passed, result.requirements
