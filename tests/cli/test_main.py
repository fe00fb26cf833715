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
from afl_mujoco.errors import GraphicsError
from tests.program import interrupt, run

SHORT = """
name = "short"
duration = 0.5
[schedule]
cart_mass = {shape = "staircase", times = [0.2], values = [0.5, 1.0]}
half_length = 0.4
[[disturbances]]
shape = "pulse"
force = -5.0
start = 0.3
duration = 0.05
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "short.toml").write_text(SHORT)
    (tmp_path / "bad.toml").write_text(SHORT.replace("[0.5, 1.0]", "[0.5, -1.0]"))
    (tmp_path / "empty.toml").write_text('[replay]\ncontroller = ""')
    return tmp_path


BAD_ARGUMENTS = {
    "validate bad.toml": "bad.toml: schedule.cart_mass must be positive, got -1.0",
    "validate step": "scenario must be one of nominal, step-step, ",
    "simulate nominal --simulator ode --controller lqr-estimated": 'only mode "sampled" ',
    "validate --timestep 0.003 --control-period 0.01": "0.003 s must divide control_period 0.01 s",
    "validate --fast": "--fast is not an option of validate",
    "thresholds --control-period": "--control-period is not an option of thresholds",
    "compare --time-step=1": "is not an option of compare; did you mean --timestep?",
    "margins --level 1": "of margins; did you mean --levels?",
    "--fast": "--fast is not an option of afl-mujoco",
    "simulate nominal step-step": "argument 'step-step' is one too many",
    "thresholds nominal --quick=1": "--quick must have no value, got 1",
    "validat": "got 'validat'; did you mean validate?",
    "": "command must be one of compare, check, validate, thresholds, montecarlo, attraction, ",
    "report nowhere": "nowhere must hold a result: run afl-mujoco validate",
    "simulate --simulator drake": "one of ode, exact, continuous, sampled, got 'drake'",
    "simulate empty.toml": "controller must be one of fixed, adaptive, ",
    "render short.toml --controllers": "--controllers must have a value, got none",
    "simulate --integrator RK5": "one of RK4, Euler, implicit, implicitfast, got 'RK5'",
    "simulate --out short.toml/x": "folder short.toml/x cannot be written: not a directory",
    "validate short.toml --out /proc/afl": "output folder /proc/afl cannot be written: no such",
    "simulate short.toml --out .": "short.toml is the input scenario and",
    "simulate short": "did you mean short.toml?",
}


@pytest.mark.parametrize("line", BAD_ARGUMENTS)
def test_bad_arguments_are_one_line_that_names_thing_rule_and_value(folder, refuses, line) -> None:
    assert BAD_ARGUMENTS[line] in refuses(*shlex.split(line))


@pytest.mark.slow
def test_validate_writes_a_report_that_passes(folder, command_line) -> None:
    code, output, errors = command_line("validate", "short.toml", "--workers", "1", "--out", "out")
    assert (code, errors) == (0, "")
    assert output.rstrip().splitlines()[-1] == "PASS: CODES AGREE 17/17"
    report = json.loads((folder / "out" / "report.json").read_text())
    assert report["verdict"] == "pass"
    written = {p.name for p in (folder / "out").iterdir()}
    texts = {"report.json", "report.md", "report.npz", "report.html"}
    figures = {name for name in written if name.endswith((".svg", ".png", ".replay.json"))}
    assert written == texts | figures and "report-runs-1.replay.json" in figures
    assert report["command"] == "afl-mujoco validate short.toml"
    page = (folder / "out" / "report.html").read_bytes()
    assert command_line("report", "out")[0] == 0
    assert (folder / "out" / "report.html").read_bytes() == page


def test_a_validation_that_fails_exits_with_1_and_names_what_reproduces_it(folder, command_line):
    """Every option that matters and no other."""
    shutil.copy(folder / "short.toml", folder / "my case.toml")
    (folder / "out").mkdir()
    (folder / "out" / "report.html").write_text("of a run before: it would mislead")
    options = ["--controllers", "adaptive", "--timestep", "0.01"]  # RK4 at 10 ms misses B3 by far
    rest = ["--no-page", "--workers", "1", "--out", "out"]
    code, output, _ = command_line("validate", "my case.toml", *options, *rest)
    assert code == 1 and output.rstrip().splitlines()[-1].startswith("FAIL: ")
    report = json.loads((folder / "out" / "report.json").read_text())
    assert report["verdict"] == "fail"
    said = ["afl-mujoco", "validate", "my case.toml", *options]
    assert shlex.split(report["command"]) == said
    written = {p.name for p in (folder / "out").iterdir()}
    assert written == {"report.json", "report.md", "report.npz"}


def test_simulate_writes_run_figure_and_resolved_scenario(folder, command_line) -> None:
    code, output, errors = command_line("simulate", "short.toml", "--out", "out")
    assert (code, errors) == (0, "")
    assert "objective OF" in output and "settling" not in output
    stem = folder / "out" / "short-adaptive-sampled"
    trajectory = afl.Trajectory.load(stem.with_suffix(".npz"))
    again = afl.simulate_mujoco(folder / "out" / "short.toml", "adaptive", "sampled")
    assert (trajectory.state == again.state).all()
    assert stem.with_suffix(".png").stat().st_size > 10_000
    assert len(list((folder / "out").iterdir())) == 3


@pytest.mark.parametrize("workers", ["1", "2"])
def test_ctrl_c_is_one_line_exit_130_and_leaves_no_half_report(folder, workers: str) -> None:
    out = folder / "out"  # it is made when everything is imported and checked
    command = ("validate", "--workers", workers, "--out", "out")
    interrupt(*command, cwd=folder, once=out.exists, after=1.0)
    assert list(out.iterdir()) == []


def test_a_ctrl_c_that_comes_in_a_destructor_is_not_lost(folder) -> None:
    (folder / "own.py").write_text(
        "import signal\nsignal.signal(signal.SIGINT, signal.default_int_handler)\nclass Library:\n"
        "    def __del__(self): signal.raise_signal(signal.SIGINT)\nLibrary()\n"
        "class Half:  # made, and gone only at the end\n    def __del__(self): raise ValueError\n"
        "half = Half()\ndef force(t, state, belief): return 0.0\n"
    )
    result = run("validate", "--controllers", "own:force", cwd=folder)
    assert (result.returncode, result.stderr) == (130, "afl-mujoco: interrupted\n")


def a_library_that_is_loaded(command: Regression) -> int:
    try:
        raise KeyboardInterrupt
    except KeyboardInterrupt as interrupt:
        raise ImportError("initialization failed") from interrupt


def a_callback(made: type[Exception] | None):
    """A ctypes callback loses the interrupt: no cause, no context."""

    class Argument:
        @classmethod
        def from_param(cls, value: object) -> object:
            signal.raise_signal(signal.SIGINT)
            return value

    def run(command: Regression) -> int:
        call = ctypes.CDLL(None).abs
        call.argtypes = [Argument]
        try:
            call(1)
        except ctypes.ArgumentError as lost:
            if made is None:
                raise
            raise made("x", "y") from lost
        return 0

    return run


@pytest.mark.parametrize("command", [
    a_library_that_is_loaded, *map(a_callback, (None, FileNotFoundError, GraphicsError)),
], ids=["import", "callback", "file", "graphics"])  # fmt: skip
def test_a_ctrl_c_of_which_a_library_made_another_error_is_one_line(monkeypatch, capsys, command):
    monkeypatch.setattr(Regression, "run", command)
    assert main(["regression"]) == 130 and capsys.readouterr().err == "afl-mujoco: interrupted\n"
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_error_of_the_program_is_not_taken_for_a_ctrl_c(monkeypatch) -> None:
    def run(command: Regression) -> int:
        raise ImportError("initialization failed")

    monkeypatch.setattr(Regression, "run", run)
    with pytest.raises(ImportError, match="initialization failed"):
        main(["regression"])


SHADOWS = ("pickle", "mujoco", "numpy", "typing", "scipy", "tyro", "signal", "afl_mujoco_x")


@pytest.fixture
def shadowed(folder):
    for name in SHADOWS:
        (folder / f"{name}.py").write_text("raise SystemExit('taken for a module')\n")
    (folder / "mine.py").write_text("def force(t, state, belief): return 0.0\n")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("flags", [[], ["-P"]], ids=["", "-P"])
def test_no_file_of_the_working_folder_hides_a_module(shadowed, flags: list[str]) -> None:
    command = "-m afl_mujoco simulate short.toml --controller mine:force --no-page --out out"
    done = subprocess.run(
        [sys.executable, *flags, *command.split()], cwd=shadowed, capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (1, "")  # it falls
    assert (shadowed / "out" / "short-mine.force-sampled.npz").is_file()


@pytest.mark.slow
def test_no_file_of_the_working_folder_hides_a_module_from_a_worker(shadowed) -> None:
    options = ("--samples", "4", "--workers", "2", "--no-worst-case", "--no-page", "--out", "out")
    done = run("montecarlo", "short.toml", "--controllers", "mine:force", *options, cwd=shadowed)
    assert done.stderr == "" and "wrote out/montecarlo.json" in done.stdout
