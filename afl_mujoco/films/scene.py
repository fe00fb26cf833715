"""The scene of a film: MuJoCo's cart-pole, mutated frame by frame, and its overlays."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.films.camera import ELEVATION, CameraPath
from afl_mujoco.films.overlays import add_overlays, add_shadow, marks
from afl_mujoco.films.replay import Replay
from afl_mujoco.scenario.parameters import CartPoleParameters
from afl_mujoco.simulation.decor import BAR, show_mass
from afl_mujoco.simulation.mujoco_model import CartPoleModel, write_state

LARGEST = (1920, 1080)
"""Largest picture (width, height) [px]: the off-screen buffer of ``models/scene.xml``."""

SMALLEST = 128
"""Smallest side of a picture [px]."""


@dataclass(frozen=True, slots=True)
class Scene:
    """A scene that can be drawn.

    Attributes
    ----------
    model
        The cart-pole, mutated to each frame's M and l.
    renderer
        MuJoCo's renderer, which draws it.
    """

    model: CartPoleModel
    renderer: mujoco.Renderer

    def draw(self, replay: Replay, index: int, path: CameraPath) -> NDArray[np.uint8]:
        """Return a frame, shape (height, width, 3)."""
        self.place(replay, index, path)
        picture: NDArray[np.uint8] = self.renderer.render()
        return picture

    def place(self, replay: Replay, index: int, path: CameraPath) -> None:
        """Move everything to a frame; arguments as for `draw`."""
        pose(self.model, replay, index)
        self.renderer.update_scene(self.model.mj_data, _camera(path, index))
        scene = self.renderer.scene
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_SKYBOX):
            scene.flags[flag] = False
        show_mass(scene, self.model.mj_model.geom("cart").id, replay.drawn_mass(index))
        add_shadow(scene, replay, index)
        add_overlays(scene, replay, index, marks(path, index, BAR))


def pose(model: CartPoleModel, replay: Replay, index: int) -> None:
    """Mutate the model to a frame's M and l, and move it to the frame's state."""
    model.set_parameters(_plant(replay, index))
    write_state(model.addresses, *replay.state[index].tolist())
    mujoco.mj_forward(model.mj_model, model.mj_data)


def require_size(width: int, height: int) -> None:
    """Raise unless a film can have this size.

    Parameters
    ----------
    width, height
        Size of the picture [px].
    """
    for thing, side, largest in zip(("width", "height"), (width, height), LARGEST, strict=True):
        if not SMALLEST <= side <= largest:
            rule = f"must lie between {SMALLEST} and {largest} pixels, the off-screen buffer"
            raise InvalidValueError(f"film {thing}", rule, side)
        if side % 2:
            raise InvalidValueError(f"film {thing}", "must be even, for H.264", side)


@contextmanager
def open_scene(replay: Replay, width: int, height: int) -> Iterator[Scene]:
    """Yield a scene, and free its renderer afterwards.

    Parameters
    ----------
    width, height
        Size of the picture [px].
    """
    model = CartPoleModel(_plant(replay, 0), file="scene.xml")
    with mujoco.Renderer(model.mj_model, height, width) as renderer:
        yield Scene(model, renderer)


def _plant(replay: Replay, index: int) -> CartPoleParameters:
    """Return the plant of a frame."""
    return CartPoleParameters(
        cart_mass=float(replay.cart_mass[index]),
        pole_mass=replay.pole_mass,
        half_length=float(replay.half_length[index]),
        gravity=replay.gravity,
    )


def _camera(path: CameraPath, index: int) -> mujoco.MjvCamera:
    """Return MuJoCo's camera for a frame."""
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.lookat[:] = path.x[index], 0.0, path.height
    camera.distance, camera.azimuth, camera.elevation = path.distance, 90.0, ELEVATION
    return camera
