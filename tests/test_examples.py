"""The example of a user's controller, and controllers that go wrong, from the command line."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import types
from pathlib import Path

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.simulation.judgement import CONTROLLER_FAILED
from afl_mujoco.simulation.trajectory import Trajectory
from afl_mujoco.studies.record import load_record
from afl_mujoco.studies.registry import find_study
from tests.program import run as start

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"
SHORT = "duration = 0.3\n"

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
    "exact": ["simulate", "--simulator", "exact", "--controller"],
    "continuous": ["simulate", "--simulator", "continuous", "--controller"],
    "sampled": ["simulate", "--simulator", "sampled", "--controller"],
    # a second controller, so that there is work for two processes
    "validate": ["validate", "--workers", "2", "--controllers", "fixed"],
    "render": ["render", "--size", "160x128", "--fps", "10", "--workers", "2", "--controllers"],
}


def program(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a command that leaves no byte code beside the controllers that it imports."""
    return start(*arguments, cwd=folder, PYTHONPATH=str(ROOT), PYTHONDONTWRITEBYTECODE="1")


def arguments_of(command: str, controller: str, scenario: Path, out: Path) -> list[str]:
    controller = f"fixed,{controller}" if command == "render" else controller
    name, *rest = COMMANDS[command]
    return [name, str(scenario), *rest, controller, "--out", str(out)]


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    path = tmp_path / "short.toml"
    path.write_text(SHORT)
    return path


def files(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file()]


def test_the_example_has_ten_lines() -> None:
    text, _, _ = (EXAMPLES / "own_controller.py").read_text().partition("class Integrating")
    lines = text.splitlines()
    body = [x for x in lines if x.strip() and not x.lstrip().startswith(("#", '"""'))]
    assert len(body) <= 10


def test_the_first_comparison_says_who_meets_the_requirements(tmp_path: Path) -> None:
    controllers = ("lqr", "adaptive", "own_controller:Integrating")
    run = program(
        EXAMPLES, "compare", "rig.toml", "--controllers", *controllers, "--out", str(tmp_path)
    )
    assert (run.returncode, run.stderr) == (1, "")
    last = run.stdout.splitlines()[-1]
    assert last.startswith("1 OF 3 PASS: lqr 10 of 10 draws · adaptive 0 of 10 draws · own")
    result = json.loads((tmp_path / "compare.json").read_text())
    outcomes = {one["controller"]: one["outcome"] for one in result["rows"]}
    assert outcomes == dict.fromkeys(("lqr", "adaptive", "own_controller.Integrating"), "completed")


@pytest.mark.parametrize("mode", ["exact", "continuous", "sampled"])
def test_the_example_balances_in_every_mode(mode: str, tmp_path: Path) -> None:
    arguments = (
        "--simulator",
        mode,
        "--controller",
        "own_controller:force",
        "--out",
        str(tmp_path),
    )
    run = program(EXAMPLES, "simulate", "step-step", *arguments)
    assert (run.returncode, run.stderr) == (0, "")
    saved = Trajectory.load(tmp_path / f"step-step-own_controller.force-{mode}.npz")
    assert str(saved.outcome) == "completed"
    assert abs(saved.state[-1]).max() < 0.01
    assert saved.provenance["controller"]["function"] == "own_controller.force"


def test_the_example_is_validated(scenario: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    run = program(EXAMPLES, *arguments_of("validate", "own_controller:force", scenario, out))
    assert (run.returncode, run.stderr) == (0, "")
    report = json.loads((out / "report.json").read_text())
    judged = {c["id"] for c in report["checks"] if c["controller"] == "own_controller.force"}
    assert judged == {"A5", "B1", "B2b", "B3", "B5"}
    assert "own_controller.force" in (out / "report.html").read_text()


def test_the_example_is_filmed(graphics: None, scenario: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    run = program(EXAMPLES, *arguments_of("render", "own_controller:force", scenario, out))
    assert (run.returncode, run.stderr) == (0, "")
    assert (out / "short-own_controller.force.mp4").stat().st_size > 1000


def test_the_example_has_a_threshold_and_a_broken_controller_fails(tmp_path: Path) -> None:
    (tmp_path / "short.toml").write_text("duration = 2.0\n")
    (tmp_path / "broken.py").write_text(BROKEN)
    example = (EXAMPLES / "own_controller.py").read_text()
    (tmp_path / "own_controller.py").write_text(example)
    run = program(
        tmp_path, "thresholds", "short.toml", "--controllers", "own_controller:force",
        "broken:raises",
        "--imperfections", "input_limit", "--seeds", "1", "--scan", "2", "--tolerance", "1",
        "--out", "out",
    )  # fmt: skip
    assert (run.returncode, run.stderr) == (0, "")
    found = load_record(find_study("thresholds"), tmp_path / "out").result
    (mine,) = found.sweeps
    (broken,) = found.runs(found.bare["broken.raises"])
    assert mine.survives.holds_at > 50.0  # it needs more than the reference hardware has
    assert [one.failure for one in found.runs(mine.failure)] == ["fell"]
    assert broken.failure == CONTROLLER_FAILED
    assert SAID["raises"].endswith(broken.message[: len("raised ZeroDivisionError at t = 0.05")])


@pytest.mark.parametrize(
    ("command", "controller"),
    [
        *(("sampled", controller) for controller in SAID),
        *((command, "raises") for command in COMMANDS if command != "sampled"),
        *((command, "hangs") for command in ("validate", "render")),
    ],
)
def test_a_controller_that_goes_wrong_is_one_line_and_leaves_nothing_unfinished(
    command: str, controller: str, scenario: Path, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    if command == "render":
        request.getfixturevalue("graphics")
    (tmp_path / "broken.py").write_text(BROKEN)
    before = files(tmp_path)
    run = program(
        tmp_path, *arguments_of(command, f"broken:{controller}", scenario, tmp_path / "out")
    )
    assert run.returncode == 2
    assert run.stdout == ""
    assert run.stderr.startswith(f"afl-mujoco: {SAID[controller]}")
    assert len(run.stderr.splitlines()) == 1
    kept = {path.name for path in files(tmp_path)} - {path.name for path in before}
    if (
        command == "render" and kept
    ):  # the film of the other controller was finished first, and listed
        assert kept == {"short-fixed.mp4", "short-fixed.png", "films.json"}
        index = json.loads((tmp_path / "out" / "films.json").read_text())
        assert [film["file"] for film in index["films"]] == ["short-fixed.mp4"]
    else:
        assert not kept


@pytest.mark.parametrize("command", COMMANDS)
def test_a_controller_without_a_force_ends_the_run_and_the_result_says_so(
    command: str, scenario: Path, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    if command == "render":
        request.getfixturevalue("graphics")
    (tmp_path / "broken.py").write_text(BROKEN)
    out = tmp_path / "out"
    run = program(tmp_path, *arguments_of(command, "broken:nothing", scenario, out))
    assert run.returncode == (0 if command == "render" else 1)
    assert run.stderr == ""
    if command == "validate":
        runs = json.loads((out / "report.json").read_text())["runs"]
        ended = {r["outcome"] for r in runs if r["controller"] == "broken.nothing"}
        assert ended == {"diverged at t = 0 s"}
        assert "broken.nothing" in (out / "report.html").read_text()
    elif command != "render":
        assert "diverged at t = 0 s" in run.stdout


def test_a_learned_policy_runs_as_a_controller(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a stand-in for what learns: the example's own lines, the scenario and its ranges."""
    if not os.environ.get("AFL_MUJOCO_REQUIRE_GYMNASIUM"):
        pytest.importorskip("gymnasium")
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
            force = afl.CONTROLLERS["lqr"].force(np.array(state), plant)
            return np.array([force / 32.0]), None

    def make_vec_env(environment, *, n_envs: int, seed: int, env_kwargs):
        return [environment(**env_kwargs) for _ in range(2)]

    common = types.SimpleNamespace(env_util=types.SimpleNamespace(make_vec_env=make_vec_env))
    for name, module in {
        "stable_baselines3": types.SimpleNamespace(PPO=Learner, common=common),
        "stable_baselines3.common": common,
        "stable_baselines3.common.env_util": common.env_util,
    }.items():
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.syspath_prepend(str(EXAMPLES))
    import learned_policy

    learned_policy.train(10)
    environments = made[0][1]
    seen, info = environments[0].reset(seed=1)
    assert seen.shape == (6,) and info["sample"].startswith("rl-0-")
    assert made[1:] == [10, learned_policy.POLICY]
    result = afl.compare(EXAMPLES / "rl.toml", [learned_policy.controller, "lqr"])
    assert result.passed, result.requirements
