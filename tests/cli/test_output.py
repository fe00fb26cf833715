"""Standard output and error as a shell may leave them: another encoding, full, closed, unread."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.program import COMMAND


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "short.toml").write_text("duration = 0.2\n")
    (tmp_path / "fails.toml").write_text("duration = 0.2\nrequirements.max.force = 1e-9\n")
    (tmp_path / "mine.py").write_text("def force(t, x, belief):\n    print('φ')\n    return 0.0\n")
    return tmp_path


def shell(folder: Path, redirected: str, *arguments: str, **variables: str) -> tuple[int, str]:
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
def test_an_output_that_takes_nothing_is_2_after_the_files_are_written(folder: Path) -> None:
    full, run = "no space left on device", simulate("short.toml")
    for redirected, why, arguments in (
        (">/dev/full", full, ("--help",)), (">/dev/full", full, run), (">&-", "it is closed", run),
    ):  # fmt: skip
        shutil.rmtree(folder / "out", ignore_errors=True)
        found = shell(folder, redirected, *arguments)
        assert found == (2, f"afl-mujoco: stdout cannot be written: {why}\n")
        assert arguments is not run or written(folder) == {"short.toml", "short-lqr-sampled.npz"}


def test_a_pipe_that_closes_is_silent_and_keeps_the_verdict(folder: Path) -> None:
    pipes, command = dict.fromkeys(("stdout", "stderr"), subprocess.PIPE), simulate("fails.toml")
    with subprocess.Popen([*COMMAND, *command], cwd=folder, **pipes) as process:
        process.stdout.close()
        said = process.stderr.read()
    assert (process.returncode, said) == (1, b"")
    assert {Path(name).suffix for name in written(folder)} == {".npz", ".toml"}
