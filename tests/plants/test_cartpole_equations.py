"""The plant against Lagrange's equations of a cart and a uniform rod, derived from scratch."""

import numpy as np
import pytest
import sympy as sp

from afl_mujoco import CartPoleParameters, acceleration, mass_matrix
from afl_mujoco.plants import cartpole_equations as paper

ROUNDING = 1e-12  # relative: a few hundred roundings in either formula

t, x, M, m, g, F, L = sp.symbols("t x M m g F L", real=True)
COORDINATES = z, phi = sp.Function("z")(t), sp.Function("phi")(t)
FLAT, SECOND = sp.symbols("q0 q1 v0 v1", real=True), sp.symbols("a0 a1", real=True)


def _flat(expression):
    rates = [q.diff(t) for q in COORDINATES]
    second = dict(zip([w.diff(t) for w in rates], SECOND, strict=True))
    expression = expression.subs(second).subs(dict(zip(rates, FLAT[2:], strict=True)))
    return expression.subs(dict(zip(COORDINATES, FLAT[:2], strict=True)))


@pytest.fixture(scope="module")
def derived():
    """Everything the plant offers, from the two energies alone, as functions of numbers.

    The point at the share x of the rod, 0 < x < 1, sits at distance 2 l x from the pivot.
    """
    across, up = z - 2 * L * x * sp.sin(phi), 2 * L * x * sp.cos(phi)  # leans toward -z
    rod = sp.integrate(sp.expand(m * (across.diff(t) ** 2 + up.diff(t) ** 2) / 2), (x, 0, 1))
    kinetic = sp.expand(M * z.diff(t) ** 2 / 2 + rod)
    potential = sp.integrate(m * g * up, (x, 0, 1))
    lagrangian = kinetic - potential
    equations = [
        _flat(lagrangian.diff(q.diff(t)).diff(t) - lagrangian.diff(q)) - load
        for q, load in zip(COORDINATES, (F, 0), strict=True)
    ]
    solved = sp.solve(equations, SECOND, dict=True)[0]
    expressions = {
        "acceleration": [solved[a] for a in SECOND],
        "mass_matrix": sp.hessian(_flat(kinetic), FLAT[2:]).tolist(),
        "energy": _flat(kinetic + potential), "momentum": _flat(kinetic.diff(z.diff(t))),
    }  # fmt: skip
    return {k: sp.lambdify((FLAT, F, (M, m, L, g)), e, "numpy") for k, e in expressions.items()}


def _numbers(p):
    return p.cart_mass, p.pole_mass, p.half_length, p.gravity


def test_accelerations_are_the_lagrangian_s_of_any_rod(derived, random_states, rng):
    low, high = (0.1, 0.01, 0.05, 5.0), (2.0, 0.5, 1.0, 15.0)  # of verification.md, A1
    for m, pole, length, gravity in rng.uniform(low, high, size=(20, 4)).tolist():
        p = CartPoleParameters(cart_mass=m, pole_mass=pole, half_length=length, gravity=gravity)
        for state, force in zip(random_states[:20], rng.uniform(-200, 200, 20), strict=True):
            expected = np.array(derived["acceleration"](state, force, _numbers(p)))
            found, near = acceleration(state, force, p), ROUNDING * np.abs(expected).max()
            np.testing.assert_allclose(found, expected, rtol=0, atol=near)


def test_the_terms_are_those_of_the_accelerations(odd_parameters, random_states) -> None:
    p = odd_parameters
    for state in random_states:
        mass, bias, inputs = map(np.array, paper.terms(state[:2], state[2:], p))
        found = np.linalg.solve(mass, inputs[:, 0] * 7.0 - bias)
        np.testing.assert_allclose(found, acceleration(state, 7.0, p), rtol=1e-11)


def test_the_mass_matrix_is_of_the_energy_and_upright_stays(derived, random_states, odd_parameters):
    for state in random_states:
        expected = derived["mass_matrix"](state, 0.0, _numbers(odd_parameters))
        np.testing.assert_allclose(mass_matrix(state, odd_parameters), expected, rtol=1e-13)
    assert acceleration(np.zeros(4), 0.0, odd_parameters).tolist() == [0.0, 0.0]
    assert acceleration([0, -0.1, 0, 0], 100.0, odd_parameters)[1] > 0.0
    assert acceleration([0, 0.1, 0, 0], 0.0, odd_parameters)[1] > 0.0


def test_energy_and_momentum_are_those_of_the_lagrangian_and_an_impulse_turns_no_torque(
    derived, random_states, odd_parameters
):
    for name, function in (("energy", paper.total_energy), ("momentum", paper.linear_momentum)):
        expected = [derived[name](s, 0.0, _numbers(odd_parameters)) for s in random_states]
        found = function(random_states, odd_parameters)
        # absolute: terms of order 10 may cancel
        np.testing.assert_allclose(found, expected, rtol=ROUNDING, atol=1e-13)
    jump = paper.velocity_jump(random_states, 0.37, odd_parameters)
    after = random_states + np.pad(jump, ((0, 0), (2, 0)))
    gained = paper.linear_momentum(after, odd_parameters) - found
    np.testing.assert_allclose(gained, 0.37, rtol=ROUNDING)
    angular = np.einsum("nij,nj->ni", mass_matrix(random_states, odd_parameters), jump)[:, 1]
    np.testing.assert_allclose(angular, 0.0, atol=1e-15)


@pytest.mark.parametrize("shape", [(), (2, 3)], ids=str)
def test_shapes_follow_the_states_and_one_state_is_broadcast(shape, odd_parameters):
    state, p = np.full((*shape, 4), 0.1), odd_parameters
    assert acceleration(state, 1.0, p).shape == (*shape, 2)
    assert mass_matrix(state, p).shape == (*shape, 2, 2)
    assert paper.total_energy(state, p).shape == shape
    forces = np.linspace(-1, 1, 7)
    expected = [acceleration(np.full(4, 0.1), force, p) for force in forces]
    np.testing.assert_array_equal(acceleration(np.full(4, 0.1), forces, p), expected)
