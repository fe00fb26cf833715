"""Choose how MuJoCo draws off screen, before anything imports it."""

from __future__ import annotations

import ctypes.util
import os

BACKENDS = {"egl": "EGL", "osmesa": "OSMesa"}
"""Headless backends of MuJoCo and the library each needs, the preferred one first."""


def choose_backend() -> str:
    """Set ``MUJOCO_GL`` unless it is set, and return it.

    MuJoCo and dm_control read it once, when they are imported. Without a display they would pick a
    window system that is not there; so pick the first headless backend whose library is installed,
    or ``disable``: simulation works without graphics.

    Returns
    -------
    str
        The value of ``MUJOCO_GL``.
    """
    if "MUJOCO_GL" not in os.environ:
        found = (gl for gl, library in BACKENDS.items() if ctypes.util.find_library(library))
        os.environ["MUJOCO_GL"] = next(found, "disable")
    return os.environ["MUJOCO_GL"]
