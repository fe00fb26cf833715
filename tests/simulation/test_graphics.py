"""The drawing backend: what the user set, else what is installed, else none."""

import ctypes.util
import os

import pytest

from afl_mujoco.graphics import choose_backend


@pytest.fixture
def installed(monkeypatch):
    """Return a function that says which libraries there are, with MUJOCO_GL unset."""
    monkeypatch.setenv("MUJOCO_GL", "")  # so that what the code sets is undone
    monkeypatch.delenv("MUJOCO_GL")

    def say(*libraries):
        monkeypatch.setattr(
            ctypes.util, "find_library", lambda name: name if name in libraries else None
        )

    return say


def test_what_the_user_set_is_respected(installed, monkeypatch):
    installed("EGL", "OSMesa")
    monkeypatch.setenv("MUJOCO_GL", "glfw")
    assert choose_backend() == "glfw"
    assert os.environ["MUJOCO_GL"] == "glfw"


@pytest.mark.parametrize(
    ("libraries", "backend"),
    [
        (("EGL", "GL", "OSMesa"), "egl"),
        (("EGL", "OpenGL"), "egl"),
        (("EGL", "OSMesa"), "osmesa"),  # with EGL alone MuJoCo cannot be imported
        (("EGL",), "disable"),
        (("OSMesa",), "osmesa"),
        ((), "disable"),
    ],
    ids=str,
)
def test_the_first_backend_that_is_installed_is_chosen(libraries, backend, installed):
    installed(*libraries)
    assert choose_backend() == backend
    assert os.environ["MUJOCO_GL"] == backend
