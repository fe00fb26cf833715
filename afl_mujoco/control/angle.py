"""The paper's controller with a slope that follows the pole's angle, as a controller in Python."""

from __future__ import annotations

import math
from collections.abc import Sequence

from afl_mujoco.control.gains import shipped_data
from afl_mujoco.control.law import afl_force
from afl_mujoco.scenario.parameters import CartPoleParameters

ANGLES = (math.radians(20.0), math.radians(60.0))  # abs(phi) between which ln(lambda) is linear
SLOPES = (5.0, 3.0)  # lambda there at l = LENGTH [1/s]; of `benchmarks/bench_equal_effort.py`
EXPONENT, LENGTH = -0.25, 0.5  # lambda goes with (l / LENGTH)^EXPONENT; l in m
BOX = (1.0, 5.0)  # least and largest lambda [1/s] (decision D8)

_FIXED = shipped_data("gain_functions.json")["fixed"]


def slope_at(angle: float, half_length: float) -> float:
    """Return lambda [1/s] for phi [rad] and the assumed l [m]."""
    (near, far), (fast, slow) = ANGLES, SLOPES
    share = min(max((abs(angle) - near) / (far - near), 0.0), 1.0)
    slope: float = fast * (slow / fast) ** share * (half_length / LENGTH) ** EXPONENT
    return min(max(slope, BOX[0]), BOX[1])


def force(time: float, state: Sequence[float], belief: CartPoleParameters) -> float:
    """Return the force [N] of (L1)-(L10), NaN where it has none, as a controller in Python."""
    p, g = belief, _FIXED
    inputs = (
        *(p.cart_mass, p.pole_mass, p.half_length, p.gravity),
        *(g["switching"], slope_at(state[1], p.half_length), g["boundary_layer"]),
    )
    return float(afl_force(tuple(state), inputs))
