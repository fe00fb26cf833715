"""Overlays of a scene that belong to no model: ghost, forces, end stops, marks of the rail."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from afl_mujoco.films.camera import CameraPath
from afl_mujoco.films.replay import Replay
from afl_mujoco.simulation.decor import (
    BED_TOP,
    Colour,
    add_forces,
    add_geom,
    add_marks,
    add_stops,
    cart_size,
)
from afl_mujoco.simulation.mujoco_description import POLE_RADIUS

GHOST: Colour = (0.75, 0.90, 1.0, 0.45)
SHADOW: Colour = (0.02, 0.02, 0.04, 0.55)


def add_overlays(
    scene: mujoco.MjvScene,
    replay: Replay,
    index: int,
    places: Sequence[float],
    drawn_mass: float | None = None,
) -> None:
    """Add the overlays: the ghost, the forces, the end stops, the marks of the rail.

    Parameters
    ----------
    places
        Positions of the marks [m].
    drawn_mass
        Mass that gives the drawn size of the cart [kg]; its own by default.
    """
    mass = replay.drawn_mass(index) if drawn_mass is None else drawn_mass
    z = float(replay.state[index, 0])
    add_marks(scene, places)
    add_stops(scene, replay.rail_half_length, mass)
    _add_ghost(scene, replay.ideal[index], mass, float(replay.half_length[index]))
    add_forces(scene, z, mass, float(replay.force[index]), float(replay.push[index]))


def marks(path: CameraPath, index: int, spacing: float) -> list[float]:
    """Return the positions of the marks that the camera sees [m].

    Parameters
    ----------
    spacing
        Distance between marks [m].
    """
    reach = path.distance * path.width / path.pixel_height * 0.3
    first, last = np.ceil((path.x[index] - reach) / spacing), (path.x[index] + reach) / spacing
    return [float(k * spacing) for k in np.arange(first, last)]


def add_shadow(scene: mujoco.MjvScene, replay: Replay, index: int) -> None:
    """Draw the shadow that a light from straight above casts on the track."""
    z, phi = replay.state[index, :2].tolist()
    half = cart_size(replay.drawn_mass(index))
    box = mujoco.mjtGeom.mjGEOM_BOX
    add_geom(scene, box, (half[0], half[1], 0.001), (z, 0.0, BED_TOP + 0.002), SHADOW)
    lean = -2.0 * float(replay.half_length[index] * np.sin(phi))
    if abs(lean) > half[0]:
        edge = float(np.copysign(half[0], lean))
        size = (0.5 * abs(lean - edge), POLE_RADIUS, 0.001)
        add_geom(scene, box, size, (z + 0.5 * (lean + edge), 0.0, BED_TOP + 0.002), SHADOW)


def _add_ghost(
    scene: mujoco.MjvScene, state: NDArray[np.float64], mass: float, length: float
) -> None:
    """Draw the ideal ODE's cart-pole, slightly larger and just behind: a rim if both agree."""
    z, phi = state[:2].tolist()
    half, rim = cart_size(mass), 0.018
    y = 2.0 * rim
    body, sphere = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_SPHERE
    along = np.array([-np.sin(phi), 0.0, np.cos(phi)])
    across = np.array([np.cos(phi), 0.0, np.sin(phi)])
    rotation = np.column_stack([across, [0.0, 1.0, 0.0], along])
    middle, tip = along * length, along * (2.0 * length)
    add_geom(scene, body, [x + rim for x in half], (z, y, -half[2]), GHOST)
    capsule = mujoco.mjtGeom.mjGEOM_CAPSULE
    size = (POLE_RADIUS + rim, length, 0.0)
    add_geom(scene, capsule, size, (z + middle[0], y, middle[2]), GHOST, rotation)
    add_geom(scene, sphere, (0.045,) * 3, (z + tip[0], y, tip[2]), GHOST)
