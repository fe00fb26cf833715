"""Fixtures that more than one folder uses."""

import os
import signal
import sys
from dataclasses import asdict, replace

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.cli.main import main
from afl_mujoco.graphics import choose_backend
from tests.program import without_progress

SEED = 20260
BACKEND = choose_backend()  # before a test imports mujoco
os.environ.pop("COLUMNS", None)  # of pytest-xdist: what is printed has the width of a pipe

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as in a shell's background jobs
    signal.signal(signal.SIGINT, signal.default_int_handler)  # else what a test starts ignores it


@pytest.fixture
def rng():
    return np.random.default_rng(SEED)


@pytest.fixture
def odd_parameters():
    """A plant that differs from the MJCF's numbers in every field."""
    return afl.CartPoleParameters(cart_mass=1.37, pole_mass=0.083, half_length=0.29, gravity=9.65)


@pytest.fixture
def odd_scenario():
    """A plant, schedules and disturbances that share no number and no breakpoint with the defaults.

    Every breakpoint lies off the 1, 2 and 5 ms grids.
    """
    pulse = afl.ForcePulse(force=-7.0, start=0.2511, duration=0.0333)
    schedule = {
        "cart_mass": afl.staircase((0.1507, 0.4003), (0.7, 1.6, 1.1)),
        "half_length": afl.piecewise_linear((0.0503, 0.6009), (0.35, 0.62)),
        **{"pole_mass": 0.083, "gravity": 9.65},
    }
    hits = {"disturbances": (pulse, afl.Impulse(momentum=0.21, time=0.5207))}
    start = (0.11, -0.62, 0.05, 0.4)
    return afl.Scenario(name="odd", schedule=schedule, initial_state=start, duration=0.8, **hits)


@pytest.fixture
def smooth_scenario(odd_scenario, odd_parameters):
    return replace(odd_scenario, name="smooth", schedule=asdict(odd_parameters), disturbances=())


@pytest.fixture(params=["fixed", "adaptive"])
def controller(request):
    return afl.CONTROLLERS[request.param]


@pytest.fixture
def adaptive():
    return afl.CONTROLLERS["adaptive"]


@pytest.fixture
def random_states(rng):
    low, high = np.array([-3.0, -1.4, -5.0, -6.0]), np.array([3.0, 1.4, 5.0, 6.0])
    return rng.uniform(low, high, size=(200, 4))


@pytest.fixture
def graphics():
    """Skip without a headless OpenGL library, or fail where one is demanded."""
    if BACKEND == "disable":
        reason = "no EGL or OSMesa library is installed, so MuJoCo cannot draw off screen"
        if os.environ.get("AFL_MUJOCO_REQUIRE_GL"):
            pytest.fail(f"AFL_MUJOCO_REQUIRE_GL is set, but {reason}")
        pytest.skip(reason)


@pytest.fixture
def command_line(tmp_path, monkeypatch, capsys):
    """Runs the command line in this process, in a folder of its own: quick, for what it refuses.

    Returns exit code, what was printed and what was said on stderr.
    """

    def run(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.chdir(tmp_path)
        code = main(arguments)
        output, errors = capsys.readouterr()
        return code, output, without_progress(errors)

    return run


@pytest.fixture
def refuses(command_line, tmp_path, monkeypatch):
    """Asserts that a command ends with 2 and one line, which it returns, and writes nothing."""
    monkeypatch.setattr(sys, "dont_write_bytecode", True)

    def check(*arguments: str) -> str:
        before = sorted(tmp_path.rglob("*"))
        code, output, errors = command_line(*arguments)
        assert (code, output) == (2, ""), errors
        (line,) = errors.splitlines()
        assert line.startswith("afl-mujoco: ") and sorted(tmp_path.rglob("*")) == before
        return line

    return check


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Writes a module into the working directory, a folder of its own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [p for p in sys.path if p != str(tmp_path)])

    def write(name, text):
        monkeypatch.delitem(sys.modules, name, raising=False)
        (tmp_path / f"{name}.py").write_text(text)

    return write


@pytest.fixture(autouse=True)
def controller_files_are_forgotten(tmp_path_factory):
    """A controller file of one test is not the one that the next test means by the same name."""
    path, known = [*sys.path], {*sys.modules}
    yield
    sys.path[:] = path
    folder = str(tmp_path_factory.getbasetemp())
    for name in sys.modules.keys() - known:
        if str(getattr(sys.modules[name], "__file__", None)).startswith(folder):
            del sys.modules[name]
