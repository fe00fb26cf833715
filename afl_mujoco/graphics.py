"""Choose how MuJoCo draws off screen, before anything imports it."""

from __future__ import annotations

import contextlib
import ctypes.util
import functools
import importlib
import importlib.util
import os
import subprocess
import sys
from collections.abc import MutableMapping, Sequence
from pathlib import Path

from afl_mujoco.errors import GraphicsError

BACKENDS = {"egl": (("EGL",), ("OpenGL", "GL")), "osmesa": (("OSMesa",),)}
"""Headless backends of MuJoCo, the preferred one first, and the libraries without which MuJoCo
cannot even be imported with them: one of each group."""

OFF = ("disable", "disabled", "off", "false", "0")  # values with which MuJoCo does not draw
KNOWN = (*BACKENDS, "glfw", *OFF, "enable", "enabled", "on", "true", "1")
"""Values of ``MUJOCO_GL`` that both MuJoCo and dm_control know."""

PACKAGES = "install Debian's libegl1 and libgl1 (EGL), or libosmesa6 (OSMesa)"

PROBE_TIMEOUT = 60.0  # how long a backend may take to draw its first picture [s]; a second is usual

_PROBE = """
import mujoco
model = mujoco.MjModel.from_xml_string(
    '<mujoco><worldbody><light pos="0 0 2"/><geom size="1"/></worldbody></mujoco>'
)
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
with mujoco.Renderer(model, 16, 16) as renderer:
    renderer.update_scene(data)
    raise SystemExit(0 if renderer.render().any() else "drew nothing")
"""

_PROBE_WINDOW = """
import glfw
if not glfw.init():
    raise SystemExit("glfw cannot use the display")
glfw.window_hint(glfw.VISIBLE, 0)
window = glfw.create_window(64, 64, "", None, None)
raise SystemExit(None if window else "glfw cannot open a window")
"""

DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")  # variables that name a display, on Linux


def choose_backend() -> str:
    """Set ``MUJOCO_GL`` unless it is set, and return it.

    MuJoCo and dm_control read it once, when they are imported. Without a display they would pick a
    window system that is not there; so pick the first headless backend whose libraries are
    installed, or ``disable``: simulation works without graphics. PyTorch's compiler is loaded first
    where there is one, see `_load_triton`.
    """
    asked = _asked()
    backend = asked or next(filter(_installed, BACKENDS), "disable")
    if backend != "disable":
        _load_triton()
    _use(backend)
    if asked in BACKENDS and not _installed(asked):
        try:  # the libraries may be where only the loader finds them
            importlib.import_module(f"mujoco.{asked}")
        except Exception as error:
            raise _undrawable(f"MUJOCO_GL={asked}", [f"{type(error).__name__}: {error}"]) from None
    return backend


def _asked() -> str:
    """Return what the user set, empty if nothing, or raise unless it is known."""
    asked = os.environ.get("MUJOCO_GL", "").strip().lower()
    if asked and asked not in KNOWN:
        raise GraphicsError("MUJOCO_GL", f"must be one of {', '.join(KNOWN)}", asked)
    return asked


def _installed(backend: str) -> bool:
    return all(any(map(ctypes.util.find_library, group)) for group in BACKENDS[backend])


def _use(backend: str, environment: MutableMapping[str, str] = os.environ) -> None:
    """Set a backend, also for PyOpenGL, which it refuses to share with another platform."""
    environment["MUJOCO_GL"] = backend
    if backend in BACKENDS:
        environment["PYOPENGL_PLATFORM"] = backend


def _undrawable(thing: str, refusals: Sequence[str]) -> GraphicsError:
    return GraphicsError(thing, f"must be able to draw; {PACKAGES} ({'; '.join(refusals)})")


@functools.cache
def _load_triton() -> None:
    """Load the library of ``triton``, which comes with PyTorch for GPUs, if it is installed.

    Mesa draws in software by LLVM, which it makes visible to every library that is loaded after it
    (``RTLD_GLOBAL``), as soon as dm_control opens a display, which it does when it is imported.
    Triton holds an LLVM of another version and would take functions of Mesa's for its own: Python
    ends with a segmentation fault. What is loaded first has found its own.
    """
    spec = importlib.util.find_spec("triton")  # imports nothing
    for folder in (spec.submodule_search_locations or ()) if spec else ():
        for library in Path(folder, "_C").glob("libtriton*.so"):
            with contextlib.suppress(OSError):  # what cannot be loaded cannot meet Mesa
                ctypes.CDLL(str(library))


def require_backend() -> str:
    """Set ``MUJOCO_GL`` to a backend that draws, and return it.

    Each candidate draws a picture in a process of its own, because a missing library or driver can
    end a process. What the user set is the only candidate; else EGL, then OSMesa. Call it before
    anything imports MuJoCo.
    """
    asked = _asked()
    if asked in OFF:
        raise GraphicsError(
            "MUJOCO_GL",
            f"must not switch drawing off: unset it, or set {' or '.join(BACKENDS)}",
            asked,
        )
    candidates = [asked] if asked else list(BACKENDS)
    refusals = []
    for backend in candidates:
        if not (refusal := _refusal(backend)):
            _use(backend)
            return backend
        refusals.append(f"{backend}: {refusal}")
    raise _undrawable(f"MUJOCO_GL={asked}" if asked else "headless rendering", refusals)


def require_display() -> None:
    """Raise unless there is a display on which a window can be opened."""
    named = [os.environ[name] for name in DISPLAYS if os.environ.get(name)]
    if sys.platform == "linux" and not named:
        rule = f"needs a display: neither {' nor '.join(DISPLAYS)} is set"
        raise GraphicsError("view", f"{rule}; afl-mujoco render makes films without one")
    if refusal := _refusal("glfw", _PROBE_WINDOW):
        rule = "needs a display on which a window can be opened"
        raise GraphicsError("view", f"{rule} ({refusal})", ", ".join(named) or None)


def _refusal(backend: str, program: str = _PROBE) -> str:
    """Return why a program cannot draw with a backend, in one line; nothing if it can."""
    environment = {**os.environ}
    _use(backend, environment)
    try:
        probe = subprocess.run(
            [sys.executable, "-P", "-c", program],  # no module of the working directory
            env=environment,
            capture_output=True,
            text=True,
            timeout=PROBE_TIMEOUT,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"no picture within {PROBE_TIMEOUT:g} s"
    if probe.returncode == 0:
        return ""
    said = probe.stderr.strip().splitlines()
    return said[-1].strip() if said else f"ended with code {probe.returncode}"
