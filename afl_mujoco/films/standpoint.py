"""Where the camera stands that films another plant than the cart-pole."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from afl_mujoco.films.camera import SMOOTHING, Frame
from afl_mujoco.films.replay import Replay
from afl_mujoco.simulation.mujoco_model import SimulatedModel, write_state

CORNERS = np.array([*itertools.product((-1.0, 1.0), repeat=3)])

AHEAD, ASKANCE = (0.0, -9.0), (30.0, -25.0)
"""By how much the camera looks past the plane of motion, and above the horizon [deg]: at a motion
in a plane, and at any other."""

FLAT = 0.05
"""Motion is in a plane if centres of mass spread less than this share as far across it."""

FAR = 4.0
"""The camera stands still as long as the plant stays within this many times its own size."""

LOST = 50.0
"""Beyond this many times its own size from the camera's aim a plant is not kept in view."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Standpoint:
    """A camera of the MJCF, or one that looks at a point of each frame from a distance."""

    size: tuple[int, int]
    aims: Floats | None = None  # where it looks in each frame [m], None for a camera of the MJCF
    distance: float = 0.0
    azimuth: float = 90.0
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
    if model.mj_model.ncam:
        return [Standpoint(size=size) for _ in replays]
    seen = [_moving(model, replay) for replay in replays]  # (frames, points, 3) each
    everything = np.concatenate([points.reshape(-1, 3) for points in seen])
    own = max(float(np.ptp(points, axis=1).max()) for points in seen) or 1.0
    still = float(np.ptp(everything, axis=0).max()) <= FAR * own
    middle = 0.5 * (everything.min(axis=0) + everything.max(axis=0))
    aims = []
    for points in seen:
        centres = 0.5 * (points.min(axis=1) + points.max(axis=1))
        path = gaussian_filter1d(centres, SMOOTHING * fps, axis=0, mode="nearest")
        aims.append(np.broadcast_to(middle, path.shape) if still else path)
    around = np.concatenate(
        [(x - aim[:, None]).reshape(-1, 3) for x, aim in zip(seen, aims, strict=True)]
    )
    near = (np.abs(around) < LOST * own).all(axis=1)
    around = around[near] if near.any() else np.zeros((1, 3))
    bodies = int(np.count_nonzero(model.mj_model.body_weldid))
    centres = np.concatenate([points[:, :bodies].reshape(-1, 3) for points in seen])
    width, depth = np.ptp(centres[:, 0]), np.ptp(centres[:, 1])
    past, elevation = AHEAD if min(width, depth) <= FLAT * max(width, depth) else ASKANCE
    azimuth = (90.0 if width >= depth else 180.0) + past
    axes = _axes(azimuth, elevation)
    distance, offset = _distance(around @ axes.T, model.mj_model.vis.global_.fovy, size, frame)
    return [
        Standpoint(
            size=size,
            aims=aim + offset @ axes[:2],
            distance=distance,
            azimuth=azimuth,
            elevation=elevation,
        )
        for aim in aims
    ]


def _moving(model: SimulatedModel, replay: Replay) -> Floats:
    """Return centres of mass and corners of what moves, in each frame, shape (N, points, 3)."""
    m, d = model.mj_model, model.mj_data
    geoms = np.flatnonzero(m.body_weldid[m.geom_bodyid] > 0)
    bodies = np.flatnonzero(m.body_weldid > 0)
    found = np.empty((len(replay.time), len(bodies) + 8 * len(geoms), 3))
    for index, points in enumerate(found):
        model.write(replay.values[index])
        write_state(model.addresses, replay.state[index])
        mujoco.mj_kinematics(m, d)
        half = np.array([_half(m, g) for g in geoms.tolist()]).reshape(-1, 1, 3)
        turned = d.geom_xmat[geoms].reshape(-1, 3, 3)
        corners = d.geom_xpos[geoms][:, None] + (half * CORNERS) @ turned.transpose(0, 2, 1)
        points[:] = np.concatenate([d.xipos[bodies], corners.reshape(-1, 3)])
    return found


def _half(m: mujoco.MjModel, geom: int) -> Floats:
    """Return the half-size of a box around a geom [m]."""
    kind, size, kinds = m.geom_type[geom], m.geom_size[geom], mujoco.mjtGeom
    if kind == kinds.mjGEOM_SPHERE:
        return np.full(3, size[0])
    if kind == kinds.mjGEOM_CAPSULE:
        return np.array([size[0], size[0], size[0] + size[1]])
    if kind == kinds.mjGEOM_CYLINDER:
        return np.array([size[0], size[0], size[1]])
    if kind in (kinds.mjGEOM_BOX, kinds.mjGEOM_ELLIPSOID):
        return np.array(size)
    return np.full(3, m.geom_rbound[geom])


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

    def room(distance: float) -> list[tuple[float, float]]:
        depth = distance + forward
        return [
            (float((right - side * depth).max()), float((right + side * depth).min())),
            (float((up - above * depth).max()), float((up + below * depth).min())),
        ]

    low = float(-forward.min()) + 1e-3
    high = low + 1.0
    while any(least > most for least, most in room(high)):
        high = low + 2.0 * (high - low)
    for _ in range(50):
        middle = 0.5 * (low + high)
        fits = all(least <= most for least, most in room(middle))
        low, high = (low, middle) if fits else (middle, high)
    return high, np.array([0.5 * (least + most) for least, most in room(high)])
