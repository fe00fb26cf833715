"""A plant in MuJoCo, mutated frame by frame, with its overlays, off screen or in the viewer."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from afl_mujoco.errors import GraphicsError, InvalidValueError
from afl_mujoco.films.camera import ELEVATION, CameraPath, Frame, follow
from afl_mujoco.films.replay import Replay
from afl_mujoco.films.standpoint import Standpoint, watch
from afl_mujoco.simulation.decor import (
    BAR,
    BED_TOP,
    LARGEST,
    Colour,
    add_forces,
    add_geom,
    add_marks,
    add_stops,
    cart_size,
    drawn_model,
    show_mass,
)
from afl_mujoco.simulation.mujoco_model import SimulatedModel, write_state

SMALLEST = 128
"""Smallest side of a picture [px]."""

POLE_RADIUS = 0.02
"""Radius of the drawn pole [m]."""

GHOST: Colour = (0.75, 0.90, 1.0, 0.45)
SHADOW: Colour = (0.02, 0.02, 0.04, 0.55)
RIM = 0.018  # how much larger the ghost is [m]

BEHIND = 0.03
"""How far behind another plant its ghost is, as a share of the extent of the model."""

VIEW_DISTANCE, VIEW_MARKS, VIEW_PAUSE = 7.5, 40, 1.5
"""Viewer: distance of the camera [m], marks on each side, and pause before a repetition [s]."""


@dataclass(frozen=True, slots=True)
class Scene:
    """A model that is mutated to the parameters of each frame, and the renderer that draws it."""

    model: SimulatedModel
    renderer: mujoco.Renderer
    ghost: mujoco.MjData  # where the ghost is, of another plant than the cart-pole

    def paths(
        self, replays: Sequence[Replay], fps: int, size: tuple[int, int], frame: Frame
    ) -> list[CameraPath | Standpoint]:
        """Return where the camera is in each run."""
        if replays[0].plan.is_cart_pole:
            return [follow(replay, fps, size, frame) for replay in replays]
        return [*watch(self.model, replays, fps, size, frame)]

    def draw(self, replay: Replay, index: int, path: CameraPath | Standpoint) -> NDArray[np.uint8]:
        """Move everything to a frame and return it, shape (height, width, 3)."""
        pose(self.model, replay, index)
        if isinstance(path, Standpoint):
            self.renderer.update_scene(self.model.mj_data, path.camera(index))
        else:
            camera = mujoco.MjvCamera()
            camera.type = mujoco.mjtCamera.mjCAMERA_FREE
            camera.lookat[:] = path.x[index], 0.0, path.height
            camera.distance, camera.azimuth, camera.elevation = path.distance, 90.0, ELEVATION
            self.renderer.update_scene(self.model.mj_data, camera)
        scene = self.renderer.scene
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_SKYBOX):
            scene.flags[flag] = False
        if isinstance(path, Standpoint):
            haunt(scene, self.model, self.ghost, replay, index)
        else:
            mass = float(replay.cart_mass[index])
            show_mass(scene, self.model.mj_model.geom("cart").id, mass)
            _add_shadow(scene, replay, index)
            add_overlays(scene, replay, index, path.seen(index, BAR), mass)
        return np.asarray(self.renderer.render())


def pose(model: SimulatedModel, replay: Replay, index: int) -> None:
    """Mutate the model to the parameters of a frame, and move it to the frame's state."""
    model.write(replay.values[index])
    write_state(model.addresses, replay.state[index])
    mujoco.mj_forward(model.mj_model, model.mj_data)


def haunt(
    scene: mujoco.MjvScene,
    model: SimulatedModel,
    ghost: mujoco.MjData,
    replay: Replay,
    index: int,
) -> None:
    """Draw the plant of the ideal loop, pale and just behind, if there is one."""
    if replay.ideal is None:
        return
    m, first = model.mj_model, scene.ngeom
    ghost.qpos[:] = replay.ideal[index, : m.nq]
    mujoco.mj_kinematics(m, ghost)
    option, perturb = mujoco.MjvOption(), mujoco.MjvPerturb()
    moving = int(mujoco.mjtCatBit.mjCAT_DYNAMIC)
    mujoco.mjv_addGeoms(m, ghost, option, perturb, moving, scene)
    away = BEHIND * m.stat.extent * np.array(scene.camera[0].forward)
    for geom in scene.geoms[first : scene.ngeom]:
        geom.rgba[:] = GHOST
        geom.matid = -1
        geom.pos[:] += away


def require_size(size: tuple[int, int]) -> None:
    """Raise unless a film can have this size."""
    for thing, side, largest in zip(("width", "height"), size, LARGEST, strict=True):
        if not SMALLEST <= side <= largest:
            rule = f"must lie between {SMALLEST} and {largest} pixels, the off-screen buffer"
            raise InvalidValueError(f"film {thing}", rule, side)
        if side % 2:
            raise InvalidValueError(f"film {thing}", "must be even, for H.264", side)


@contextmanager
def open_scene(replay: Replay, size: tuple[int, int]) -> Iterator[Scene]:
    """Yield a scene, and free its renderer afterwards."""
    model = drawn_model(replay.plan)
    with mujoco.Renderer(model.mj_model, size[1], size[0]) as renderer:
        yield Scene(model, renderer, mujoco.MjData(model.mj_model))


def add_overlays(
    scene: mujoco.MjvScene, replay: Replay, index: int, marks: Iterable[float], mass: float
) -> None:
    """Add marks of the rail, end stops, ghost and forces to a cart drawn as one of this mass."""
    assert replay.ideal is not None  # a cart-pole has equations
    z = float(replay.state[index, 0])
    add_marks(scene, list(marks))
    add_stops(scene, replay.plan.rail, mass)
    _add_ghost(scene, replay.ideal[index], mass, float(replay.half_length[index]))
    add_forces(scene, z, mass, float(replay.force[index]), float(replay.push[index]))


def _add_shadow(scene: mujoco.MjvScene, replay: Replay, index: int) -> None:
    """Draw the shadow that a light from straight above casts on the track."""
    z, phi = replay.state[index, :2].tolist()
    half = cart_size(float(replay.cart_mass[index]))
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
    hinge = np.array([z, 2.0 * RIM, 0.0])
    along = np.array([-np.sin(phi), 0.0, np.cos(phi)])
    across = np.array([np.cos(phi), 0.0, np.sin(phi)])
    rotation = np.column_stack([across, [0.0, 1.0, 0.0], along])
    half, kind = cart_size(mass), mujoco.mjtGeom
    below = hinge - np.array([0.0, 0.0, half[2]])
    add_geom(scene, kind.mjGEOM_BOX, [x + RIM for x in half], below.tolist(), GHOST)
    middle, tip = (hinge + along * length).tolist(), (hinge + along * (2.0 * length)).tolist()
    size = (POLE_RADIUS + RIM, length, 0.0)
    add_geom(scene, kind.mjGEOM_CAPSULE, size, middle, GHOST, rotation)
    add_geom(scene, kind.mjGEOM_SPHERE, (0.045,) * 3, tip, GHOST)


def view(replay: Replay, speed: float) -> None:
    """Show a run in MuJoCo's viewer, over and over, until its window is closed."""
    import mujoco.viewer  # needs a window system, which films do without

    model = drawn_model(replay.plan)
    ghost = mujoco.MjData(model.mj_model)
    try:
        handle = mujoco.viewer.launch_passive(
            model.mj_model, model.mj_data, show_left_ui=False, show_right_ui=False
        )
    except (RuntimeError, mujoco.FatalError) as error:
        raise GraphicsError("view", f"needs a display: {error}") from None
    with handle as viewer:
        if replay.plan.is_cart_pole:  # of another plant as its MJCF says
            with viewer.lock():
                viewer.cam.lookat[:] = 0.0, 0.0, 0.6
                viewer.cam.distance, viewer.cam.azimuth = VIEW_DISTANCE, 90.0
                viewer.cam.elevation = ELEVATION
        start = time.monotonic()
        while viewer.is_running():
            elapsed = (time.monotonic() - start) * speed
            if elapsed > replay.time[-1] + VIEW_PAUSE * speed:
                start = time.monotonic()
            index = min(int(np.searchsorted(replay.time, elapsed)), len(replay.time) - 1)
            _show(viewer, model, ghost, replay, index)
            time.sleep(1.0 / 60.0)


def _show(
    viewer: mujoco.viewer.Handle,
    model: SimulatedModel,
    ghost: mujoco.MjData,
    replay: Replay,
    index: int,
) -> None:
    """Show a frame; the camera moves along with a cart."""
    with viewer.lock():
        before = float(model.mj_data.qpos[0])
        pose(model, replay, index)
        viewer.user_scn.ngeom = 0
        if replay.plan.is_cart_pole:
            viewer.cam.lookat[0] += float(replay.state[index, 0]) - before
            marks = BAR * np.arange(-VIEW_MARKS, VIEW_MARKS + 1)
            add_overlays(viewer.user_scn, replay, index, marks, mass=1.0)  # as the model is drawn
        else:
            haunt(viewer.user_scn, model, ghost, replay, index)
    labels, values = zip(*replay.readouts(index), strict=True)
    lines = (f"{replay.scenario}, {replay.controller}", *labels, replay.ended(index))
    left = "\n".join(lines).replace("φ", "phi").replace("Δ", "d")  # its font has no Greek
    viewer.set_texts((None, None, left, "\n".join(("", *values))))
    viewer.sync()
