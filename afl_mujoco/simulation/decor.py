"""A plant as it is drawn: in its scene, with end stops, limits, and forces as arrows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.plants.cartpole import model_file
from afl_mujoco.plants.plant import Floats
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.mujoco_model import SimulatedModel, shown
from afl_mujoco.simulation.poses import Track, corners, drawn_geoms

ARROW, LONGEST = 0.07, 0.7
"""Length of an arrow over the square root of its force [1/sqrt(N)], and the most, as shares of the
extent of the model: 1 N is visible, and 100 N is the most that is told apart."""

LARGEST = (1920, 1080)
"""Largest picture [pixels]."""

Colour = tuple[float, float, float, float]
FORCE: Colour = (0.25, 0.85, 0.62, 1.0)
PUSH: Colour = (0.95, 0.45, 0.75, 1.0)
STOP: Colour = (0.84, 0.37, 0.0, 1.0)
LIMIT: Colour = (1.0, 0.69, 0.4, 1.0)


def drawn_model(scenario: Scenario, **settings: Any) -> SimulatedModel:
    """Return the model of a scenario's plant as it is drawn, and as `SimulatedModel` takes it.

    The cart-pole is in its scene; any other plant is what its MJCF says, and lit.
    """
    plant = scenario.plant
    if plant.model == model_file("cartpole.xml"):
        return SimulatedModel(shown(plant, "scene.xml"), **settings)
    return SimulatedModel(plant, edit=_lit, **settings)


def _lit(spec: mujoco.MjSpec) -> None:
    """Make room for the largest picture, and light what has no light of its own."""
    visual = spec.visual
    room = visual.global_
    room.offwidth = max(room.offwidth, LARGEST[0])
    room.offheight = max(room.offheight, LARGEST[1])
    if not spec.lights:
        visual.headlight.active = 1
        visual.headlight.ambient, visual.headlight.diffuse = [0.4] * 3, [0.5] * 3


def add_geom(
    scene: mujoco.MjvScene,
    kind: mujoco.mjtGeom,
    size: Sequence[float],
    position: Floats,
    colour: Colour,
    turned: Floats | None = None,
) -> mujoco.MjvGeom:
    """Add a geom that is drawn and belongs to no model."""
    if scene.ngeom >= scene.maxgeom:
        raise InvalidValueError("scene", f"must hold at most {scene.maxgeom} geoms")
    scene.ngeom += 1
    geom = scene.geoms[scene.ngeom - 1]
    turned = np.eye(3) if turned is None else turned
    rgba = np.array(colour, dtype=np.float32)
    mujoco.mjv_initGeom(geom, kind, np.array(size), position, turned.ravel(), rgba)
    geom.category = mujoco.mjtCatBit.mjCAT_DECOR
    geom.objtype = mujoco.mjtObj.mjOBJ_UNKNOWN  # a model geom may have had this slot before
    geom.segid = geom.objid = scene.ngeom - 1  # so that a segmentation tells them apart
    return geom


def add_tracks(
    scene: mujoco.MjvScene, model: SimulatedModel, tracks: Sequence[Track], state: Floats
) -> None:
    """Draw end stops and required limits of slides."""
    size, box = model.mj_model.stat.extent, mujoco.mjtGeom.mjGEOM_BOX
    for track in tracks:
        turned = np.column_stack([track.along, np.cross(track.across, track.along), track.across])
        tall = 0.05 * size if track.is_rail else 4.0 * size  # of what moves both ways, everywhere
        for words, place in track.places:
            edge = 0.0
            if words == "end stop":  # where what moves touches it
                reach = _reach(model, track, float(state[track.coordinate]), place)
                edge = math.copysign(1.0, place) * (reach + 0.015 * size)
            spot = track.at + (place + edge) * track.along + (0.05 * size) * track.across
            half, colour = (0.015 * size, STOP) if words == "end stop" else (0.004 * size, LIMIT)
            add_geom(scene, box, (half, 0.02 * size, tall), spot, colour, turned)


def _reach(model: SimulatedModel, track: Track, here: float, side: float) -> float:
    """Return how far what is on a slide, now here, goes beyond its place to one side [m]."""
    m, d, joint = model.mj_model, model.mj_data, track.coordinate
    own = [one for one in drawn_geoms(m) if m.geom_bodyid[one] == m.jnt_bodyid[joint]]
    beyond = (corners(m, d, own) - track.at) @ track.along - here
    return float((math.copysign(1.0, side) * beyond).max(initial=-math.inf)) if own else 0.0


def add_forces(
    scene: mujoco.MjvScene, model: SimulatedModel, inputs: Floats, channels: Floats
) -> None:
    """Draw what drives exert, which pulls, and what disturbs, which pushes; no torques.

    inputs, channels: What is exerted by each input, and of each channel of disturbances [N, N m].
    """
    ways = _ways(model)
    for forces, colour in ((inputs, FORCE), (channels, PUSH)):
        for way, force in zip(ways, forces.tolist(), strict=False):
            _add_arrow(scene, model, way, force, colour)


def _ways(model: SimulatedModel) -> list[tuple[int, Floats, Floats]]:
    """Return body, place [m] and direction of the force of each channel; 0 where it has none."""
    m, d, kind = model.mj_model, model.mj_data, mujoco.mjtTrn
    found: list[tuple[int, Floats, Floats]] = []

    def along(joint: int, gear: float) -> None:
        body, slides = m.jnt_bodyid[joint], m.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
        first = d.geom_xpos[m.body_geomadr[body]] if m.body_geomnum[body] else d.xpos[body]
        found.append((body, first.copy(), gear * slides * d.xaxis[joint]))

    for i in range(m.nu):
        one = int(m.actuator_trnid[i, 0])
        if m.actuator_trntype[i] == kind.mjTRN_SITE:
            turned = d.site_xmat[one].reshape(3, 3)
            way = m.actuator_gainprm[i, 0] * (turned @ m.actuator_gear[i, :3])
            found.append((0, d.site_xpos[one].copy(), way))
        else:
            along(one, m.actuator_gear[i, 0] * m.actuator_gainprm[i, 0])
    for joint in range(m.njnt):
        along(joint, 1.0)
    return found


def _add_arrow(
    scene: mujoco.MjvScene,
    model: SimulatedModel,
    way: tuple[int, Floats, Floats],
    force: float,
    colour: Colour,
) -> None:
    """Draw a force; what pulls begins where it acts, and what pushes ends there."""
    m, (body, place, along) = model.mj_model, way
    pull, size = force * along, m.stat.extent
    if (strength := float(np.linalg.norm(pull))) == 0.0:
        return
    length, ahead = size * min(ARROW * math.sqrt(strength), LONGEST), pull / strength
    edge = 0.0
    if body and m.body_geomnum[body]:  # at the side of the body, not within it
        geom = int(m.body_geomadr[body])
        turned = model.mj_data.geom_xmat[geom].reshape(3, 3)
        edge = float(np.abs(ahead @ turned) @ m.geom_aabb[geom, 3:])  # half its box
    start = place + edge * ahead if colour == FORCE else place - (edge + length) * ahead
    kind = mujoco.mjtGeom.mjGEOM_ARROW
    geom = add_geom(scene, kind, (1.0, 1.0, 1.0), np.zeros(3), colour)
    end = start + 2.0 * length * ahead  # MuJoCo draws it half as long
    mujoco.mjv_connector(geom, kind, 0.012 * size, start, end)
