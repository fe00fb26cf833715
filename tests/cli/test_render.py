import sys

import pytest

from afl_mujoco.cli import main
from afl_mujoco.errors import GraphicsError
from afl_mujoco.graphics import require_display
from tests.program import interrupt, run

pytestmark = pytest.mark.slow

SMALL = ("--size", "160x128", "--controllers", "adaptive")

BAD = {
    "render nominal --size 1280": "size must be WIDTHxHEIGHT, such as 1280x720, got 1280",
    "render nominal --size 1280x1440": "film height must lie between 128 and 1080 pixels, the ",
    "render --fps 0": "fps must lie between 1 and 240, got 0",
    "render blink.toml": "scenario 'blink' must last a frame at 30 frames per second, got 0.01 s",
    "view --speed 0": "speed must be positive and finite, got 0.0",
}


@pytest.mark.parametrize("line", BAD)
def test_bad_input_is_one_line_and_leaves_no_file(graphics, tmp_path, refuses, line) -> None:
    (tmp_path / "blink.toml").write_text("duration = 0.01\n")
    assert BAD[line] in refuses(*line.split())


def test_without_a_backend_one_line_names_the_packages(tmp_path) -> None:
    where = {"MUJOCO_GL": "glfw", "DISPLAY": "", "WAYLAND_DISPLAY": ""}
    result = run("render", "nominal", *SMALL, cwd=tmp_path, **where)
    assert (result.returncode, result.stdout) == (2, "") and len(result.stderr.splitlines()) == 1
    assert "MUJOCO_GL=glfw must be able to draw; install Debian's libegl1" in result.stderr
    assert "libosmesa6" in result.stderr


@pytest.mark.parametrize("workers", ["1", "2"])
def test_ctrl_c_leaves_whole_films_and_nothing_else(graphics, tmp_path, workers) -> None:
    arguments = ("step-step", "--size", "480x360", "--workers", workers, "--out", "out")
    folder = tmp_path / "out"
    interrupt(
        "render", *arguments, cwd=tmp_path, after=0.3,
        once=lambda: list(folder.glob(".films-*/.*.mp4")),  # an encoder has been started
    )  # fmt: skip
    assert list(folder.iterdir()) == []


def test_view_without_a_display_says_what_to_do(monkeypatch, capsys) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    with pytest.raises(GraphicsError, match="afl-mujoco render makes films without one"):
        require_display()
    assert main(["view", "step-step"]) == 2 and len(capsys.readouterr().err.splitlines()) == 1
