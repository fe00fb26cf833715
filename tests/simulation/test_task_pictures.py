"""The pictures of the dm_control environment."""

import math
from dataclasses import replace

import numpy as np
import pytest

import afl_mujoco as afl

CALM = replace(afl.SCENARIOS["nominal"], duration=1.0)


def _pole_pixels(picture: np.ndarray) -> np.ndarray:
    red, _, blue = picture.astype(int).transpose(2, 0, 1)
    return np.argwhere(red - blue > 60)  # cart, track and sky are bluish or grey


@pytest.mark.parametrize("half_length", [0.2, 0.5, 1.0])
def test_the_side_camera_shows_the_whole_pole_wherever_the_cart_is(graphics, half_length):
    scenario = replace(CALM, schedule={**CALM.schedule, "half_length": afl.constant(half_length)})
    physics = afl.load(scenario).physics
    extents = []
    for z in (0.0, 7.0):
        physics.begin((z, -math.pi / 3, 0.0, 0.0))
        seen = _pole_pixels(physics.render(240, 320, camera_id="side"))
        assert seen.min() > 0
        assert (seen.max(axis=0) < (239, 319)).all()
        extents.append(np.ptp(seen, axis=0))
    assert np.abs(extents[0] - extents[1]).max() <= 1  # the camera follows; edges round to a pixel


def test_a_picture_shows_the_length_of_its_instant(graphics):
    scenario = replace(
        CALM,
        initial_state=(0, 0, 0, 0),
        schedule={**CALM.schedule, "half_length": afl.staircase((0.5,), (0.3, 0.9))},
    )
    environment = afl.load(scenario, control_period=0.1)
    environment.reset()
    heights = []
    for _ in range(6):
        picture = environment.physics.render(240, 320, camera_id="side")
        heights.append(np.ptp(_pole_pixels(picture)[:, 0]))
        environment.step([0.0])
    assert len(set(heights[:5])) == 1
    assert heights[5] > 2.0 * heights[0]


def test_pictures_leave_the_simulation_alone(graphics):
    scenario = replace(
        afl.SCENARIOS["step-step"],
        duration=2.0,
        disturbances=(afl.Impulse(momentum=0.4, time=0.0), afl.Impulse(momentum=-1.0, time=1.0)),
    )
    environment, watched = (afl.load(scenario, control_period=0.05) for _ in range(2))
    for env in (environment, watched):
        env.reset()
    for force in np.linspace(20.0, -5.0, 20):
        watched.physics.render(60, 80, camera_id="side")
        for env in (environment, watched):
            env.step([force])
        np.testing.assert_array_equal(watched.physics.state(), environment.physics.state())
