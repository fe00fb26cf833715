"""The path of the camera, which follows the cart smoothly and keeps the pole in the picture."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, radians, sin, tan

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from afl_mujoco.films.replay import Replay

FIELD_OF_VIEW = 30.0
"""Vertical field of view [deg], that of ``models/scene.xml``."""

ELEVATION = -9.0
"""Angle of the line of sight above the horizon [deg]."""

SMOOTHING = 0.35
"""Standard deviation of the window over which the camera averages the cart's position [s]."""

TRACK = -0.3
"""Height of the track [m]."""

NUMBERS_Y, NUMBERS_Z = -0.78, -0.36
"""Position of the numbers of the rail: in front of the track, a little lower [m]."""

BEYOND_TIP = 0.15
"""Room above the longest pole [m]."""

TOGETHER = 6.0
"""Cart-pole and ghost are both kept in the picture while they span less than this [m]."""

CART_REACH = 0.45
"""Room on both sides of a cart's centre [m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """The part of a picture in which the cart-poles must stay, as shares of the picture's size.

    Attributes
    ----------
    left, right, top, bottom
        Margins that are kept free.
    foot
        Margin below the numbers of the rail.
    """

    left: float = 0.04
    right: float = 0.04
    top: float = 0.14
    bottom: float = 0.25
    foot: float = 0.165


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraPath:
    """A camera that looks along y at the plane of motion.

    Attributes
    ----------
    x
        Position of the target along the rail [m], shape (N,).
    height
        Height of the target above the hinge [m].
    distance
        Distance from the camera to the target [m].
    width, pixel_height
        Size of the picture [px].
    """

    x: NDArray[np.float64]
    height: float
    distance: float
    width: int
    pixel_height: int

    def project(
        self, index: int, x: NDArray[np.float64], y: float, z: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return where points appear, shape (K, 2), (column, row) [px].

        Parameters
        ----------
        x, y, z
            World coordinates [m], x and z of shape (K,).
        """
        return project(
            x - self.x[index], y, z - self.height, self.distance, self.width, self.pixel_height
        )


def project(
    x: NDArray[np.float64],
    y: float,
    z: NDArray[np.float64],
    distance: float,
    width: int,
    height: int,
) -> NDArray[np.float64]:
    """Return where points appear through a pinhole, shape (K, 2), (column, row) [px].

    Parameters
    ----------
    x, y, z
        Coordinates relative to the target of the camera [m].
    distance
        Distance from the camera to the target [m].
    width, height
        Size of the picture [px].
    """
    tilt = radians(ELEVATION)
    depth = distance + y * cos(tilt) + z * sin(tilt)
    up = z * cos(tilt) - y * sin(tilt)
    scale = 0.5 * height / tan(radians(0.5 * FIELD_OF_VIEW)) / depth
    return np.stack(np.broadcast_arrays(0.5 * width + x * scale, 0.5 * height - up * scale), -1)


def follow(replay: Replay, fps: int, width: int, height: int, frame: Frame) -> CameraPath:
    """Return a path that keeps the cart-pole in the frame, and the ghost while they are together.

    At the chosen distance the longest pole of the film fits at any angle. The position is that of
    the cart averaged over about a second, limited so that the cart does not leave the frame.

    Parameters
    ----------
    width, height
        Size of the picture [px].
    """
    cart, ghost = replay.state[:, 0], replay.ideal[:, 0]
    low, high = _extent(replay.state, replay.half_length)
    other_low, other_high = _extent(replay.ideal, replay.half_length)
    both_low, both_high = np.minimum(low, other_low), np.maximum(high, other_high)
    together = both_high - both_low < TOGETHER
    low, high = np.where(together, both_low, low), np.where(together, both_high, high)
    reach = 2.0 * float(replay.half_length.max()) + BEYOND_TIP
    look, distance = _standpoint(reach, float((high - low).max()), width / height, frame)
    depth = distance + reach * sin(radians(ELEVATION))
    scale = 0.5 * height / tan(radians(0.5 * FIELD_OF_VIEW)) / depth
    left = 0.5 * width * (1.0 - 2.0 * frame.left) / scale
    right = 0.5 * width * (1.0 - 2.0 * frame.right) / scale
    centre = np.where(together, 0.5 * (cart + ghost), cart)
    smooth = gaussian_filter1d(centre, SMOOTHING * fps, mode="nearest")
    x = np.clip(smooth, high - right, low + left)
    return CameraPath(x=x, height=look, distance=distance, width=width, pixel_height=height)


def _extent(
    state: NDArray[np.float64], half_length: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return how far a cart-pole reaches along the rail [m]."""
    cart, tip = state[:, 0], state[:, 0] - 2.0 * half_length * np.sin(state[:, 1])
    return np.minimum(cart - CART_REACH, tip), np.maximum(cart + CART_REACH, tip)


def _standpoint(reach: float, span: float, aspect: float, frame: Frame) -> tuple[float, float]:
    """Return the height to look at and the distance from which track, pole and span fit."""
    slope = tan(radians(0.5 * FIELD_OF_VIEW))
    up, down = 1.0 - 2.0 * frame.top, 1.0 - 2.0 * frame.bottom  # of half the picture's height
    height = (up * TRACK + down * reach) / (up + down)
    tilt = radians(ELEVATION)
    vertical = max(
        (reach - height) * (cos(tilt) / (up * slope) - sin(tilt)),
        (height - TRACK) * (cos(tilt) / (down * slope) + sin(tilt)),
    )
    y, low = NUMBERS_Y, NUMBERS_Z - height
    depressed = (y * sin(tilt) - low * cos(tilt)) / ((1.0 - 2.0 * frame.foot) * slope)
    vertical = max(vertical, depressed - y * cos(tilt) - low * sin(tilt))
    across = 2.0 * (1.0 - frame.left - frame.right) * aspect * slope
    horizontal = span / across - reach * sin(tilt)
    return height, max(vertical, horizontal)
