"""Where the camera stands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from afl_mujoco.films.replay import Replay
from afl_mujoco.plants.plant import Floats
from afl_mujoco.simulation.mujoco_model import SimulatedModel
from afl_mujoco.simulation.poses import FLAT, drawn_geoms, follow, kept, poses

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


def eye_of(scene: mujoco.MjvScene) -> Floats:
    """Return where the camera of a scene is [m]: in the middle of its two eyes."""
    left, right = scene.camera
    return 0.5 * (np.array(left.pos, np.float64) + np.array(right.pos, np.float64))


def watch(
    model: SimulatedModel,
    replays: Sequence[Replay],
    fps: int,
    size: tuple[int, int],
    frame: Frame,
) -> list[Standpoint]:
    """Return for each run where the camera stands: the MJCF's own, else one for what moves.

    That is one for all runs, at rest while they stay about where they are, else with each of them;
    every moving body is in the frame at every instant.
    """
    if model.mj_model.ncam and model.plant is replays[0].plan.plant:  # and not those of a scene
        mujoco.mj_forward(model.mj_model, model.mj_data)
        x, y, _ = -model.mj_data.cam_xmat[0].reshape(3, 3)[:, 2]  # where it looks
        return [Standpoint(azimuth=float(np.degrees(np.arctan2(y, x)))) for _ in replays]
    geoms = drawn_geoms(model.mj_model)
    seen = [poses(model, geoms, one.values, one.state).around for one in replays]
    aims, _, own = follow(seen, fps)
    around = kept(seen, aims, own)
    # of the motion, not of the plant: each point by itself
    width, depth, _ = np.max([np.ptp(points, axis=0).max(axis=0) for points in seen], axis=0)
    past, elevation = AHEAD if min(width, depth) <= FLAT * max(width, depth) else ASKANCE
    azimuth = (90.0 if width >= depth else 180.0) + past
    axes = _axes(azimuth, elevation)
    distance, offset = _distance(around @ axes.T, model.mj_model.vis.global_.fovy, size, frame)
    return [
        Standpoint(
            aims=aim + offset @ axes[:2],
            distance=distance,
            azimuth=azimuth,
            elevation=elevation,
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
