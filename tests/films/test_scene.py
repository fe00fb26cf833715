"""What a frame shows, found in its segmentation, against closed-form geometry (Tier D)."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from afl_mujoco.films.camera import Frame
from afl_mujoco.films.scene import Stage
from tests.films.test_plants import segments

pytestmark = pytest.mark.slow

SIZE = (1280, 720)
BEFORE, AFTER = 5, 7
"""Frames on both sides of the step of l."""

NEAR = 2.0
"""Most by which what is seen may be off [px]."""


def seen_at(path, index, x, z, y=0.0):
    """Return where a point must appear [px], by a pinhole of our own."""
    slope, (tilt, turn) = np.tan(np.radians(15.0)), np.radians([path.elevation, path.azimuth])
    ahead = np.array([np.cos(turn) * np.cos(tilt), np.sin(turn) * np.cos(tilt), np.sin(tilt)])
    right = np.array([np.sin(turn), -np.cos(turn), 0.0])
    away = np.array([x, y, z]) - path.aims[index]
    scale = 0.5 * SIZE[1] / slope / (path.distance + away @ ahead)
    up = np.cross(right, ahead)
    return 0.5 * np.array(SIZE) + scale * np.array([away @ right, -(away @ up)])


def projected(path, index, state, half_length):
    """Return where a tip must appear [px], by the paper's geometry."""
    z, phi = state[:2]
    reach = 2.0 * half_length
    return seen_at(path, index, z - reach * np.sin(phi), reach * np.cos(phi))


def drawn(renderer, kind):
    whole = renderer.scene
    return [geom for geom in whole.geoms[: whole.ngeom] if geom.type == kind]


def seen_tip(stage, picture):
    site = stage.model.mj_model.site("tip").id
    kind = mujoco.mjtObj.mjOBJ_SITE
    rows, columns = np.nonzero((picture[..., 0] == site) & (picture[..., 1] == kind))
    assert len(rows), "nothing of it is seen"
    return np.array([columns.mean() + 0.5, rows.mean() + 0.5])


@pytest.fixture(scope="module")
def scene(replay):
    stage = Stage.of([replay], 30, SIZE, Frame())
    with mujoco.Renderer(stage.model.mj_model, *SIZE[::-1]) as renderer:
        yield stage, renderer, stage.paths[0]


@pytest.mark.parametrize("index", [0, BEFORE, AFTER, 12], ids=str)
def test_the_tip_is_seen_where_the_mathematics_puts_it(graphics, scene, replay, index):
    stage, _, path = scene
    expected = projected(path, index, replay.state[index], replay.values[index, 2])
    seen = seen_tip(stage, segments(*scene[:2], replay, index, path))
    assert np.abs(seen - expected).max() < NEAR


@pytest.mark.parametrize("index", [BEFORE, AFTER], ids=str)
def test_the_ghost_is_where_the_ideal_tip_is_when_they_part(graphics, scene, apart, index):
    _, renderer, path = scene
    picture = segments(*scene[:2], apart, index, path)
    capsules, unknown = drawn(renderer, mujoco.mjtGeom.mjGEOM_CAPSULE), mujoco.mjtObj.mjOBJ_UNKNOWN
    (ghost,) = (geom for geom in capsules if geom.objtype == unknown)
    rows, columns = np.nonzero((picture[..., 0] == ghost.objid) & (picture[..., 1] == 0))
    expected = projected(path, index, apart.ideal[index], apart.values[index, 2])
    assert np.hypot(columns + 0.5 - expected[0], rows + 0.5 - expected[1]).min() < 10 * NEAR
    other = projected(path, index, apart.state[index], apart.values[index, 2])
    assert np.hypot(columns + 0.5 - other[0], rows + 0.5 - other[1]).min() > 10 * NEAR


def test_a_ghost_that_agrees_is_a_rim(graphics, scene, replay):
    stage, renderer, path = scene
    twin = replace(replay, ideal=replay.state)
    picture = stage.draw(renderer, twin, AFTER, path)
    alone = stage.draw(renderer, replace(replay, ideal=None), AFTER, path)
    seen = np.abs(picture.astype(int) - alone).max(axis=2) > 30
    picture, model = segments(*scene[:2], twin, AFTER, path), stage.model.mj_model
    parts = np.isin(picture[..., 0], [model.geom(name).id for name in ("cart", "pole")])
    plant = parts & (picture[..., 1] == mujoco.mjtObj.mjOBJ_GEOM)
    assert 0.1 * plant.sum() < (seen & ~plant).sum() < plant.sum()  # around it
    assert (seen & plant).sum() < 0.05 * plant.sum()  # not over it, but for its smoothed edge


def test_the_cart_grows(graphics, scene, replay):
    stage, _, path = scene
    cart = stage.model.mj_model.geom("cart").id
    widths = []
    for index in (BEFORE, AFTER):
        picture = segments(*scene[:2], replay, index, path)
        mask = (picture[..., 0] == cart) & (picture[..., 1] == mujoco.mjtObj.mjOBJ_GEOM)
        widths.append(np.ptp(np.nonzero(mask)[1]))
    assert widths[1] / widths[0] == pytest.approx(1.25 / 0.875, rel=0.05)  # 0.5 to 2 kg


def test_the_arrows_point_along_the_forces_and_drawing_leaves_no_trace(graphics, scene, replay):
    stage, renderer, path = scene
    pushed = 10
    assert replay.channels[pushed, 0] == -10.0
    for index, arrows in ((0, 1), (pushed, 2)):
        stage.draw(renderer, replay, index, path)
        found = drawn(renderer, mujoco.mjtGeom.mjGEOM_ARROW)
        assert len(found) == arrows
        along = [float(np.asarray(geom.mat).reshape(3, 3)[0, 2]) for geom in found]
        wanted = [replay.inputs[index, 0], replay.channels[index, 0]][:arrows]
        np.testing.assert_allclose(along, np.sign(wanted), atol=1e-6)
    stage.draw(renderer, replay, AFTER, path)
    again = stage.draw(renderer, replay, BEFORE, path)
    fresh = Stage.of([replay], 30, SIZE, Frame()).draw(renderer, replay, BEFORE, path)
    np.testing.assert_array_equal(fresh, again)
