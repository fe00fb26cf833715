"""The drawing backend: what the user set, else what is installed, else none."""

import ctypes.util
import os
import re
import shutil
import subprocess
import sys

import numba._dynfunc
import pytest

from afl_mujoco.graphics import choose_backend
from tests.program import run


@pytest.fixture
def installed(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "")  # so that what the code sets is undone
    monkeypatch.delenv("MUJOCO_GL")
    monkeypatch.setenv("PYOPENGL_PLATFORM", "glx")

    def say(*libraries):
        monkeypatch.setattr(ctypes.util, "find_library", {name: name for name in libraries}.get)

    return say


@pytest.mark.parametrize(("libraries", "backend"), [
    (("EGL", "GL", "OSMesa"), "egl"), ((), "disable"),
    (("EGL", "OSMesa"), "osmesa"),  # with EGL alone MuJoCo cannot be imported
    (("EGL", "OSMesa"), "glfw"),  # as the user said
], ids=str)  # fmt: skip
def test_what_the_user_set_is_chosen_or_the_first_that_is_installed(
    libraries, backend, installed, monkeypatch
):
    installed(*libraries)
    if backend == "glfw":
        monkeypatch.setenv("MUJOCO_GL", "glfw")
    assert choose_backend() == backend and os.environ["MUJOCO_GL"] == backend
    platform = "glx" if backend in ("disable", "glfw") else backend
    assert os.environ["PYOPENGL_PLATFORM"] == platform  # MuJoCo refuses to draw with another


def test_a_backend_that_is_not_known_is_one_line_and_so_is_drawing_switched_off(
    tmp_path, monkeypatch, refuses
):
    result = run("simulate", "nominal", "--no-page", cwd=tmp_path, MUJOCO_GL="glx")
    assert (result.returncode, result.stdout, result.stderr.count("\n")) == (2, "", 1)
    said = r"MUJOCO_GL must be one of egl, osmesa, glfw, disable, .*, got glx\n\Z"
    assert re.search(said, result.stderr)
    film = ("render", "nominal", "--controllers", "lqr", "--out", "films")
    monkeypatch.setenv("MUJOCO_GL", "glx")
    assert "MUJOCO_GL must be one of egl" in refuses(*film)
    monkeypatch.setenv("MUJOCO_GL", "off")
    said = refuses(*film)
    assert said.endswith("must not switch drawing off: unset it, or set egl or osmesa, got off")


@pytest.mark.slow
def test_a_film_is_drawn_whatever_platform_pyopengl_is_told(graphics, tmp_path):
    (tmp_path / "short.toml").write_text("duration = 0.1\n")
    arguments = ("short.toml", "--controllers", "lqr", "--size", "320x240", "--fps", "10")
    result = run("render", *arguments, "--out", ".", cwd=tmp_path, PYOPENGL_PLATFORM="glx")
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "short-lqr.mp4").is_file()


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_pytorch_s_compiler_is_loaded_before_mesa_s_where_it_is_installed(tmp_path):
    """Mesa's LLVM would take the place of its own. Any library stands for it here."""
    (folder := tmp_path / "triton" / "_C").mkdir(parents=True)
    (tmp_path / "triton" / "__init__.py").write_text("raise SystemExit('imported')")
    shutil.copy(numba._dynfunc.__file__, folder / "libtriton.so")
    program = (
        "from afl_mujoco.graphics import choose_backend; choose_backend(); "
        "print(open('/proc/self/maps').read().count('libtriton') > 0)"
    )
    environment = {**os.environ, "PYTHONPATH": str(tmp_path), "MUJOCO_GL": "egl"}
    command = [sys.executable, "-c", program]
    ended = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert ended.stdout.split() == ["True"], ended.stderr
