"""Mistakes planted in accelerations, where no term stands by itself: those of the cart-pole."""

from __future__ import annotations

import pytest

import afl_mujoco as afl
from afl_mujoco.plants.cartpole_equations import plant

SOURCE = """
from math import cos, sin
def accelerations(q, v, u, p):
    M, m, l, g = p.cart_mass, p.pole_mass, p.half_length, p.gravity
    s, c, u = sin(q[1]), cos(q[1]), u[0]
    k, w, d = m * l * v[1] ** 2 * s, m * g * s, 4 / 3 * (M + m) - m * c ** 2
    return (w * c + 4 / 3 * (u - k)) / d, ((M + m) * g * s + (u - k) * c) / (l * d)
"""

RETURN = "return (w * c + 4 / 3 * (u - k)) / d, ((M + m) * g * s + (u - k) * c) / (l * d)"

MISTAKES = {
    "single precision": (
        RETURN,
        RETURN.replace("return ", "from numpy import array\n    return array([")
        + "]).astype('f4')",
        "the equations are in single precision?",
    ),
    "everything a tenth more": (
        " / d, (",
        " / d * 1.1, 1.1 * (",
        "every acceleration is 1.1 times",
    ),
    "nothing": (RETURN, "return 0.0, 0.0", "every acceleration is missing in the equations?"),
    "right": ("", "", "MuJoCo obeys the equations"),
    "sign of the centripetal term in z": (
        "4 / 3 * (u - k)",
        "4 / 3 * (u + k)",
        "phi_dot^2 in the acceleration of z has the other sign",
    ),
    "sign of the centripetal term in both": ("k, w, d = m", "k, w, d = -m", "phi_dot^2"),
    "4/3 missing from D": (
        "d = m * l * v[1] ** 2 * s, m * g * s, 4 / 3 *",
        "d = m * l * v[1] ** 2 * s, m * g * s, ",
        "which is not 1: the determinant?",
    ),
    "gravity missing from z": (
        "(w * c + ",
        "(0.0 * c + ",
        "gravity in the acceleration of z is missing",
    ),
    "weight of the pole only": ("(M + m) * g * s", "m * g * s", ""),
    "inertia of a point": ("4 / 3 * (M + m) - ", "(M + m) - ", ""),
    "force counted twice": ("u[0]\n", "2 * u[0]\n", "gear of input force is doubled"),
    "stale mass": ("p.cart_mass,", "1.0,", "stale constant: the equations have cart_mass = 1 "),
    "stale gravity": (
        "p.gravity\n",
        "9.81\n",
        "stale constant: the equations have gravity = 9.81 ",
    ),
    "length for half the length": (
        "p.half_length",
        "2.0 * p.half_length",
        "the length of body pole",
    ),
    "angle from hanging down": (
        "sin(q[1]), cos(q[1])",
        "-sin(q[1]), -cos(q[1])",
        "centre of mass of body pole",
    ),
    "angle to the other side": ("q[1]), u[0]", "q[1]), -u[0]", ""),
    "degrees": ("    s, c", "    q = 57.29577951308232 * q\n    s, c", "phi is in degrees"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_in_accelerations_is_found_and_named(mistake: str, interpreted) -> None:
    old, new, said = MISTAKES[mistake]
    space = {"__name__": "planted"}
    assert old in SOURCE
    exec(SOURCE.replace(old, new) if old else SOURCE, space)
    names = ("coordinates", "inputs", "parameters", "write")
    made = afl.Plant(
        name="planted", model=plant.model, accelerations=space["accelerations"],
        **{name: getattr(plant, name) for name in names},
    )  # fmt: skip
    result = afl.check(made, samples=100)
    assert result.passed == (mistake == "right")
    assert said in result.headline, result.headline
