"""What a frame shows, found in its segmentation, against closed-form geometry (Tier D)."""

import mujoco
import numpy as np
import pytest

from afl_mujoco.films.camera import Frame, follow
from afl_mujoco.films.scene import open_scene

pytestmark = pytest.mark.slow

SIZE = (1280, 720)
BEFORE, AFTER = 5, 7
"""Frames on both sides of the step of l."""

NEAR = 2.0
"""Most by which what is seen may be off [px]."""


def projected(path, index, state, half_length):
    """Return where a tip must appear [px], by the paper's geometry and a pinhole of our own."""
    z, phi = state[:2]
    x, height = z - 2.0 * half_length * np.sin(phi), 2.0 * half_length * np.cos(phi)
    return path.project(index, np.array([x]), 0.0, np.array([height]))[0]


def segments(scene, replay, index, path):
    """Return object id and type at every pixel of a frame, shape (height, width, 2)."""
    scene.draw(replay, index, path)
    scene.renderer.enable_segmentation_rendering()
    try:
        return scene.renderer.render()
    finally:
        scene.renderer.disable_segmentation_rendering()


def drawn(scene, kind):
    whole = scene.renderer.scene
    return [geom for geom in whole.geoms[: whole.ngeom] if geom.type == kind]


def seen_tip(scene, picture):
    site = scene.model.mj_model.site("tip").id
    kind = mujoco.mjtObj.mjOBJ_SITE
    rows, columns = np.nonzero((picture[..., 0] == site) & (picture[..., 1] == kind))
    assert len(rows), "nothing of it is seen"
    return np.array([columns.mean() + 0.5, rows.mean() + 0.5])


def seen_ghost(scene, picture):
    """Return where the ghost's tip is seen, as the middle of what it spans."""
    spheres = drawn(scene, mujoco.mjtGeom.mjGEOM_SPHERE)
    (ghost,) = (geom for geom in spheres if geom.objtype == mujoco.mjtObj.mjOBJ_UNKNOWN)
    rows, columns = np.nonzero((picture[..., 0] == ghost.objid) & (picture[..., 1] == 0))
    assert len(rows), "nothing of it is seen"
    return np.array([columns.min() + columns.max() + 1, rows.min() + rows.max() + 1]) / 2


@pytest.fixture(scope="module")
def stage(replay):
    path = follow(replay, 30, SIZE, Frame())
    with open_scene(replay, SIZE) as scene:
        yield scene, path


@pytest.mark.parametrize("index", [0, BEFORE, AFTER, 12], ids=str)
def test_the_tip_is_seen_where_the_mathematics_puts_it(graphics, stage, replay, index):
    scene, path = stage
    expected = projected(path, index, replay.state[index], replay.half_length[index])
    seen = seen_tip(scene, segments(scene, replay, index, path))
    assert np.abs(seen - expected).max() < NEAR


@pytest.mark.parametrize("index", [BEFORE, AFTER], ids=str)
def test_the_ghost_is_where_the_ideal_tip_is_when_they_part(graphics, stage, apart, index):
    scene, path = stage
    picture = segments(scene, apart, index, path)
    expected = projected(path, index, apart.ideal[index], apart.half_length[index])
    assert np.abs(seen_ghost(scene, picture) - expected).max() < NEAR
    assert np.abs(seen_tip(scene, picture) - expected).max() > 20 * NEAR


def test_the_cart_grows_with_its_mass(graphics, stage, replay):
    scene, path = stage
    cart = scene.model.mj_model.geom("cart").id
    widths = []
    for index in (BEFORE, AFTER):
        picture = segments(scene, replay, index, path)
        mask = (picture[..., 0] == cart) & (picture[..., 1] == mujoco.mjtObj.mjOBJ_GEOM)
        widths.append(np.ptp(np.nonzero(mask)[1]))
    assert widths[1] / widths[0] == pytest.approx(2.0, rel=0.05)  # 0.5 to 2 kg, width ~ sqrt(M)


def test_the_arrows_point_along_the_forces(graphics, stage, replay):
    scene, path = stage
    pushed = 10
    assert replay.push[pushed] == -10.0
    for index, arrows in ((0, 1), (pushed, 2)):
        scene.draw(replay, index, path)
        found = drawn(scene, mujoco.mjtGeom.mjGEOM_ARROW)
        assert len(found) == arrows
        along = [float(np.asarray(geom.mat).reshape(3, 3)[0, 2]) for geom in found]
        wanted = [replay.force[index], replay.push[index]][:arrows]
        np.testing.assert_allclose(along, np.sign(wanted), atol=1e-6)


def test_drawing_leaves_the_model_as_a_fresh_compile_would_have_it(graphics, stage, replay):
    scene, path = stage
    scene.draw(replay, AFTER, path)
    again = scene.draw(replay, BEFORE, path)
    with open_scene(replay, SIZE) as fresh:
        np.testing.assert_array_equal(fresh.draw(replay, BEFORE, path), again)
