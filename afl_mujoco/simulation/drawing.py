"""A plant as it is drawn: its geoms along runs, for a page that replays, and its scene in films."""

from __future__ import annotations

import base64
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np
from scipy.ndimage import gaussian_filter1d

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.plants.cartpole import model_file
from afl_mujoco.plants.library import write_row
from afl_mujoco.plants.plant import Floats, Plant
from afl_mujoco.report.figures import colours
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.schedules import ForcePulse, Impulse
from afl_mujoco.simulation.mujoco_model import SimulatedModel, shown, write_state

FPS, MOST_NUMBERS = 30, 400_000
"""Frames per second, fewer where the poses of a scenario would be more numbers than this."""

CORNERS = np.array([*itertools.product((-1.0, 1.0), repeat=3)])

BOXED = tuple(getattr(mujoco.mjtGeom, f"mjGEOM_{x}") for x in ("PLANE", "MESH", "HFIELD", "SDF"))
"""Geoms that are drawn as boxes."""

SMOOTHING = 0.35
"""Standard deviation of the window over which a camera averages where a plant is [s]."""

FAR = 4.0  # a camera stands still as long as plants stay within this many times their own size
FLAT = 0.05  # motion is in a plane if it spreads less than this share as far across it
LOST = 50.0  # beyond this many times its own size from the camera's aim a plant is not kept in view
ROOM = 1.1  # size of a view over that of what it keeps in view
HIDDEN = 3  # the first of the groups of geoms that MuJoCo's viewer hides
PUSHED = 0.25  # how long an impulse is said at least [s]


class Track(NamedTuple):
    """A slide that is fixed in the world, for a reader who sees it from the side."""

    coordinate: int  # which it is
    at: Floats  # where it is 0 [m]: of a rail at the foot of what moves on it
    along: Floats  # its direction
    across: Floats  # from the foot up, both unit vectors
    is_rail: bool  # whether all that moves on it moves along it
    places: list[tuple[str, float]]  # end stops and limits, in words and where they are [m]


class Poses(NamedTuple):
    """Geoms in each frame: centres [m], rotations and sizes [m], and the points around all."""

    centres: Floats  # shape (N, geoms, 3)
    rotations: Floats  # shape (N, geoms, 3, 3)
    sizes: Floats  # shape (N, geoms, 3)
    around: Floats  # corners of what moves, shape (N, points, 3)


def drawn_geoms(m: mujoco.MjModel) -> list[int]:
    """Return the geoms that are seen."""
    return [int(one) for one in np.flatnonzero((m.geom_rgba[:, 3] > 0.0) & (m.geom_group < HIDDEN))]


def poses(model: SimulatedModel, geoms: Sequence[int], values: Floats, states: Floats) -> Poses:
    """Return poses with the parameters of each instant written into the model."""
    m, d, count = model.mj_model, model.mj_data, len(states)
    shapes, still, middles = shapes_of(m, geoms)
    moving = m.body_weldid[m.geom_bodyid[geoms]] > 0
    bodies = [] if moving.any() else np.flatnonzero(m.body_weldid).tolist()  # of what is not drawn
    centres, sizes = np.empty((count, len(geoms), 3)), np.empty((count, len(geoms), 3))
    rotations, middle = np.empty((count, len(geoms), 3, 3)), np.empty((count, len(bodies), 3))
    at, (rows, which) = model.addresses, model.course(values)
    for k, state in enumerate(states):
        write_row(at.structures, at.targets, rows[which[k]])
        write_state(at, state)
        mujoco.mj_kinematics(m, d)
        rotations[k], centres[k] = d.geom_xmat[geoms].reshape(-1, 3, 3), d.geom_xpos[geoms]
        sizes[k], middle[k] = m.geom_size[geoms], d.xipos[bodies]
    boxed = np.isin(m.geom_type[geoms], BOXED)  # whose sizes are not written
    sizes[:, boxed] = still[boxed]
    centres += np.einsum("ngij,gj->ngi", rotations, middles)
    seen = [shape for shape, moves in zip(shapes, moving, strict=True) if moves]
    around = corners(seen, sizes[:, moving], centres[:, moving], rotations[:, moving])
    return Poses(centres, rotations, sizes, np.concatenate([around, middle], axis=1))


def shapes_of(m: mujoco.MjModel, geoms: Sequence[int]) -> tuple[list[str], Floats, Floats]:
    """Return shapes of geoms, their sizes, and their middles in their frames; a mesh is its box."""
    kinds = [mujoco.mjtGeom(m.geom_type[one]) for one in geoms]
    sizes, middles = np.array(m.geom_size[geoms]), np.zeros((len(geoms), 3))
    for g, (one, kind) in enumerate(zip(geoms, kinds, strict=True)):
        if kind == mujoco.mjtGeom.mjGEOM_PLANE:  # without end where its size is 0
            sizes[g] = [*np.where(sizes[g, :2] > 0.0, sizes[g, :2], 1e3), 0.0]
        elif kind in BOXED:
            middles[g], sizes[g] = np.split(m.geom_aabb[one], 2)
    names = ["box" if k in BOXED else k.name.removeprefix("mjGEOM_").lower() for k in kinds]
    return names, sizes, middles


def corners(shapes: Sequence[str], sizes: Floats, centres: Floats, rotations: Floats) -> Floats:
    """Return the corners of the boxes around geoms [m], shape (..., 8 geoms, 3)."""
    half = np.array(sizes)
    for g, shape in enumerate(shapes):
        wide, long = sizes[..., g, 0], sizes[..., g, 1]
        tall = {"sphere": wide, "capsule": wide + long, "cylinder": long}.get(shape)
        if tall is not None:
            half[..., g, :] = np.stack([wide, wide, tall], axis=-1)
    spread = (half[..., None, :] * CORNERS) @ np.swapaxes(rotations, -1, -2)
    found: Floats = centres[..., None, :] + spread
    return found.reshape(*centres.shape[:-2], -1, 3)


def corners_now(m: mujoco.MjModel, d: mujoco.MjData, geoms: Sequence[int]) -> Floats:
    """Return the corners of the boxes around geoms as they are now [m], shape (8 geoms, 3)."""
    shapes, sizes, middles = shapes_of(m, geoms)
    rotations = d.geom_xmat[geoms].reshape(-1, 3, 3)
    centres = d.geom_xpos[geoms] + np.einsum("gij,gj->gi", rotations, middles)
    return corners(shapes, sizes, centres, rotations)


def follow(seen: Sequence[Floats], fps: float) -> tuple[list[Floats], bool, float]:
    """Return where a camera looks in each frame of each run, if it stands still, a plant's size.

    It looks at one point as long as plants stay about where they are, else at each of them.
    """
    everything = np.concatenate([points.reshape(-1, 3) for points in seen])
    own = max(float(np.ptp(points, axis=1).max()) for points in seen) or 1.0
    still = float(np.ptp(everything, axis=0).max()) <= FAR * own
    middle = 0.5 * (everything.min(axis=0) + everything.max(axis=0))
    aims = []
    for points in seen:
        centres = 0.5 * (points.min(axis=1) + points.max(axis=1))
        path = gaussian_filter1d(centres, SMOOTHING * fps, axis=0, mode="nearest")
        aims.append(np.broadcast_to(middle, path.shape) if still else path)
    return aims, still, own


def kept(seen: Sequence[Floats], aims: Sequence[Floats], own: float) -> Floats:
    """Return what has to be in view, relative to where the camera looks, shape (K, 3)."""
    parts = [(x - aim[:, None]).reshape(-1, 3) for x, aim in zip(seen, aims, strict=True)]
    around = np.concatenate(parts)
    near = (np.abs(around) < LOST * own).all(axis=1)
    return around[near] if near.any() else np.zeros((1, 3))


def plane_of(seen: Sequence[Floats]) -> Floats:
    """Return where right, up and towards the reader are, a row each: the plane of most motion.

    Right is x, or y where more moves along it, and up is z unless nothing moves along it.
    """
    spread = np.max([np.ptp(points, axis=0).max(axis=0) for points in seen], axis=0)
    x, y, z = np.eye(3)
    if spread[2] < FLAT * spread[:2].min():
        return np.array([x, y, z])
    return np.array([y, z, x]) if spread[1] > spread[0] else np.array([x, z, -y])


def replay_data(
    scenario: Scenario, runs: Mapping[str, tuple[Floats, Floats]], endings: Mapping[str, str]
) -> dict[str, Any]:
    """Return what a page replays, of instants [s] and states by controller, and endings."""
    model = SimulatedModel(scenario.plant)
    m, geoms = model.mj_model, drawn_geoms(model.mj_model)
    numbers = 9 * max(1, len(geoms)) * len(runs) * scenario.duration
    fps = min(FPS, MOST_NUMBERS / numbers)
    ends = {name: float(time[-1]) for name, (time, _) in runs.items()}  # the last instants
    times = {name: np.append(np.arange(0.0, end, 1.0 / fps), end) for name, end in ends.items()}
    found = {
        name: poses(model, geoms, scenario.values(at), between(*runs[name], at))
        for name, at in times.items()
    }
    seen = [one.around for one in found.values()]
    axes, (aims, still, own) = plane_of(seen), follow(seen, fps)
    longest = max(runs, key=lambda name: len(times[name]))
    lines = _lines(tracks(scenario, model, axes[2]), axes)
    around = kept(seen, aims, own) @ axes[:2].T
    low, high = around.min(axis=0), around.max(axis=0)
    if still:  # limits that are about as far as the motion are seen
        for x in [np.array(x["at"]) - axes[:2] @ aims[0][0] for x in lines]:
            if (x > low - own).all() and (x < high + own).all():
                low, high = np.minimum(low, x), np.maximum(high, x)
    shades, sizes = colours(runs), found[longest].sizes
    return {
        "fps": fps,
        "duration": scenario.duration,
        "shapes": shapes_of(m, geoms)[0],
        "moves": [bool(m.body_weldid[m.geom_bodyid[one]]) for one in geoms],
        "sizes": encode(sizes if np.ptp(sizes, axis=0).any() else sizes[:1]),
        "view": (ROOM * np.maximum(high - low, 0.2 * own)).tolist(),
        "lines": lines,
        "changes": [
            {"name": name, "unit": unit, "values": encode(x)}
            for name, unit, x in changing(scenario.plant, scenario.values(times[longest]))
        ],
        "pushes": [[*said_during(one)] for one in scenario.disturbances],
        "runs": [
            {
                "controller": name,
                "colour": shades[name],
                "ended": endings.get(name, ""),
                "frames": len(one.centres),
                "centres": encode(one.centres @ axes.T),
                "turns": encode(np.einsum("ij,ngjk->ngik", axes[:2], one.rotations)),
                "aims": encode(aim @ axes[:2].T + 0.5 * (low + high)),
            }
            for (name, one), aim in zip(found.items(), aims, strict=True)
        ],
    }


def said_during(one: ForcePulse | Impulse) -> tuple[float, float]:
    """Return when a disturbance is said to begin and to end [s]: after `PUSHED` at least."""
    start = min(one.breakpoints)
    return start, max(*one.breakpoints, start + PUSHED)


def between(time: Floats, states: Floats, times: Floats) -> Floats:
    """Return the states at some times, interpolated linearly, shape (N, 2 n)."""
    known = np.isfinite(states).all(axis=1)
    return np.column_stack([np.interp(times, time[known], x) for x in states[known].T])


def changing(plant: Plant, values: Floats) -> list[tuple[str, str, Floats]]:
    """Return name, unit and course, shape (N,), of each parameter that changes."""
    columns = zip(plant.parameters, values.T, strict=True)
    return [(name, plant.units[name], x) for name, x in columns if np.ptp(x) > 0.0]


def tracks(scenario: Scenario, model: SimulatedModel, toward: Floats) -> list[Track]:
    """Return the slides that are fixed in the world, as one sees them who looks from a direction.

    toward: Where the reader is, a unit vector.
    """
    m, d, plant = model.mj_model, mujoco.MjData(model.mj_model), scenario.plant
    mujoco.mj_kinematics(m, d)
    stops, geoms = scenario.imperfections.end_stops, drawn_geoms(m)
    found = []
    for k, name in enumerate(plant.coordinates):
        body = int(m.jnt_bodyid[k])
        above = m.jnt_type[m.body_jntadr[body] : k + 1]  # its own joints down to this one
        if (above != mujoco.mjtJoint.mjJNT_SLIDE).any() or m.body_weldid[m.body_parentid[body]]:
            continue
        along, at = d.xaxis[k].copy(), d.xanchor[k].copy()
        across = np.cross(toward, along)
        if (wide := float(np.linalg.norm(across))) < 0.5:  # it slides towards the reader
            continue
        across /= math.copysign(wide, across[2] or 1.0)  # up, if it is not the slide that goes up
        around = corners_now(m, d, [one for one in geoms if m.geom_bodyid[one] == body]) - at
        is_rail = len(around) > 0 and m.body_jntnum[body] == 1
        if is_rail:
            at += float((around @ across).min()) * across
        at -= m.qpos0[m.jnt_qposadr[k]] * along  # the model's own pose need not be at 0
        places = [("end stop", side * stops[name]) for side in (-1.0, 1.0) if name in stops]
        places += [("limit", limit) for limit in scenario.required_of(name)]
        found.append(Track(k, at, along, across, is_rail, places))
    return found


def _lines(found: Sequence[Track], axes: Floats) -> list[dict[str, Any]]:
    """Return rails, end stops and limits as lines through a point, in the plane that is seen."""
    flat, lines = axes[:2], []
    for one in found:
        at, along, across = flat @ one.at, flat @ one.along, flat @ one.across
        lines += [("", at, along)] if one.is_rail else []
        lines += [(words, at + place * along, across) for words, place in one.places]
    return [{"words": words, "at": x.tolist(), "along": y.tolist()} for words, x, y in lines]


def encode(values: Floats) -> str:
    """Return values as little-endian 32-bit floats in base64."""
    return base64.b64encode(values.astype("<f4").tobytes()).decode()


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
            edge, high = 0.0, tall
            if words == "limit" and track.is_rail:  # a mark, not a wall
                high *= 0.7
            if words == "end stop":  # where what moves touches it
                reach = _reach(model, track, float(state[track.coordinate]), place)
                edge = math.copysign(1.0, place) * (reach + 0.015 * size)
            spot = track.at + (place + edge) * track.along + min(high, 0.05 * size) * track.across
            half, colour = (0.015 * size, STOP) if words == "end stop" else (0.004 * size, LIMIT)
            add_geom(scene, box, (half, 0.02 * size, high), spot, colour, turned)


def _reach(model: SimulatedModel, track: Track, here: float, side: float) -> float:
    """Return how far what is on a slide, now here, goes beyond its place to one side [m]."""
    m, d, joint = model.mj_model, model.mj_data, track.coordinate
    own = [one for one in drawn_geoms(m) if m.geom_bodyid[one] == m.jnt_bodyid[joint]]
    beyond = (corners_now(m, d, own) - track.at) @ track.along - here
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
    """Return geom, place [m] and direction of the force of each channel; 0 where it has none.

    The geom is the first that a joint moves, or -1.
    """
    m, d, kind = model.mj_model, model.mj_data, mujoco.mjtTrn
    found: list[tuple[int, Floats, Floats]] = []

    def along(joint: int, gear: float) -> None:
        body, slides = m.jnt_bodyid[joint], m.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
        moved = (i for i in range(m.ngeom) if body in _with_all_above(m, int(m.geom_bodyid[i])))
        first = next(moved, -1)
        place = d.xpos[body] if first < 0 else d.geom_xpos[first]
        found.append((first, place.copy(), gear * slides * d.xaxis[joint]))

    for i in range(m.nu):
        one = int(m.actuator_trnid[i, 0])
        if m.actuator_trntype[i] == kind.mjTRN_SITE:
            turned = d.site_xmat[one].reshape(3, 3)
            way = m.actuator_gainprm[i, 0] * (turned @ m.actuator_gear[i, :3])
            found.append((-1, d.site_xpos[one].copy(), way))
        else:
            along(one, m.actuator_gear[i, 0] * m.actuator_gainprm[i, 0])
    for joint in range(m.njnt):
        along(joint, 1.0)
    return found


def _with_all_above(m: mujoco.MjModel, body: int) -> Iterator[int]:
    """Yield a body and those that it is in, but not the world."""
    while body:
        yield body
        body = int(m.body_parentid[body])


def _add_arrow(
    scene: mujoco.MjvScene,
    model: SimulatedModel,
    way: tuple[int, Floats, Floats],
    force: float,
    colour: Colour,
) -> None:
    """Draw a force; what pulls begins where it acts, and what pushes ends there."""
    m, (first, place, along) = model.mj_model, way
    pull, size = force * along, m.stat.extent
    if (strength := float(np.linalg.norm(pull))) == 0.0:
        return
    length, ahead = size * min(ARROW * math.sqrt(strength), LONGEST), pull / strength
    edge = 0.0
    if first >= 0:  # at its side, not within it
        turned = model.mj_data.geom_xmat[first].reshape(3, 3)
        edge = float(np.abs(ahead @ turned) @ m.geom_aabb[first, 3:])  # half its box
    start = place + edge * ahead if colour == FORCE else place - (edge + length) * ahead
    kind = mujoco.mjtGeom.mjGEOM_ARROW
    geom = add_geom(scene, kind, (1.0, 1.0, 1.0), np.zeros(3), colour)
    end = start + 2.0 * length * ahead  # MuJoCo draws it half as long
    mujoco.mjv_connector(geom, kind, 0.012 * size, start, end)
