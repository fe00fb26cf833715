import math

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.control.angle import BOX, SLOPES, force, slope_at
from afl_mujoco.control.gains import GAIN_NAMES, Gains

ANGLE, FIXED = afl.CONTROLLERS["adaptive-angle"], afl.CONTROLLERS["fixed-retuned"]


def test_the_slope_is_large_near_upright_and_stays_in_the_box():
    angles = np.deg2rad([0.0, 20.0, 40.0, 60.0, 80.0])
    slopes = [slope_at(angle, 0.5) for angle in angles]
    between = math.sqrt(SLOPES[0] * SLOPES[1])
    assert slopes == pytest.approx([SLOPES[0], SLOPES[0], between, SLOPES[1], SLOPES[1]])
    assert [slope_at(-angle, 0.5) for angle in angles] == slopes
    slopes = [slope_at(1.0, length) for length in (1e-6, 0.1, 0.5, 1.0, 1e9)]
    assert slopes == sorted(slopes, reverse=True) and slopes[1] > slopes[2] > slopes[3]
    assert (slopes[0], slopes[-1]) == (BOX[1], BOX[0])


def test_the_force_is_that_of_the_law_with_this_slope():
    plant = afl.CartPoleParameters(cart_mass=1.4, pole_mass=0.07, half_length=0.3, gravity=9.7)
    for state in ([0.1, -1.0, 0.4, 1.5], [-0.2, 0.3, 1.0, -2.0], [0.0, 0.0, 0.0, 0.0]):
        k, _, layer = (getattr(FIXED.gain_function, name)[0] for name in GAIN_NAMES)
        gains = Gains(switching=k, slope=slope_at(state[1], 0.3), boundary_layer=layer)
        expected = afl.control_force(state, plant, gains)
        assert force(3.0, state, plant) == pytest.approx(float(expected), rel=1e-12, abs=1e-12)
    assert math.isnan(force(0.0, [0.0, 1.6, 0.0, 0.0], plant))
