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
    return {
        "xi1": xi1, "xi2": xi2, "xi3": xi3, "xi4": xi4, "alpha": alpha, "beta": beta,
        "none2": none2, "none3": none3, "dropped": dropped,
    }  # fmt: skip


def test_the_input_reaches_neither_xi1_nor_xi2(derived):
    assert derived["none2"] == 0
    assert derived["none3"] == 0


def test_what_the_approximation_drops_is_the_term_the_paper_names(derived):
    assert sp.simplify(derived["dropped"] + 2 * phi_dot * sp.tan(phi)) == 0


PAPER = {
    "xi2": z_dot - 4 * length / 3 * phi_dot / sp.cos(phi),
    "xi3": -sp.tan(phi) * (g + 4 * length / 3 * phi_dot**2 / sp.cos(phi)),
    "xi4": -4 * length / 3 * (2 / sp.cos(phi) ** 3 - 1 / sp.cos(phi)) * phi_dot**3
    - (3 * g / sp.cos(phi) ** 2 - 2 * g) * phi_dot,
    "alpha": -4 * length / 3 * sp.sin(phi) / sp.cos(phi) ** 2
    * (6 / sp.cos(phi) ** 2 - 1) * phi_dot**4
    - 3 * g * sp.sin(phi) / sp.cos(phi) * (4 / sp.cos(phi) ** 2 - 1) * phi_dot**2
    + 3 * g / (4 * length) * sp.sin(phi) * (2 * g - 3 * g / sp.cos(phi) ** 2),
    "beta": 3 * phi_dot**2 - 6 * phi_dot**2 / sp.cos(phi) ** 2
    - 9 * g / (4 * length * sp.cos(phi)) + 3 * g / (2 * length) * sp.cos(phi),
}  # fmt: skip


@pytest.mark.parametrize("name", PAPER)
def test_the_printed_formula_is_the_lie_derivative_exactly(name, derived):
    assert sp.simplify(derived[name] - PAPER[name]) == 0


CODE = {
    "xi1": lambda s, h, gr: fl.xi1(s[0], s[1], h),
    "xi2": lambda s, h, gr: fl.xi2(s[2], s[1], s[3], h),
    "xi3": lambda s, h, gr: fl.xi3(s[1], s[3], h, gr),
    "xi4": lambda s, h, gr: fl.xi4(s[1], s[3], h, gr),
    "alpha": lambda s, h, gr: fl.alpha(s[1], s[3], h, gr),
    "beta": lambda s, h, gr: fl.beta(s[1], s[3], h, gr),
}


@pytest.mark.parametrize("name", CODE)
def test_the_code_computes_the_lie_derivative(name, derived, random_states, odd_parameters):
    p = odd_parameters
    function = sp.lambdify((STATE, length, g), derived[name], "mpmath")  # 15 digits and no overflow
    expected = [float(function(list(s), p.half_length, p.gravity)) for s in random_states.tolist()]
    actual = CODE[name](random_states.T, p.half_length, p.gravity)
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


def test_the_cart_s_mass_leaves_the_motion_and_stays_in_the_force(odd_parameters):
    p = odd_parameters
    light, heavy = (
        fl.linearizing_force(3.0, 0.4, -0.7, mass, p.pole_mass, p.half_length, p.gravity)
        for mass in (1.0, 2.0)
    )
    assert heavy - light == pytest.approx(3.0, rel=1e-14)


@pytest.mark.parametrize("half_length", [0.05, 0.5, 1.0], ids=str)
def test_the_input_gain_is_negative_near_upright(half_length):
    angles = np.linspace(-1.5, 1.5, 301)
    rates = np.linspace(-10, 10, 41)[:, None]
    assert (fl.beta(angles, rates, half_length, 9.81) < 0.0).all()
