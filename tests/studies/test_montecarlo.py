import json
import math
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import beta

import afl_mujoco as afl
from afl_mujoco.control.own import PythonController
from afl_mujoco.errors import FileError
from afl_mujoco.report.terminal import to_text
from afl_mujoco.scenario.files import Replay, find_replay, load_scenario
from afl_mujoco.scenario.sample_space import SampleSpace, sample_scenario
from afl_mujoco.simulation.judgement import CONTROLLER_FAILED
from afl_mujoco.studies import montecarlo
from afl_mujoco.studies.montecarlo import run
from afl_mujoco.studies.shared.contract import Interrupted
from afl_mujoco.studies.shared.run import run_all
from afl_mujoco.studies.shared.search import Budget
from tests.feedback import force_of
from tests.plants.plants import varied
from tests.program import run as program

LQR, ADAPTIVE = afl.CONTROLLERS["lqr"], afl.CONTROLLERS["adaptive"]
HEAVY = afl.Scenario(
    name="heavy", duration=2.5, initial_state=(0.0, 0.2, 0.0, 0.0),
    schedule={"pole_mass": 0.2, "cart_mass": 8.0, "half_length": 1.5},
    imperfections=afl.Imperfections(control_period=0.01, delay=0.004),
    requirements=afl.Requirements(max={"z": 0.5, "force": 150.0}),
    ranges={"phi": (-0.4, 0.4), "cart_mass": (6.0, 12.0)},
)  # fmt: skip
SPACE = SampleSpace(HEAVY)


def asked(*controllers, samples=20, space=SPACE, **more) -> montecarlo.Request:
    used = controllers or (LQR,)
    return montecarlo.Request(space, used, [one.name for one in used], samples=samples, **more)


@pytest.fixture(scope="module")
def heavy() -> montecarlo.Result:
    return run(asked(LQR, ADAPTIVE))


def written(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


def test_requirements_decide_which_runs_pass_and_the_rates_are_theirs(heavy) -> None:
    runs = heavy.runs["lqr"]
    for i, one in enumerate(runs):
        alone = afl.simulate_mujoco(sample_scenario(SPACE, i, 1), LQR)
        far, hard = np.abs(alone.state[:, 0]).max(), alone.metrics["max_force"]
        missed = ["max.z"] * bool(far > 0.5) + ["max.force"] * bool(hard > 150.0)
        assert [m.requirement for m in one.missed] == missed
        assert bool(one.failure) == bool(missed) == (one.severity(HEAVY) > 1.0)
        assert one.margin == pytest.approx(min(1.0 - far / 0.5, 1.0 - hard / 150.0))
    passed = sum(not one.failure for one in runs)
    assert 0 < passed < 20
    share, low, high = heavy.rates["lqr"]["passes"]
    assert share == passed / 20 and low == pytest.approx(beta.ppf(0.025, passed, 21 - passed))
    assert high == pytest.approx(beta.ppf(0.975, passed + 1, 20 - passed))
    assert "misses “|z| at most " in to_text(montecarlo.report(heavy).blocks)
    assert f"lqr passes {100 * share:.3g} %" in montecarlo.report(heavy).headline
    assert montecarlo.rate([run.settled for run in runs]) == heavy.rates["lqr"]["settles"]


def test_every_failure_replays_from_its_file_to_the_same_bits(heavy, tmp_path) -> None:
    assert montecarlo.write_files(heavy, tmp_path) == [tmp_path / montecarlo.FOLDER]
    failures = [one for runs in heavy.runs.values() for one in runs if one.failure]
    assert len(written(tmp_path)) == len(failures) > 2
    for one in failures:
        file = tmp_path / montecarlo.file_of(one.controller, one)
        assert load_scenario(file) == sample_scenario(SPACE, one.draw, 1)
        (again,) = run_all(afl.CONTROLLERS[one.controller], [load_scenario(file)])
        assert replace(again, draw=one.draw) == one
        assert find_replay(str(file)) == Replay(controller=one.controller)


def test_failures_of_another_plant_replay_from_their_files(tmp_path, monkeypatch) -> None:
    what = "duration = 0.1\nrequirements.max.arm = 0.1\nranges.arm = [0.2, 0.3]\n"
    (tmp_path / "own.toml").write_text(f'plant = "{varied(tmp_path)}"\n{what}')
    monkeypatch.chdir(tmp_path)
    idle = PythonController(name="idle", function=lambda t, x, belief: 0.0)
    found = run(asked(idle, samples=1, space=SampleSpace(load_scenario("own.toml"))))
    Path("out").mkdir()
    montecarlo.write_files(found, Path("out"))
    (one,) = found.rows
    (again,) = run_all(idle, [load_scenario(Path("out", montecarlo.file_of("idle", one)))])
    assert replace(again, draw=one.draw) == one


def hangs(t, state, belief):
    while True:
        pass


def raises(t, state, belief):
    if t > 0.1 and state[1] > 0.0:
        raise RuntimeError("no idea")
    return force_of(ADAPTIVE, state, belief)


@pytest.mark.parametrize(("function", "message"), [
    (raises, "raised RuntimeError at t = "),
    (lambda t, x, b: np.zeros(2), "must return one number at t = 0 s, got an array of shape"),
    (hangs, "must answer within 0.05 s (--call-limit), but did not at t = 0 s"),
], ids=["raises", "wrong shape", "hangs"])  # fmt: skip
def test_a_controller_that_breaks_down_fails_its_runs_and_says_how(function, message) -> None:
    limits = dict.fromkeys(("call_limit", "first_call_limit"), 5.0 if function is raises else 0.05)
    found = run(asked(PythonController(name="broken", function=function, **limits), LQR, samples=4))
    failed = [one for one in found.runs["broken"] if one.failure == CONTROLLER_FAILED]
    assert len(failed) == 4 or (failed and function is raises)
    assert all(one.message.startswith(message) for one in failed)
    assert message in " ".join(to_text(montecarlo.report(found).blocks).split())


def test_a_controller_without_a_force_ends_the_run_as_a_failure() -> None:
    own = PythonController(name="nan", function=lambda t, x, belief: math.nan)
    assert {one.failure for one in run(asked(own, samples=3)).runs["nan"]} == {"diverged"}


def failing(heavy: montecarlo.Result, *numbers: int, **more) -> montecarlo.Result:
    fell = next(one for one in heavy.rows if one.failure)
    good = next(one for one in heavy.rows if not one.failure)
    rows = [replace(fell if i in numbers else good, controller="lqr", draw=i) for i in range(150)]
    made = {"rows": tuple(rows), "asked": {"lqr": "lqr"}, "worst_cases": ()}
    return replace(heavy, **{**made, **more})


def test_files_are_by_number_and_of_this_study_alone(heavy: montecarlo.Result, tmp_path) -> None:
    montecarlo.write_files(failing(heavy, 3, 123, asked={"lqr": "mine:lqr"}), tmp_path)
    names = {"montecarlo/lqr/failure-0003.toml", "montecarlo/lqr/failure-0123.toml"}
    assert written(tmp_path) == names
    assert find_replay(str(tmp_path / min(names))).controller == "mine:lqr"
    montecarlo.write_files(failing(heavy), tmp_path)
    assert written(tmp_path) == set()
    assert [path.name for path in tmp_path.iterdir()] == [montecarlo.FOLDER]


@pytest.mark.parametrize("name", ["notes.txt", "lqr/failure-1.toml"])
def test_a_file_of_somebody_elses_is_not_lost(heavy, tmp_path, name) -> None:
    montecarlo.write_files(failing(heavy, 3), tmp_path)
    theirs = tmp_path / montecarlo.FOLDER / name
    theirs.parent.mkdir(parents=True, exist_ok=True)
    theirs.write_text("mine")
    for deed in (
        lambda: montecarlo.write_files(failing(heavy, 5), tmp_path),
        lambda: montecarlo.require_files(tmp_path),
    ):
        with pytest.raises(FileError, match="was not written by this study, which replaces its"):
            deed()
    assert theirs.read_text() == "mine" and "montecarlo/lqr/failure-0003.toml" in written(tmp_path)


@pytest.mark.parametrize("when", ["writing", "moving"])
def test_a_write_that_is_broken_off_leaves_what_was_there(heavy, tmp_path, monkeypatch, when):
    montecarlo.write_files(failing(heavy, 3), tmp_path)
    owner, name = {"writing": (montecarlo, "save_scenario"), "moving": (Path, "rename")}[when]
    calls, deed = [], getattr(owner, name)

    def act(*arguments, **options):
        calls.append(arguments)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return deed(*arguments, **options)

    monkeypatch.setattr(owner, name, act)
    with pytest.raises(KeyboardInterrupt):
        montecarlo.write_files(failing(heavy, 5, 6), tmp_path)
    assert written(tmp_path) == {"montecarlo/lqr/failure-0003.toml"}
    assert [path.name for path in tmp_path.iterdir()] == [montecarlo.FOLDER]


@pytest.mark.slow
def test_the_command_writes_everything_and_its_replay_is_the_failure(tmp_path: Path) -> None:
    words = ("--samples", "16", "--generations", "1", "--out", "out")
    result = program("montecarlo", *words, cwd=tmp_path)
    assert (result.returncode, result.stderr) == (0, "")
    content = json.loads((tmp_path / "out" / "montecarlo.json").read_text())
    assert content["command"] == "afl-mujoco montecarlo --samples 16 --generations 1"
    failures = [row for row in content["rows"] if row["failure"]]
    files = {f"montecarlo/{r['controller']}/failure-{r['draw']:04d}.toml" for r in failures}
    files |= {one["file"] for one in content["worst_cases"]}
    made = {"montecarlo.json", "report.html", *content["files"]}
    assert written(tmp_path / "out") == made | files
    assert {"montecarlo.md", "montecarlo-rates.svg"} <= {*content["files"]}
    (printed, *_) = [x for x in result.stdout.splitlines() if x.startswith("afl-mujoco simulate")]
    shown = program(*shlex.split(printed)[1:], "--out", "../shown", cwd=tmp_path / "out")
    assert shown.returncode == 1, shown.stderr  # it falls again
    (file,) = (tmp_path / "shown").glob("*.npz")
    outcome = afl.Trajectory.load(file).outcome
    assert (outcome.kind, outcome.time) == (failures[0]["outcome"], failures[0]["time"])


@pytest.mark.parametrize(("stage", "samples", "said"), [
    ("sampling", 50, "20 of 50 samples"), ("searching", 20, "20 samples, 0 searches"),
])  # fmt: skip
def test_a_ctrl_c_keeps_what_every_controller_has_done(stage, samples, said) -> None:
    request = asked(LQR, ADAPTIVE, samples=samples, space=SampleSpace(replace(HEAVY, duration=0.3)))
    whole = run(request)

    def press(what: str, done: int, total: int) -> None:
        # sampling, of six chunks, three of each controller
        if what.startswith(stage) and (done >= 3 or stage == "searching"):
            raise KeyboardInterrupt

    with pytest.raises(Interrupted) as early:
        run(request._replace(budget=Budget(generations=1)), progress=press)
    assert early.value.done == said
    for name, some in early.value.result.runs.items():
        assert some == whole.runs[name][:20]
