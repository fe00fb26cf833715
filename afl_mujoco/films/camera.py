"""The path of the camera, which follows the cart smoothly and keeps the pole in the picture."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, radians, sin, tan

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from afl_mujoco.films.replay import Replay
from afl_mujoco.simulation.poses import SMOOTHING

SLOPE = tan(radians(15.0))
"""Half of the picture's height over the distance: the field of view of ``models/scene.xml``."""

ELEVATION = -9.0  # angle of the line of sight above the horizon [deg]

TILT = radians(ELEVATION)

TRACK = -0.3  # height of the track [m]

NUMBERS_Y, NUMBERS_Z = -0.78, -0.36
"""Position of the numbers of the rail: in front of the track, a little lower [m]."""

BEYOND_TIP = 0.15  # room above the longest pole [m]

TOGETHER = 6.0
"""Cart-pole and ghost are both kept in the picture while they span less than this [m]."""

CART_REACH = 0.45  # room on both sides of a cart's centre [m]


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """Margins around the cart-poles, as shares of the picture; `foot` is below the numbers."""

    side: float = 0.04
    top: float = 0.14
    bottom: float = 0.25
    foot: float = 0.165


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraPath:
    """A camera that looks along y at the plane of motion.

    Its target is at `x`, one for each frame, and `height` above the hinge [m].
    """

    x: NDArray[np.float64]
    height: float
    distance: float
    size: tuple[int, int]

    def project(
        self, index: int, x: NDArray[np.float64], y: float, z: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return where points [m] appear through a pinhole, shape (K, 2), (column, row) [px]."""
        width, height = self.size
        above = z - self.height
        depth = self.distance + y * cos(TILT) + above * sin(TILT)
        scale = 0.5 * height / SLOPE / depth
        column = 0.5 * width + (x - self.x[index]) * scale
        row = 0.5 * height - (above * cos(TILT) - y * sin(TILT)) * scale
        return np.stack(np.broadcast_arrays(column, row), -1)

    def seen(self, index: int, spacing: float) -> NDArray[np.float64]:
        """Return the multiples of a spacing along the rail that the camera sees [m]."""
        reach = 0.3 * self.distance * self.size[0] / self.size[1]
        first, last = np.ceil((self.x[index] - reach) / spacing), (self.x[index] + reach) / spacing
        return spacing * np.arange(first, last)


def follow(replay: Replay, fps: int, size: tuple[int, int], frame: Frame) -> CameraPath:
    """Return a path that keeps the cart-pole in the frame, and the ghost while they are together.

    At the chosen distance the longest pole of the film fits at any angle. The position is that of
    the cart averaged over about a second, limited so that the cart does not leave the frame.
    """
    assert replay.ideal is not None  # a cart-pole has equations
    cart, ghost = replay.state[:, 0], replay.ideal[:, 0]
    low, high = _extent(replay.state, replay.half_length)
    other_low, other_high = _extent(replay.ideal, replay.half_length)
    both_low, both_high = np.minimum(low, other_low), np.maximum(high, other_high)
    together = both_high - both_low < TOGETHER
    low, high = np.where(together, both_low, low), np.where(together, both_high, high)
    reach = 2.0 * float(replay.half_length.max()) + BEYOND_TIP
    across = SLOPE * size[0] / size[1] * (1.0 - 2.0 * frame.side)
    height, distance = _standpoint(reach, float((high - low).max()), across, frame)
    half = across * (distance + reach * sin(TILT))  # half of what the frame spans at the tip [m]
    centre = np.where(together, 0.5 * (cart + ghost), cart)
    smooth = gaussian_filter1d(centre, SMOOTHING * fps, mode="nearest")
    x = np.clip(smooth, high - half, low + half)
    return CameraPath(x=x, height=height, distance=distance, size=size)


def _extent(
    state: NDArray[np.float64], half_length: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return how far a cart-pole reaches along the rail [m]."""
    cart, tip = state[:, 0], state[:, 0] - 2.0 * half_length * np.sin(state[:, 1])
    return np.minimum(cart - CART_REACH, tip), np.maximum(cart + CART_REACH, tip)


def _standpoint(reach: float, span: float, across: float, frame: Frame) -> tuple[float, float]:
    """Return the height to look at and the distance from which track, pole and span fit."""
    up, down = 1.0 - 2.0 * frame.top, 1.0 - 2.0 * frame.bottom  # of half the picture's height
    height = (up * TRACK + down * reach) / (up + down)
    low = NUMBERS_Z - height
    depressed = (NUMBERS_Y * sin(TILT) - low * cos(TILT)) / ((1.0 - 2.0 * frame.foot) * SLOPE)
    return height, max(
        (reach - height) * (cos(TILT) / (up * SLOPE) - sin(TILT)),
        (height - TRACK) * (cos(TILT) / (down * SLOPE) + sin(TILT)),
        depressed - NUMBERS_Y * cos(TILT) - low * sin(TILT),
        0.5 * span / across - reach * sin(TILT),
    )
