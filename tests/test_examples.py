from __future__ import annotations

import json
import shutil
import sys
import types
from pathlib import Path

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.simulation.judgement import CONTROLLER_FAILED
from afl_mujoco.studies.shared.contract import find_study
from afl_mujoco.studies.shared.record import load_record
from tests import program
from tests.feedback import force_of

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"

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

COMMANDS = {
    "simulate": ["simulate", "--simulator", "sampled", "--controller"],
    # a second controller, so that there is work for two processes
    "validate": ["validate", "--workers", "2", "--controllers", "fixed"],
    "render": ["render", "--size", "160x128", "--fps", "10", "--workers", "2", "--controllers"],
}


def arguments_of(command: str, controller: str) -> list[str]:
    controller = f"fixed,{controller}" if command == "render" else controller
    name, *rest = COMMANDS[command]
    return [name, "short.toml", *rest, controller, "--out", "out"]


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "short.toml").write_text("duration = 0.3\n")
    (tmp_path / "broken.py").write_text(BROKEN)
    shutil.copy(EXAMPLES / "own_controller.py", tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    return tmp_path


@pytest.fixture
def drawing(command: str, request: pytest.FixtureRequest) -> None:
    if command == "render":
        request.getfixturevalue("graphics")


def test_the_example_has_ten_lines() -> None:
    text, _, _ = (EXAMPLES / "own_controller.py").read_text().partition("class Integrating")
    body = [x.strip() for x in text.splitlines()]
    assert len([x for x in body if x and not x.startswith(("#", '"""'))]) <= 10


def test_the_first_comparison_says_who_meets_the_requirements(folder: Path) -> None:
    controllers = ("lqr", "adaptive", "own_controller:Integrating")
    arguments = ("compare", "rig.toml", "--controllers", *controllers, "--out", str(folder))
    run = program.run(*arguments, cwd=EXAMPLES, PYTHONDONTWRITEBYTECODE="1")
    assert (run.returncode, run.stderr) == (1, "")
    last = run.stdout.splitlines()[-1]
    assert last.startswith("1 OF 3 PASS: lqr 10 of 10 draws · adaptive 0 of 10 draws · own")
    result = json.loads((folder / "compare.json").read_text())
    outcomes = {one["controller"]: one["outcome"] for one in result["rows"]}
    assert outcomes == dict.fromkeys(("lqr", "adaptive", "own_controller.Integrating"), "completed")


@pytest.mark.parametrize("mode", ["exact", "continuous", "sampled"])
def test_the_example_balances_in_every_mode(mode: str, folder: Path, command_line) -> None:
    asked = ("--simulator", mode, "--controller", "own_controller:force", "--no-page")
    code, _, errors = command_line("simulate", "step-step", *asked, "--out", "out")
    assert (code, errors) == (0, "")
    saved = afl.Trajectory.load(folder / "out" / f"step-step-own_controller.force-{mode}.npz")
    assert str(saved.outcome) == "completed" and abs(saved.state[-1]).max() < 0.01
    assert saved.provenance["controller"]["function"] == "own_controller.force"


def test_the_example_is_validated(folder: Path, command_line) -> None:
    code, _, errors = command_line(*arguments_of("validate", "own_controller:force"))
    assert (code, errors) == (0, "")
    report = json.loads((folder / "out" / "report.json").read_text())
    judged = {c["id"] for c in report["checks"] if c["controller"] == "own_controller.force"}
    assert judged == {"A5", "B1", "B2b", "B3", "B5"}
    assert "own_controller.force" in (folder / "out" / "report.html").read_text()


def test_the_example_is_filmed(graphics: None, folder: Path, command_line) -> None:
    code, _, errors = command_line(*arguments_of("render", "own_controller:force"))
    assert (code, errors) == (0, "")
    assert (folder / "out" / "short-own_controller.force.mp4").stat().st_size > 1000


def test_the_example_has_a_threshold_and_a_broken_controller_fails(folder, command_line) -> None:
    (folder / "short.toml").write_text("duration = 2.0\n")
    code, _, errors = command_line(
        "thresholds", "short.toml", "--controllers", "own_controller:force", "broken:raises",
        "--imperfections", "input_limit", "--seeds", "1", "--scan", "2", "--tolerance", "1",
        "--no-page", "--out", "out",
    )  # fmt: skip
    assert (code, errors) == (0, "")
    found = load_record(find_study("thresholds"), folder / "out").result
    (mine,) = found.sweeps
    (broken,) = found.runs(found.bare["broken.raises"])
    assert mine.survives.holds_at > 50.0  # it needs more than the reference hardware has
    assert [one.failure for one in found.runs(mine.failure)] == ["fell"]
    assert broken.failure == CONTROLLER_FAILED
    assert broken.message.startswith("raised ZeroDivisionError at t = 0.05")


@pytest.mark.parametrize(("command", "controller"), [
    *(("simulate", controller) for controller in SAID),
    *((command, how) for command in ("validate", "render") for how in ("raises", "hangs")),
])  # fmt: skip
def test_a_controller_that_goes_wrong_is_one_line_and_leaves_nothing_unfinished(
    command: str, controller: str, folder: Path, command_line, drawing: None
) -> None:
    code, output, errors = command_line(*arguments_of(command, f"broken:{controller}"))
    assert (code, output) == (2, "") and errors.startswith(f"afl-mujoco: {SAID[controller]}")
    assert len(errors.splitlines()) == 1
    kept = {path.name for path in (folder / "out").rglob("*") if path.is_file()}
    if command == "render" and kept:  # the film of the other was finished first, and listed
        assert kept == {"short-fixed.mp4", "short-fixed.png", "films.json"}
        index = json.loads((folder / "out" / "films.json").read_text())
        assert [film["file"] for film in index["films"]] == ["short-fixed.mp4"]
    else:
        assert not kept


@pytest.mark.parametrize("command", COMMANDS)
def test_a_controller_without_a_force_ends_the_run(command, folder, command_line, drawing) -> None:
    code, output, errors = command_line(*arguments_of(command, "broken:nothing"))
    assert (code, errors) == (0 if command == "render" else 1, "")
    if command == "validate":
        runs = json.loads((folder / "out" / "report.json").read_text())["runs"]
        ended = {r["outcome"] for r in runs if r["controller"] == "broken.nothing"}
        assert ended == {"diverged at t = 0 s"}
        assert "broken.nothing" in (folder / "out" / "report.html").read_text()
    elif command == "simulate":
        assert "diverged at t = 0 s" in output


def test_a_learned_policy_runs_as_a_controller(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a stand-in for what learns: the example's own lines, the scenario and its ranges."""
    made = []

    class Learner:
        def __init__(self, policy: str, environments, **settings) -> None:
            made.append((policy, environments))

        def learn(self, steps: int) -> None:
            made.append(steps)

        def save(self, file: Path) -> None:
            made.append(file)

        @classmethod
        def load(cls, file: Path, device: str) -> Learner:
            return cls("", None)

        def predict(self, seen, deterministic: bool):
            *state, mass, length = seen * [4.0, 2.0, 8.0, 8.0, 2.0, 1.0]
            plant = afl.CartPoleParameters(cart_mass=mass, half_length=length)
            force = force_of(afl.CONTROLLERS["lqr"], np.array(state), plant)
            return np.array([force / 32.0]), None

    def make_vec_env(environment, *, n_envs: int, seed: int, env_kwargs):
        return [environment(**env_kwargs) for _ in range(2)]

    for name, held in {
        "stable_baselines3": {"PPO": Learner},
        "stable_baselines3.common": {},
        "stable_baselines3.common.env_util": {"make_vec_env": make_vec_env},
    }.items():
        monkeypatch.setitem(sys.modules, name, types.SimpleNamespace(**held))
    monkeypatch.syspath_prepend(str(EXAMPLES))
    import learned_policy

    learned_policy.train(10)
    environments = made[0][1]
    seen, info = environments[0].reset(seed=1)
    assert seen.shape == (6,) and info["sample"].startswith("rl-0-")
    assert made[1:] == [10, learned_policy.POLICY]
    result = afl.compare(EXAMPLES / "rl.toml", [learned_policy.controller, "lqr"])
    assert result.passed, result.requirements
