"""Plants as they are drawn, and overlays: the mass of the cart, forces, the marks of the rail."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.plants.cartpole import CART_HALF_SIZE
from afl_mujoco.plants.plant import Floats
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.mujoco_model import SimulatedModel, shown

ARROW_SCALE = 0.2
"""Length of an arrow [m] over the square root of its force [N]: 1 N is visible, 100 N fits."""

BAR = 0.5  # spacing of the marks along the rail [m]; every second one is longer and has a number
NEAR = 20.0  # how far from the cart marks are drawn where the view of the camera is not known [m]
LARGEST = (1920, 1080)  # largest picture [pixels]

Colour = tuple[float, float, float, float]
FORCE: Colour = (0.25, 0.85, 0.62, 1.0)
PUSH: Colour = (0.95, 0.45, 0.75, 1.0)
MARK: Colour = (0.62, 0.66, 0.72, 1.0)
STOP: Colour = (0.84, 0.37, 0.0, 1.0)
STOP_SIZE = (0.03, 0.12, 0.12)
"""Half-size of an end stop [m]: it stands on the track and is lower than the cart."""

LIGHT_CART, HEAVY_CART = (0.55, 0.78, 0.98), (0.10, 0.27, 0.62)
HEAVY = 2.0  # cart mass from which the cart has the darkest blue [kg]
BED_TOP, BED_FRONT = -0.30, -0.70  # height and front edge of the track [m]

_FORCE_LINE, _PUSH_LINE = -0.15, -0.03


def drawn_model(scenario: Scenario, **settings: Any) -> SimulatedModel:
    """Return the model of a plant as it is drawn: the cart-pole in its scene, others lit."""
    if scenario.is_cart_pole:
        return SimulatedModel(shown(scenario.plant, "scene.xml"), **settings)
    return SimulatedModel(scenario.plant, edit=_lit, **settings)


def _lit(spec: mujoco.MjSpec) -> None:
    """Make room for the largest picture, and light what has no light of its own."""
    visual = spec.visual
    room = visual.global_
    room.offwidth = max(room.offwidth, LARGEST[0])
    room.offheight = max(room.offheight, LARGEST[1])
    if not spec.lights:
        visual.headlight.active = 1
        visual.headlight.ambient, visual.headlight.diffuse = [0.4] * 3, [0.5] * 3


def cart_size(cart_mass: float) -> tuple[float, float, float]:
    """Return the half-size of the drawn cart [m]: width and depth grow with M at one density."""
    grown = float(np.sqrt(np.clip(cart_mass, 0.05, 5.0)))
    return CART_HALF_SIZE[0] * grown, CART_HALF_SIZE[1] * grown, CART_HALF_SIZE[2]


def show_mass(scene: mujoco.MjvScene, cart: int, mass: float) -> None:
    """Draw the cart in the size and colour of its mass [kg]; the model does not change."""
    share = min(mass / HEAVY, 1.0)
    for geom in scene.geoms[: scene.ngeom]:
        if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM and geom.objid == cart:
            geom.size[:] = cart_size(mass)
            geom.rgba[:3] = np.array(LIGHT_CART) * (1.0 - share) + np.array(HEAVY_CART) * share


def add_geom(
    scene: mujoco.MjvScene,
    kind: mujoco.mjtGeom,
    size: Sequence[float],
    position: Sequence[float],
    colour: Colour,
    rotation: Floats | None = None,
) -> mujoco.MjvGeom:
    """Add a geom that is drawn and belongs to no model."""
    if scene.ngeom >= scene.maxgeom:
        raise InvalidValueError("scene", f"must hold at most {scene.maxgeom} geoms")
    scene.ngeom += 1
    geom = scene.geoms[scene.ngeom - 1]
    turned = np.eye(3) if rotation is None else rotation
    rgba = np.array(colour, dtype=np.float32)
    mujoco.mjv_initGeom(geom, kind, np.array(size), np.array(position), turned.ravel(), rgba)
    geom.category = mujoco.mjtCatBit.mjCAT_DECOR
    geom.objtype = mujoco.mjtObj.mjOBJ_UNKNOWN  # a model geom may have had this slot before
    geom.segid = geom.objid = scene.ngeom - 1  # so that a segmentation tells them apart
    return geom


def add_marks(scene: mujoco.MjvScene, places: Sequence[float], *, numbered: bool = False) -> None:
    """Draw the marks of the rail; if `numbered`, MuJoCo labels the long ones with positions [m]."""
    for x in places:
        long = round(x / BAR) % 2 == 0
        depth = 0.10 if long else 0.05
        size, place = (
            (0.012 if long else 0.008, depth, 0.004),
            (x, BED_FRONT + depth, BED_TOP + 0.004),
        )
        geom = add_geom(scene, mujoco.mjtGeom.mjGEOM_BOX, size, place, MARK)
        if numbered and long:
            geom.label = f"{x:g} m"


def add_stops(scene: mujoco.MjvScene, end: float | None, cart_mass: float) -> None:
    """Draw the end stops where the drawn cart touches them; none if the rail has no end."""
    if end is None:
        return
    half, box = cart_size(cart_mass), mujoco.mjtGeom.mjGEOM_BOX
    for side in (-1.0, 1.0):
        x = side * (end + half[0] + STOP_SIZE[0])
        add_geom(scene, box, STOP_SIZE, (x, 0.0, BED_TOP + STOP_SIZE[2]), STOP)


def marks_near(z: float) -> list[float]:
    """Return the positions of the marks within `NEAR` of a cart [m]."""
    return [BAR * k for k in range(math.ceil((z - NEAR) / BAR), math.floor((z + NEAR) / BAR) + 1)]


def add_forces(
    scene: mujoco.MjvScene, z: float, cart_mass: float, force: float, push: float
) -> None:
    """Draw the forces on the cart [N]: the actuator pulls it, the disturbance pushes it."""
    half, arrow = cart_size(cart_mass)[0], mujoco.mjtGeom.mjGEOM_ARROW
    for newtons, colour, height in ((force, FORCE, _FORCE_LINE), (push, PUSH, _PUSH_LINE)):
        length, sign = ARROW_SCALE * float(np.sqrt(abs(newtons))), float(np.sign(newtons))
        if length < 0.03:
            continue
        # a pull starts at the cart, a push ends there
        start = z + sign * half if colour == FORCE else z - sign * (half + length)
        end = start + 2.0 * sign * length  # MuJoCo draws it half as long
        geom = add_geom(scene, arrow, (1.0, 1.0, 1.0), (0.0, 0.0, 0.0), colour)
        places = (np.array([x, 0.0, height]) for x in (start, end))
        mujoco.mjv_connector(geom, arrow, 0.03, *places)
