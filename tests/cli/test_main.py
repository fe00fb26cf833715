"""The real command line: exit codes, one clear line, nothing half-written."""

import ctypes
import json
import shlex
import shutil
import signal
import subprocess
import sys

import pytest

import afl_mujoco as afl
from afl_mujoco.cli.commands import Regression
from afl_mujoco.cli.main import main
from afl_mujoco.scenario.files import save_scenario
from tests.program import interrupt
from tests.synthetic_logs import RIG

SHORT = """
name = "short"
duration = 0.5
disturbances = [{shape = "pulse", force = -5.0, start = 0.3, duration = 0.05}]
[schedule]
cart_mass = {shape = "staircase", times = [0.2], values = [0.5, 1.0]}
half_length = 0.4
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "short.toml").write_text(SHORT)
    (tmp_path / "empty.toml").write_text('[replay]\ncontroller = ""')
    return tmp_path


BAD_ARGUMENTS = {
    "validate --timestep 0.003 --control-period 0.01": "0.003 s must divide control_period 0.01 s",
    "validate --fast": "--fast is not an option of validate",
    "margins nominal --control-period": "--control-period must have a value, got none",
    "thresholds --imperfections=": "--imperfections must not be empty, got ''",
    "regression --baselines none": "baseline folder none must exist; make baselines makes it",
    "compare --time-step=1": "is not an option of compare; did you mean --timestep?",
    "simulate nominal step-step": "argument 'step-step' is one too many",
    "thresholds nominal --quick=1": "--quick must have no value, got 1",
    "validat": "got 'validat'; did you mean validate?",
    "": "command must be one of compare, check, validate, thresholds, montecarlo, attraction, ",
    "report nowhere": "nowhere must hold a result: run afl-mujoco validate",
    "simulate empty.toml": "controller must be one of fixed, adaptive, ",
    "simulate --out short.toml/x": "folder short.toml/x cannot be written: not a directory",
    "simulate short.toml --out .": "short.toml is the input scenario and",
    "simulate short": "did you mean short.toml?",
}


@pytest.mark.parametrize("line", BAD_ARGUMENTS)
def test_bad_arguments_are_one_line_that_names_thing_rule_and_value(folder, refuses, line) -> None:
    assert BAD_ARGUMENTS[line] in refuses(*shlex.split(line))


def test_a_validation_that_fails_exits_with_1_and_names_what_reproduces_it(folder, command_line):
    shutil.copy(folder / "short.toml", folder / "my case.toml")
    (folder / "out").mkdir()
    (folder / "out" / "report.html").write_text("of a run before: it would mislead")
    options = ["--controllers", "adaptive", "--timestep", "0.01"]  # RK4 at 10 ms misses B3 by far
    rest = ["--no-page", "--workers", "1", "--out", "out"]
    code, output, _ = command_line("validate", "my case.toml", *options, *rest)
    assert code == 1 and output.rstrip().splitlines()[-1].startswith("FAIL: ")
    report = json.loads((folder / "out" / "report.json").read_text())
    said = ["afl-mujoco", "validate", "my case.toml", *options]
    assert (report["verdict"], shlex.split(report["command"])) == ("fail", said)
    written = {p.name for p in (folder / "out").iterdir()}
    assert written == {"report.json", "report.md", "report.npz"}


def test_simulate_writes_run_figure_and_resolved_scenario(folder, command_line) -> None:
    code, output, errors = command_line("simulate", "short.toml", "--out", "out")
    assert (code, errors) == (0, "")
    assert "objective OF" in output and "settling" not in output
    stem = folder / "out" / "short-adaptive-sampled"
    again = afl.simulate_mujoco(folder / "out" / "short.toml", "adaptive", "sampled")
    assert (afl.Trajectory.load(stem.with_suffix(".npz")).state == again.state).all()
    assert stem.with_suffix(".png").stat().st_size > 10_000
    assert len(list((folder / "out").iterdir())) == 3
    (folder / "out" / f"{stem.name}-log.csv").touch()  # of an older run, as the figure is
    command_line("simulate", "short.toml", "--no-page", "--out", "out")
    assert {path.name for path in (folder / "out").iterdir()} == {"short.toml", f"{stem.name}.npz"}


def test_how_it_was_run_is_kept_and_refused_where_it_cannot_act(folder, command_line, refuses):
    text = (folder / "short.toml").read_text()
    (folder / "short.toml").write_text(text + '[replay]\ncontroller = "lqr"\n')
    held = ("--control-period", "0.02", "--timestep", "0.002")
    assert command_line("simulate", "short.toml", *held, "--no-page", "--out", "out")[0] == 0
    command_line("simulate", "out/short.toml", "--no-page", "--out", "again")
    files = (folder / out / "short-lqr-sampled.npz" for out in ("out", "again"))
    first, second = map(afl.Trajectory.load, files)
    assert (first.state == second.state).all() and len(set(first.command)) == 25
    for simulator, *options in (("ode", *held[:2]), ("exact", "--integrator", "Euler")):
        said = refuses("simulate", "short.toml", "--simulator", simulator, *options)
        assert f"must be left out with {simulator}: sampled alone has it" in said


@pytest.mark.parametrize("workers", ["1", "2"])
def test_ctrl_c_is_one_line_exit_130_and_leaves_no_half_report(folder, workers: str) -> None:
    out = folder / "out"  # it is made when everything is imported and checked
    command = ("validate", "--workers", workers, "--out", "out")
    interrupt(*command, cwd=folder, once=out.exists, after=1.0)
    assert list(out.iterdir()) == []


def a_library_that_is_loaded(command: Regression) -> int:
    raise ImportError("initialization failed") from KeyboardInterrupt()


def a_callback(command: Regression) -> int:
    """A ctypes callback loses the interrupt: no cause, no context."""
    press = classmethod(lambda cls, value: signal.raise_signal(signal.SIGINT) or value)
    call = ctypes.CDLL(None).abs
    call.argtypes = [type("Argument", (), {"from_param": press})]
    return call(1)


@pytest.mark.parametrize("command", [a_library_that_is_loaded, a_callback])
def test_a_ctrl_c_of_which_a_library_made_another_error_is_one_line(monkeypatch, capsys, command):
    monkeypatch.setattr(Regression, "run", command)
    assert main(["regression"]) == 130 and capsys.readouterr().err == "afl-mujoco: interrupted\n"
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    monkeypatch.setattr(Regression, "run", lambda command: (_ for _ in ()).throw(ImportError("x")))
    with pytest.raises(ImportError, match="x"):  # an error of the program is none
        main(["regression"])


@pytest.mark.slow
@pytest.mark.parametrize("flags", [[], ["-P"]], ids=["", "-P"])
def test_no_file_of_the_working_folder_hides_a_module(folder, flags: list[str]) -> None:
    for name in ("pickle", "mujoco", "numpy", "typing", "tyro", "signal"):
        (folder / f"{name}.py").write_text("raise SystemExit('taken for a module')\n")
    (folder / "mine.py").write_text("def force(t, state, belief): return 0.0\n")
    asked = "-m afl_mujoco simulate short.toml --controller mine:force --no-page --out out".split()
    command = [sys.executable, *flags, *asked]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (1, "")  # it falls
    assert (folder / "out" / "short-mine.force-sampled.npz").is_file()


def test_a_recording_of_the_package_is_plotted(command_line, tmp_path) -> None:
    code, output, errors = command_line("log", "--out", "out")
    assert (code, errors) == (0, "")
    assert "Experiment-1008" in output and "20.28" in output and "5 %" in output
    assert (tmp_path / "out" / "Experiment-1008.png").is_file()


@pytest.mark.slow
def test_a_simulated_run_is_written_as_a_log_and_plotted(command_line, tmp_path) -> None:
    save_scenario(RIG, tmp_path / "rig.toml")
    command = ("simulate", "rig.toml", "--controller", "lqr", "--log", "--out", "out")
    code, output, _ = command_line(*command)
    assert code == 0 and "rig-lqr-sampled-log.csv, rig-lqr-sampled-log.toml" in output
    stem = "out/rig-lqr-sampled-log"
    code, output, _ = command_line("log", f"{stem}.csv", "--description", f"{stem}.toml")
    assert code == 0 and "wrote renders/logs/rig-lqr-sampled-log.png" in output


def test_what_cannot_be_is_refused_in_a_line_and_nothing_is_written(refuses) -> None:
    said = refuses("log", "one.csv", "--out", "out")
    assert said.startswith("afl-mujoco: description must be given: logs need their description")
    said = refuses("simulate", "step-step", "--log", "--out", "out")
    assert said.endswith("scenario of a log must keep M and l constant, got step-step")
