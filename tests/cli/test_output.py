"""Standard output and error as a shell may leave them: another encoding, full, closed, unread."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from afl_mujoco.cli.main import main
from tests.program import COMMAND

SHORT = """
duration = 0.2
[schedule]
cart_mass = 1.0
half_length = 0.5
"""
WRITTEN = {"short.toml", "short-lqr-sampled.npz"}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "short.toml").write_text(SHORT)
    (tmp_path / "fails.toml").write_text(SHORT + "[requirements]\nmax.force = 1e-9\n")
    (tmp_path / "mine.py").write_text("def force(t, x, belief):\n    print('φ')\n    return 0.0\n")
    return tmp_path


def shell(folder: Path, redirected: str, *arguments: str, **variables: str) -> tuple[int, str]:
    """Run a command in a shell that redirects; return its exit code and what stderr got."""
    line = f'exec "$@" {redirected}'
    done = subprocess.run(
        ["sh", "-c", line, "sh", *COMMAND, *arguments], cwd=folder, capture_output=True,
        env={**os.environ, **variables}, timeout=120,
    )  # fmt: skip
    assert b"Traceback" not in done.stderr and b"Exception ignored" not in done.stderr
    return done.returncode, done.stderr.decode(errors="replace")


def simulate(scenario: str, controller: str = "lqr") -> tuple[str, ...]:
    return "simulate", scenario, "--controller", controller, "--no-page", "--out", "out"


def written(folder: Path) -> set[str]:
    return {path.name for path in (folder / "out").iterdir()}


@pytest.mark.slow
def test_an_output_of_another_encoding_gets_every_line(folder: Path) -> None:
    run = simulate("short.toml", "mine:force")
    code, said = shell(folder, ">said", *run, PYTHONIOENCODING="ascii")
    assert (code, said) == (0, "")
    text = (folder / "said").read_text("ascii")
    assert "PASS" in text and r"\u222b" in text  # the integral sign of a metric
    assert r"\u03c6" in text  # what the controller prints
    assert len(written(folder)) == 2


@pytest.mark.slow
def test_what_a_controller_prints_in_a_worker_is_not_its_error(folder: Path) -> None:
    options = ("--samples", "2", "--no-worst-case", "--no-page", "--workers", "2", "--out", "out")
    arguments = ("montecarlo", "short.toml", "--controllers", "mine:force", *options)
    code, said = shell(folder, ">said", *arguments, PYTHONIOENCODING="latin-1")
    assert (code, said) == (0, "")
    assert "UnicodeEncodeError" not in (folder / "out" / "montecarlo.json").read_text()


@pytest.mark.slow
def test_an_output_that_takes_nothing_is_2_after_the_files_are_written(folder: Path) -> None:
    full, run = "no space left on device", simulate("short.toml")
    for redirected, why, arguments in (
        (">/dev/full", full, ("--help",)), (">/dev/full", full, run), (">&-", "it is closed", run),
    ):  # fmt: skip
        shutil.rmtree(folder / "out", ignore_errors=True)
        found = shell(folder, redirected, *arguments)
        assert found == (2, f"afl-mujoco: stdout cannot be written: {why}\n")
        assert arguments is not run or written(folder) == WRITTEN


@pytest.mark.parametrize(("scenario", "verdict"), [("short.toml", 0), ("fails.toml", 1)])
def test_a_pipe_that_closes_is_silent_and_keeps_the_verdict(folder, scenario, verdict) -> None:
    with subprocess.Popen(
        [*COMMAND, *simulate(scenario)], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdout is not None and process.stderr is not None
        process.stdout.close()
        said = process.stderr.read()
    assert (process.returncode, said) == (verdict, b"")
    assert {Path(name).suffix for name in written(folder)} == {".npz", ".toml"}


@pytest.mark.slow
def test_a_stderr_that_is_full_costs_nothing_else_and_a_message_is_still_2(folder: Path) -> None:
    for redirected in ("2>/dev/full", ">&- 2>&-"):
        assert shell(folder, f">said {redirected}", "simulate", "nosuch")[0] == 2
        assert not (folder / "said").exists() or (folder / "said").read_text() == ""
    code, _ = shell(folder, ">said 2>/dev/full", *simulate("short.toml"))
    assert code == 0 and "PASS" in (folder / "said").read_text()


def test_the_streams_of_a_caller_are_left_as_they_were(capsys) -> None:
    assert main(["--version"]) == 0 and main(["nosuch"]) == 2
    output, errors = capsys.readouterr()
    assert output.startswith("afl-mujoco ") and errors.count("\n") == 1
