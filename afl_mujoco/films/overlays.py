"""What a scene shows that belongs to no model: the ghost, the forces, the marks of the rail."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.films.camera import CameraPath
from afl_mujoco.films.replay import Replay
from afl_mujoco.simulation.mujoco_description import CART_HALF_SIZE, POLE_RADIUS

ARROW_SCALE = 0.2
"""Length of a force's arrow [m] over the square root of the force [N]: 1 N is seen, 100 N fits."""

BAR = 0.5
"""Spacing of the marks along the rail [m]; every second one is longer and has a number."""

Colour = tuple[float, float, float, float]
GHOST: Colour = (0.75, 0.90, 1.0, 0.45)
FORCE: Colour = (0.25, 0.85, 0.62, 1.0)
PUSH: Colour = (0.95, 0.45, 0.75, 1.0)
SHADOW: Colour = (0.02, 0.02, 0.04, 0.55)
MARK: Colour = (0.62, 0.66, 0.72, 1.0)
LIGHT_CART, HEAVY_CART = (0.55, 0.78, 0.98), (0.10, 0.27, 0.62)
HEAVY = 2.0
"""Cart mass whose cart has the darkest blue [kg]."""

_BED_TOP, _BED_FRONT = -0.30, -0.70
_FORCE_LINE, _PUSH_LINE = -0.15, -0.03


def add_overlays(
    scene: mujoco.MjvScene,
    replay: Replay,
    index: int,
    places: Sequence[float],
    drawn_mass: float | None = None,
) -> None:
    """Add what belongs to no model: the ghost, the forces, the marks of the rail.

    Parameters
    ----------
    places
        Of the marks [m].
    drawn_mass
        Mass as which the cart is drawn [kg]; its own by default.
    """
    mass = float(replay.cart_mass[index]) if drawn_mass is None else drawn_mass
    z, half = float(replay.state[index, 0]), cart_size(mass)[0]
    _add_marks(scene, places)
    _add_ghost(scene, replay.ideal[index], mass, float(replay.half_length[index]))
    _add_arrow(scene, z, float(replay.force[index]), FORCE, half, _FORCE_LINE, pulls=True)
    _add_arrow(scene, z, float(replay.push[index]), PUSH, half, _PUSH_LINE, pulls=False)


def cart_size(cart_mass: float) -> tuple[float, float, float]:
    """Return the half-size of the drawn cart [m]: of one density, as wide and deep as M asks.

    Parameters
    ----------
    cart_mass
        M [kg]; the model's own cart is drawn at 1 kg.
    """
    grown = float(np.sqrt(np.clip(cart_mass, 0.05, 5.0)))
    return CART_HALF_SIZE[0] * grown, CART_HALF_SIZE[1] * grown, CART_HALF_SIZE[2]


def show_mass(scene: mujoco.MjvScene, cart: int, mass: float) -> None:
    """Give the drawn cart the size and the colour of its mass; the model keeps its own.

    Parameters
    ----------
    mass
        M [kg].
    """
    share = min(mass / HEAVY, 1.0)
    for geom in scene.geoms[: scene.ngeom]:
        if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM and geom.objid == cart:
            geom.size[:] = cart_size(mass)
            geom.rgba[:3] = np.array(LIGHT_CART) * (1.0 - share) + np.array(HEAVY_CART) * share


def _add(
    scene: mujoco.MjvScene,
    kind: mujoco.mjtGeom,
    size: Sequence[float],
    position: Sequence[float],
    colour: Colour,
    rotation: NDArray[np.float64] | None = None,
) -> mujoco.MjvGeom:
    """Add a geom that is drawn and belongs to no model."""
    if scene.ngeom >= scene.maxgeom:
        raise InvalidValueError("scene", f"must hold at most {scene.maxgeom} geoms")
    geom = scene.geoms[scene.ngeom]
    turned = np.eye(3) if rotation is None else rotation
    rgba = np.array(colour, dtype=np.float32)
    mujoco.mjv_initGeom(geom, kind, np.array(size), np.array(position), turned.ravel(), rgba)
    geom.category = mujoco.mjtCatBit.mjCAT_DECOR
    geom.objtype = mujoco.mjtObj.mjOBJ_UNKNOWN  # the place may have been a model geom's before
    geom.segid = geom.objid = scene.ngeom  # so that a segmentation tells them apart
    scene.ngeom += 1
    return geom


def _add_marks(scene: mujoco.MjvScene, places: Sequence[float]) -> None:
    """Draw the marks of the rail."""
    for x in places:
        long = round(x / BAR) % 2 == 0
        depth = 0.10 if long else 0.05
        _add(
            scene,
            mujoco.mjtGeom.mjGEOM_BOX,
            (0.012 if long else 0.008, depth, 0.004),
            (x, _BED_FRONT + depth, _BED_TOP + 0.004),
            MARK,
        )


def marks(path: CameraPath, index: int, spacing: float) -> list[float]:
    """Return the places of the marks that the camera sees [m].

    Parameters
    ----------
    spacing
        Between marks [m].
    """
    reach = path.distance * path.width / path.pixel_height * 0.3
    first, last = np.ceil((path.x[index] - reach) / spacing), (path.x[index] + reach) / spacing
    return [float(k * spacing) for k in np.arange(first, last)]


def add_shadow(scene: mujoco.MjvScene, replay: Replay, index: int) -> None:
    """Draw the shadow that a light straight above casts on the track."""
    z, phi = replay.state[index, :2].tolist()
    half = cart_size(float(replay.cart_mass[index]))
    box = mujoco.mjtGeom.mjGEOM_BOX
    _add(scene, box, (half[0], half[1], 0.001), (z, 0.0, _BED_TOP + 0.002), SHADOW)
    lean = -2.0 * float(replay.half_length[index] * np.sin(phi))
    if abs(lean) > half[0]:
        edge = float(np.copysign(half[0], lean))
        size = (0.5 * abs(lean - edge), POLE_RADIUS, 0.001)
        _add(scene, box, size, (z + 0.5 * (lean + edge), 0.0, _BED_TOP + 0.002), SHADOW)


def _add_ghost(
    scene: mujoco.MjvScene, state: NDArray[np.float64], mass: float, length: float
) -> None:
    """Draw the ideal ODE's cart-pole, a little larger and just behind: a rim where both agree."""
    z, phi = state[:2].tolist()
    half, rim = cart_size(mass), 0.018
    y = 2.0 * rim
    body, sphere = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_SPHERE
    along = np.array([-np.sin(phi), 0.0, np.cos(phi)])
    across = np.array([np.cos(phi), 0.0, np.sin(phi)])
    rotation = np.column_stack([across, [0.0, 1.0, 0.0], along])
    middle, tip = along * length, along * (2.0 * length)
    _add(scene, body, [x + rim for x in half], (z, y, -half[2]), GHOST)
    capsule = mujoco.mjtGeom.mjGEOM_CAPSULE
    size = (POLE_RADIUS + rim, length, 0.0)
    _add(scene, capsule, size, (z + middle[0], y, middle[2]), GHOST, rotation)
    _add(scene, sphere, (0.045,) * 3, (z + tip[0], y, tip[2]), GHOST)


def _add_arrow(
    scene: mujoco.MjvScene,
    z: float,
    force: float,
    colour: Colour,
    cart: float,
    height: float,
    *,
    pulls: bool,
) -> None:
    """Draw a force along the rail: a pull starts at the cart, a push ends there."""
    length = ARROW_SCALE * float(np.sqrt(abs(force)))
    if length < 0.03:
        return
    sign = float(np.sign(force))
    start = z + sign * cart if pulls else z - sign * (cart + length)
    geom = _add(scene, mujoco.mjtGeom.mjGEOM_ARROW, (1.0, 1.0, 1.0), (0.0, 0.0, 0.0), colour)
    mujoco.mjv_connector(
        geom,
        mujoco.mjtGeom.mjGEOM_ARROW,
        0.03,
        np.array([start, 0.0, height]),
        np.array([start + 2.0 * sign * length, 0.0, height]),  # MuJoCo draws it half as long
    )
