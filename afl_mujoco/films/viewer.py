"""MuJoCo's interactive viewer, showing a run in real time, over and over."""

from __future__ import annotations

import time

import mujoco
import mujoco.viewer
import numpy as np

from afl_mujoco.errors import GraphicsError
from afl_mujoco.films.camera import ELEVATION
from afl_mujoco.films.captions import endings, readouts
from afl_mujoco.films.overlays import add_overlays
from afl_mujoco.films.replay import Replay
from afl_mujoco.films.scene import pose
from afl_mujoco.simulation.decor import BAR
from afl_mujoco.simulation.mujoco_model import CartPoleModel

DISTANCE = 7.5
"""Initial distance from the camera to the hinge [m]."""

MARKED = tuple(k * BAR for k in range(-40, 41))
"""Marks of the rail [m]."""

PAUSE = 1.5
"""Pause before a run is shown again [s]."""


def view(replay: Replay, model: CartPoleModel, speed: float) -> None:
    """Show a run until the window is closed."""
    try:
        handle = mujoco.viewer.launch_passive(
            model.mj_model, model.mj_data, show_left_ui=False, show_right_ui=False
        )
    except (RuntimeError, mujoco.FatalError) as error:
        raise GraphicsError("view", f"needs a display: {error}") from None
    with handle as viewer:
        with viewer.lock():
            viewer.cam.lookat[:] = 0.0, 0.0, 0.6
            viewer.cam.distance, viewer.cam.azimuth = DISTANCE, 90.0
            viewer.cam.elevation = ELEVATION
        start = time.monotonic()
        while viewer.is_running():
            elapsed = (time.monotonic() - start) * speed
            if elapsed > replay.time[-1] + PAUSE * speed:
                start = time.monotonic()
            index = min(int(np.searchsorted(replay.time, elapsed)), len(replay.time) - 1)
            _show(viewer, model, replay, index)
            time.sleep(1.0 / 60.0)


def _show(viewer: mujoco.viewer.Handle, model: CartPoleModel, replay: Replay, index: int) -> None:
    """Show a frame; the camera moves along with the cart."""
    with viewer.lock():
        before = float(model.mj_data.qpos[0])
        pose(model, replay, index)
        viewer.cam.lookat[0] += float(replay.state[index, 0]) - before
        viewer.user_scn.ngeom = 0
        add_overlays(viewer.user_scn, replay, index, MARKED, drawn_mass=1.0)  # as the model is
    numbers = readouts(replay, index)
    ended = [text.text for text in endings(replay, index, 0.0, 0.0)]
    labels, values = zip(*numbers, strict=True)
    title = f"{replay.scenario}, {replay.controller}"
    left = "\n".join((title, *labels, *ended)).replace("φ", "phi").replace("Δ", "d")
    viewer.set_texts((None, None, left, "\n".join(("", *values))))
    viewer.sync()
