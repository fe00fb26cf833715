"""What a frame shows, found in its segmentation, against closed-form geometry (Tier D)."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from afl_mujoco.films.scene import Frame, Stage
from tests.films.test_plants import segments

pytestmark = pytest.mark.slow

SIZE = (1280, 720)
BEFORE, AFTER = 5, 7  # frames on both sides of the step of l
NEAR = 2.0  # most by which what is seen may be off [px]


def projected(path, index, state, half_length):
    """Return where a tip must appear [px], by the paper's geometry and a pinhole of our own."""
    z, phi = state[:2]
    tip = np.array([z - 2.0 * half_length * np.sin(phi), 0.0, 2.0 * half_length * np.cos(phi)])
    slope, (tilt, turn) = np.tan(np.radians(15.0)), np.radians([path.elevation, path.azimuth])
    ahead = np.array([np.cos(turn) * np.cos(tilt), np.sin(turn) * np.cos(tilt), np.sin(tilt)])
    right = np.array([np.sin(turn), -np.cos(turn), 0.0])
    away = tip - path.aims[index]
    scale = 0.5 * SIZE[1] / slope / (path.distance + away @ ahead)
    up = np.cross(right, ahead)
    return 0.5 * np.array(SIZE) + scale * np.array([away @ right, -(away @ up)])


@pytest.fixture(scope="module")
def scene(replay):
    stage = Stage.of([replay], 30, SIZE, Frame())
    with mujoco.Renderer(stage.model.mj_model, *SIZE[::-1]) as renderer:
        yield stage, renderer, stage.paths[0]


@pytest.mark.parametrize("index", [0, BEFORE, AFTER, 12], ids=str)
def test_the_tip_is_seen_where_the_mathematics_puts_it(graphics, scene, replay, index):
    stage, _, path = scene
    expected = projected(path, index, replay.state[index], replay.values[index, 2])
    picture, site = segments(*scene[:2], replay, index, path), stage.model.mj_model.site("tip").id
    tip = (picture[..., 0] == site) & (picture[..., 1] == mujoco.mjtObj.mjOBJ_SITE)
    rows, columns = np.nonzero(tip)
    assert np.hypot(columns.mean() + 0.5 - expected[0], rows.mean() + 0.5 - expected[1]) < NEAR


@pytest.mark.parametrize("index", [BEFORE, AFTER], ids=str)
def test_the_ghost_is_where_the_ideal_tip_is_when_they_part(graphics, scene, replay, index):
    apart = replace(replay, ideal=replay.state + np.array([-0.8, 0.4, 0.0, 0.0]))
    _, renderer, path = scene
    picture = segments(*scene[:2], apart, index, path)
    capsule, unknown = mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtObj.mjOBJ_UNKNOWN
    shown = renderer.scene.geoms[: renderer.scene.ngeom]
    (ghost,) = (geom for geom in shown if (geom.type, geom.objtype) == (capsule, unknown))
    rows, columns = np.nonzero((picture[..., 0] == ghost.objid) & (picture[..., 1] == 0))
    expected = projected(path, index, apart.ideal[index], apart.values[index, 2])
    assert np.hypot(columns + 0.5 - expected[0], rows + 0.5 - expected[1]).min() < 10 * NEAR
    other = projected(path, index, apart.state[index], apart.values[index, 2])
    assert np.hypot(columns + 0.5 - other[0], rows + 0.5 - other[1]).min() > 10 * NEAR
