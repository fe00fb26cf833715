"""A plant in MuJoCo, mutated frame by frame, with its overlays, off screen or in the viewer."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from afl_mujoco.errors import GraphicsError, InvalidValueError
from afl_mujoco.films.camera import Frame, Standpoint, eye_of, watch
from afl_mujoco.films.replay import Replay
from afl_mujoco.scenario.parameters import GREEK
from afl_mujoco.simulation.decor import LARGEST, Colour, add_forces, add_tracks, drawn_model
from afl_mujoco.simulation.mujoco_model import SimulatedModel, write_state
from afl_mujoco.simulation.poses import Track, tracks

SMALLEST = 128
"""Smallest side of a picture [px]."""

GHOST: Colour = (0.75, 0.90, 1.0, 0.45)

BEHIND, RIM = 1.02, 0.005
"""How far from the camera the ghost is, over where it would be, and how much larger it is, as a
share of the extent of the model: a rim where both agree."""

VIEW_PAUSE = 1.5
"""Pause of the viewer before a repetition [s]."""


@dataclass(frozen=True, slots=True)
class Stage:
    """A model that is mutated to the parameters of each frame, and what is drawn around it."""

    model: SimulatedModel
    ghost: mujoco.MjData  # where the ghost is
    paths: list[Standpoint]  # of the camera in each run
    rails: list[Track]

    @classmethod
    def of(cls, replays: Sequence[Replay], fps: int, size: tuple[int, int], frame: Frame) -> Stage:
        """Return the stage of runs of one scenario."""
        model = drawn_model(replays[0].plan)
        paths = watch(model, replays, fps, size, frame)
        angle = np.radians(paths[0].azimuth)
        toward = -np.array([np.cos(angle), np.sin(angle), 0.0])  # where one is who looks
        rails = tracks(replays[0].plan, model, toward)
        return cls(model, mujoco.MjData(model.mj_model), paths, rails)

    def add(self, scene: mujoco.MjvScene, replay: Replay, index: int) -> None:
        """Draw a frame's ghost, forces, end stops and limits."""
        _haunt(scene, self.model, self.ghost, replay, index)
        add_forces(scene, self.model, replay.inputs[index], replay.channels[index])
        add_tracks(scene, self.model, self.rails, replay.state[index])

    def draw(
        self, renderer: mujoco.Renderer, replay: Replay, index: int, path: Standpoint
    ) -> NDArray[np.uint8]:
        """Move everything to a frame and return it, shape (height, width, 3)."""
        pose(self.model, replay, index)
        renderer.update_scene(self.model.mj_data, path.camera(index))
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_SKYBOX):
            renderer.scene.flags[flag] = False
        self.add(renderer.scene, replay, index)
        return np.asarray(renderer.render())


def pose(model: SimulatedModel, replay: Replay, index: int) -> None:
    """Mutate the model to the parameters of a frame, and move it to the frame's state."""
    model.write(replay.values[index])
    write_state(model.addresses, replay.state[index])
    mujoco.mj_forward(model.mj_model, model.mj_data)


def _haunt(
    scene: mujoco.MjvScene,
    model: SimulatedModel,
    ghost: mujoco.MjData,
    replay: Replay,
    index: int,
) -> None:
    """Draw the plant of the ideal loop, pale and just behind, if there is one."""
    if replay.ideal is None:
        return
    m, first = model.mj_model, scene.ngeom
    ghost.qpos[:] = replay.ideal[index, : m.nq]
    mujoco.mj_kinematics(m, ghost)
    option, perturb = mujoco.MjvOption(), mujoco.MjvPerturb()
    moving = int(mujoco.mjtCatBit.mjCAT_DYNAMIC)
    mujoco.mjv_addGeoms(m, ghost, option, perturb, moving, scene)
    eye, known = eye_of(scene), any(scene.camera[0].forward)  # not in the user's part of a viewer
    for number, geom in enumerate(scene.geoms[first : scene.ngeom], start=first):
        geom.objtype = mujoco.mjtObj.mjOBJ_UNKNOWN  # not what it is a ghost of
        geom.segid = geom.objid = number
        geom.rgba[:] = GHOST
        geom.matid = -1
        geom.size[:] = BEHIND * geom.size + RIM * m.stat.extent
        if known:  # farther and larger: in the same place of the picture
            geom.pos[:] = eye + BEHIND * (geom.pos - eye)


def require_size(size: tuple[int, int]) -> None:
    """Raise unless a film can have this size."""
    for thing, side, largest in zip(("width", "height"), size, LARGEST, strict=True):
        if not SMALLEST <= side <= largest:
            rule = f"must lie between {SMALLEST} and {largest} pixels, the off-screen buffer"
            raise InvalidValueError(f"film {thing}", rule, side)
        if side % 2:
            raise InvalidValueError(f"film {thing}", "must be even, for H.264", side)


def view(replay: Replay, fps: int, speed: float) -> None:
    """Show a run in MuJoCo's viewer, over and over, until its window is closed."""
    import mujoco.viewer  # needs a window system, which films do without

    stage = Stage.of([replay], fps, (16, 9), Frame())
    model, (path,) = stage.model, stage.paths
    try:
        handle = mujoco.viewer.launch_passive(
            model.mj_model, model.mj_data, show_left_ui=False, show_right_ui=False
        )
    except (RuntimeError, mujoco.FatalError) as error:
        raise GraphicsError("view", f"needs a display: {error}") from None
    with handle as viewer:
        if path.aims is not None:
            with viewer.lock():
                viewer.cam.lookat[:], viewer.cam.distance = path.aims[0], path.distance
                viewer.cam.azimuth, viewer.cam.elevation = path.azimuth, path.elevation
        start, before = time.monotonic(), 0
        while viewer.is_running():
            elapsed = (time.monotonic() - start) * speed
            if elapsed > replay.time[-1] + VIEW_PAUSE * speed:
                start = time.monotonic()
            index = min(int(np.searchsorted(replay.time, elapsed)), len(replay.time) - 1)
            with viewer.lock():
                pose(model, replay, index)
                viewer.user_scn.ngeom = 0
                if path.aims is not None:  # along with what moves, from where the user stands
                    viewer.cam.lookat[:] += path.aims[index] - path.aims[before]
                stage.add(viewer.user_scn, replay, index)
            labels, values = zip(*replay.readouts(index), strict=True)
            lines = (f"{replay.plan.name}, {replay.controller}", *labels, replay.ended(index))
            left = "\n".join(lines).replace("Δ", "d")
            for name, letter in GREEK.items():  # which its font does not have
                left = left.replace(letter, name)
            viewer.set_texts((None, None, left, "\n".join(("", *values))))
            viewer.sync()
            before = index
            time.sleep(1.0 / 60.0)
