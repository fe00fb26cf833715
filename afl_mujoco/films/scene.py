"""A plant in MuJoCo, mutated frame by frame, with its overlays, off screen or in the viewer."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from afl_mujoco.errors import GraphicsError, InvalidValueError
from afl_mujoco.films.replay import Replay
from afl_mujoco.plants.plant import Floats
from afl_mujoco.scenario.parameters import GREEK
from afl_mujoco.simulation import drawing
from afl_mujoco.simulation.mujoco_model import SimulatedModel, write_state

AHEAD, ASKANCE = (0.0, -9.0), (30.0, -25.0)
"""By how much the camera looks past the plane of motion, and above the horizon [deg]: at a motion
in a plane, and at any other."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """Margins around what moves, as shares of the picture."""

    side: float = 0.04
    top: float = 0.14
    bottom: float = 0.25


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Standpoint:
    """A camera of the MJCF, or one that looks at a point of each frame from a distance."""

    aims: Floats | None = None  # where it looks in each frame [m], None for a camera of the MJCF
    distance: float = 0.0
    azimuth: float = 90.0  # of a camera of the MJCF, as it stands at first
    elevation: float = 0.0

    def camera(self, index: int) -> mujoco.MjvCamera | int:
        """Return the camera of a frame."""
        if self.aims is None:
            return 0
        found = mujoco.MjvCamera()
        found.type = mujoco.mjtCamera.mjCAMERA_FREE
        found.lookat[:] = self.aims[index]
        found.distance, found.azimuth = self.distance, self.azimuth
        found.elevation = self.elevation
        return found


def watch(
    model: SimulatedModel, replays: Sequence[Replay], fps: int, size: tuple[int, int], frame: Frame
) -> list[Standpoint]:
    """Return for each run where the camera stands: the MJCF's own, else one for what moves.

    That is one for all runs, at rest while they stay about where they are, else with each of them;
    every moving body is in the frame at every instant.
    """
    if model.mj_model.ncam and model.plant is replays[0].plan.plant:  # and not those of a scene
        mujoco.mj_forward(model.mj_model, model.mj_data)
        x, y, _ = -model.mj_data.cam_xmat[0].reshape(3, 3)[:, 2]  # where it looks
        return [Standpoint(azimuth=float(np.degrees(np.arctan2(y, x)))) for _ in replays]
    geoms = drawing.drawn_geoms(model.mj_model)
    seen = [drawing.poses(model, geoms, one.values, one.state).around for one in replays]
    aims, _, own = drawing.follow(seen, fps)
    around = drawing.kept(seen, aims, own)
    # of the motion, not of the plant: each point by itself
    width, depth, _ = np.max([np.ptp(points, axis=0).max(axis=0) for points in seen], axis=0)
    past, elevation = AHEAD if min(width, depth) <= drawing.FLAT * max(width, depth) else ASKANCE
    azimuth = (90.0 if width >= depth else 180.0) + past
    axes = _axes(azimuth, elevation)
    distance, offset = _distance(around @ axes.T, model.mj_model.vis.global_.fovy, size, frame)
    return [
        Standpoint(
            aims=aim + offset @ axes[:2], distance=distance, azimuth=azimuth, elevation=elevation
        )
        for aim in aims
    ]


def _axes(azimuth: float, elevation: float) -> Floats:
    """Return where right, up and forward are for a camera [1], a row each."""
    a, e = np.radians((azimuth, elevation))
    forward = np.array([np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)])
    right = np.array([np.sin(a), -np.cos(a), 0.0])
    return np.array([right, np.cross(right, forward), forward])


def _distance(
    points: Floats, fovy: float, size: tuple[int, int], frame: Frame
) -> tuple[float, Floats]:
    """Return the least distance from which points are in the frame, and where to look.

    points: Right, up and forward of the aim [m], shape (K, 3).
    """
    right, up, forward = points.T
    slope = np.tan(np.radians(0.5 * fovy))
    side = slope * size[0] / size[1] * (1.0 - 2.0 * frame.side)
    above, below = slope * (1.0 - 2.0 * frame.top), slope * (1.0 - 2.0 * frame.bottom)

    # of each way, between which points to look from depth 0: each moves by its share of the depth
    ends = [
        (float((x - most * forward).max()), float((x + least * forward).min()), most, least)
        for x, most, least in ((right, side, side), (up, above, below))
    ]
    room = [(low - high) / (most + least) for low, high, most, least in ends]
    distance = max(1e-3 - float(forward.min()), *room)
    looks = [low - most * distance + high + least * distance for low, high, most, least in ends]
    return distance, 0.5 * np.array(looks)


SMALLEST = 128
"""Smallest side of a picture [px]."""

GHOST: drawing.Colour = (0.75, 0.90, 1.0, 0.45)

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
    rails: list[drawing.Track]

    @classmethod
    def of(cls, replays: Sequence[Replay], fps: int, size: tuple[int, int], frame: Frame) -> Stage:
        """Return the stage of runs of one scenario."""
        model = drawing.drawn_model(replays[0].plan)
        paths = watch(model, replays, fps, size, frame)
        angle = np.radians(paths[0].azimuth)
        toward = -np.array([np.cos(angle), np.sin(angle), 0.0])  # where one is who looks
        rails = drawing.tracks(replays[0].plan, model, toward)
        return cls(model, mujoco.MjData(model.mj_model), paths, rails)

    def add(self, scene: mujoco.MjvScene, replay: Replay, index: int) -> None:
        """Draw a frame's ghost, forces, end stops and limits."""
        _haunt(scene, self.model, self.ghost, replay, index)
        drawing.add_forces(scene, self.model, replay.inputs[index], replay.channels[index])
        drawing.add_tracks(scene, self.model, self.rails, replay.state[index])

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
    scene: mujoco.MjvScene, model: SimulatedModel, ghost: mujoco.MjData, replay: Replay, index: int
) -> None:
    """Draw the plant of the ideal loop, pale and just behind, if there is one."""
    if replay.ideal is None:
        return
    m, first = model.mj_model, scene.ngeom
    ghost.qpos[:] = replay.ideal[index, : m.nq]
    mujoco.mj_kinematics(m, ghost)
    option, perturb = mujoco.MjvOption(), mujoco.MjvPerturb()
    mujoco.mjv_addGeoms(m, ghost, option, perturb, int(mujoco.mjtCatBit.mjCAT_DYNAMIC), scene)
    left, right = (np.array(one.pos, np.float64) for one in scene.camera)  # its two eyes
    eye, known = 0.5 * (left + right), any(scene.camera[0].forward)  # not in a viewer's own part
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
    for thing, side, largest in zip(("width", "height"), size, drawing.LARGEST, strict=True):
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
