"""The control law: (L1)-(L7) against Lie derivatives by sympy, (L8)-(L10), symmetry, domain."""

import math

import numpy as np
import pytest
import sympy as sp

from afl_mujoco import Gains, control_force, sliding_variable
from afl_mujoco.control import law as fl
from afl_mujoco.errors import ControllerDomainError
from tests.messages import line

GAINS = Gains(switching=87.0, slope=1.7, boundary_layer=63.0)
RELATIVE = 1e-12  # the limit of A9

z, phi, z_dot, phi_dot, u = sp.symbols("z phi z_dot phi_dot u", real=True)
length, g = sp.symbols("l g", positive=True)
STATE = (z, phi, z_dot, phi_dot)


def _coordinates(states, p):
    (z, phi, z_dot, phi_dot), names = states.T, ("xi3", "xi4", "alpha", "beta")
    rest = {x: getattr(fl, x)(phi, phi_dot, p.half_length, p.gravity) for x in names}
    xi2 = fl.xi2(z_dot, phi, phi_dot, p.half_length)
    return {"xi1": fl.xi1(z, phi, p.half_length), "xi2": xi2, **rest}


def test_the_sliding_variable_is_l8_and_the_force_l9_and_l10_in_l1(random_states, odd_parameters):
    p, lam = odd_parameters, GAINS.slope
    x1, x2, x3, x4, alpha, beta = _coordinates(random_states, p).values()
    terms = np.array([x4, 3 * lam * x3, 3 * lam**2 * x2, lam**3 * x1])
    s = sliding_variable(random_states, p, GAINS)
    beyond = np.abs(s) > GAINS.boundary_layer
    assert beyond.any() and not beyond.all()  # both sides of the saturation
    np.testing.assert_array_less(np.abs(s - terms.sum(axis=0)), 1e-14 * np.abs(terms).sum(axis=0))
    drift = alpha + 3 * lam * x4 + 3 * lam**2 * x3 + lam**3 * x2
    u = -drift / beta + GAINS.switching * np.clip(s / GAINS.boundary_layer, -1, 1)
    _, phi, _, phi_dot = random_states.T
    plant = (p.cart_mass, p.pole_mass, p.half_length, p.gravity)
    expected = fl.linearizing_force(u, phi, phi_dot, *plant)
    # the largest term of u is of order 1e4 here
    actual = control_force(random_states, p, GAINS)
    np.testing.assert_allclose(actual, expected, rtol=1e-12, atol=1e-12)


def test_the_control_law_is_finite_up_to_the_edge_of_its_domain(odd_parameters):
    states = np.zeros((2, 8, 4))
    states[:, :, 1] = np.outer([-1, 1], 0.5 * math.pi - 10.0 ** -np.arange(1, 9))
    force = control_force(states, odd_parameters, GAINS)
    assert force.shape == (2, 8) and np.isfinite(force).all()


@pytest.mark.parametrize("phi", [0.5 * math.pi, -3.0, math.nan], ids=str)
@pytest.mark.parametrize("function", [control_force, sliding_variable])
def test_outside_its_domain_it_is_an_error_that_names_the_angle(function, phi, odd_parameters):
    states = np.array([[0.0, 0.1, 0.0, 0.0], [0.0, phi, 0.0, 0.0]])
    expected = line(f"pole angle phi must lie inside (-pi/2, pi/2), got {phi:g} rad")
    with pytest.raises(ControllerDomainError, match=expected):
        function(states, odd_parameters, GAINS)


def _rate(expression):
    flow = (z_dot, phi_dot, u, 3 / (4 * length) * (g * sp.sin(phi) + u * sp.cos(phi)))
    return sum(expression.diff(x) * f for x, f in zip(STATE, flow, strict=True))


def _split(expression):
    factor = expression.diff(u)
    assert sp.simplify(factor.diff(u)) == 0
    return sp.simplify(expression.subs(u, 0)), sp.simplify(factor)


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
    p = odd_parameters
    for name, actual in _coordinates(random_states, p).items():
        exact = sp.lambdify((STATE, length, g), derived[name], "mpmath")  # no overflow
        expected = [float(exact(x, p.half_length, p.gravity)) for x in random_states.tolist()]
        scale = np.abs(expected).max() * 1e-3  # where terms cancel, relative to the terms
        np.testing.assert_allclose(actual, expected, rtol=RELATIVE, atol=RELATIVE * scale)
