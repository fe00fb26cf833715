"""(L1)-(L7) against Lie derivatives of the reduced system, derived here by sympy."""

import numpy as np
import pytest
import sympy as sp

from afl_mujoco import acceleration
from afl_mujoco.control import law as fl

RELATIVE = 1e-12  # the limit of A9

z, phi, z_dot, phi_dot, u = sp.symbols("z phi z_dot phi_dot u", real=True)
length, g = sp.symbols("l g", positive=True)
STATE = (z, phi, z_dot, phi_dot)


def _rate(expression):
    """Differentiate along z'' = u, phi'' = 3/(4l) (g sin phi + u cos phi)."""
    pole = 3 / (4 * length) * (g * sp.sin(phi) + u * sp.cos(phi))
    flow = (z_dot, phi_dot, u, pole)
    return sum(expression.diff(x) * f for x, f in zip(STATE, flow, strict=True))


def _split(expression):
    """Return what does not carry u, and the factor of u."""
    drift = expression.subs(u, 0)
    factor = expression.diff(u)
    assert sp.simplify(factor.diff(u)) == 0
    return sp.simplify(drift), sp.simplify(factor)


@pytest.fixture(scope="module")
def derived():
    """The coordinates from xi1 alone: each the drift of the one before."""
    xi1 = z - 4 * length / 3 * sp.log((1 + sp.sin(phi)) / sp.cos(phi))
    xi2, none2 = _split(_rate(xi1))
    xi3, none3 = _split(_rate(xi2))
    xi4, dropped = _split(_rate(xi3))
    alpha, beta = _split(_rate(xi4))
    assert none2 == none3 == sp.simplify(dropped + 2 * phi_dot * sp.tan(phi)) == 0  # as the paper
    return {"xi1": xi1, "xi2": xi2, "xi3": xi3, "xi4": xi4, "alpha": alpha, "beta": beta}


def test_the_code_computes_the_lie_derivatives(derived, random_states, odd_parameters):
    p, (s0, s1, s2, s3) = odd_parameters, random_states.T
    half, gravity = p.half_length, p.gravity
    found = {
        "xi1": fl.xi1(s0, s1, half),
        "xi2": fl.xi2(s2, s1, s3, half),
        **{name: getattr(fl, name)(s1, s3, half, gravity) for name in [*derived][2:]},
    }
    for name, actual in found.items():
        exact = sp.lambdify((STATE, length, g), derived[name], "mpmath")  # no overflow
        expected = [float(exact(state, half, gravity)) for state in random_states.tolist()]
        scale = np.abs(expected).max() * 1e-3  # where terms cancel, relative to the terms
        np.testing.assert_allclose(actual, expected, rtol=RELATIVE, atol=RELATIVE * scale)


def test_with_l1_the_plant_becomes_the_reduced_system(random_states, odd_parameters, rng):
    p = odd_parameters
    command = rng.uniform(-50, 50, len(random_states))
    _, angle, _, rate = random_states.T
    force = fl.linearizing_force(
        command, angle, rate, p.cart_mass, p.pole_mass, p.half_length, p.gravity
    )
    pole = 3 / (4 * p.half_length) * (p.gravity * np.sin(angle) + command * np.cos(angle))
    expected = np.stack([command, pole], axis=-1)
    actual = acceleration(random_states, force, p)
    np.testing.assert_allclose(actual, expected, rtol=RELATIVE, atol=RELATIVE * 50)  # of |u|
