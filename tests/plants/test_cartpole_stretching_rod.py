"""The stretching rod against a Lagrangian with l(t), derived here."""

from __future__ import annotations

import numpy as np
import sympy as sp

from afl_mujoco.plants.cartpole_equations import (
    cart_acceleration,
    pole_acceleration,
    stretching_accelerations,
)

ROUND_OFF = 1e-11  # relative, as A1


def lagrangian_accelerations():
    """Accelerations of cart and a uniformly stretching uniform rod, from its kinetic energy.

    The point at the share x of the rod, 0 < x < 1, sits at distance 2 l(t) x from the pivot.
    """
    t, x = sp.symbols("t x")
    mass, m, g, force, rate = sp.symbols("M m g F r")
    z, phi, length = (sp.Function(name)(t) for name in ("z", "phi", "l"))
    point = sp.Matrix([z - 2 * length * x * sp.sin(phi), 2 * length * x * sp.cos(phi)])
    velocity = point.diff(t)
    rod = sp.integrate(sp.expand(m * velocity.dot(velocity) / 2), (x, 0, 1))
    lagrangian = mass * z.diff(t) ** 2 / 2 + rod - m * g * length * sp.cos(phi)
    second = sp.symbols("a b")
    equations = [
        sp.diff(lagrangian.diff(q.diff(t)), t) - lagrangian.diff(q) - load
        for q, load in ((z, force), (phi, 0))
    ]
    values = sp.symbols("zd phd ph L")
    flat = [
        e.subs({z.diff(t, 2): second[0], phi.diff(t, 2): second[1], length.diff(t, 2): 0})
        .subs({length.diff(t): rate, z.diff(t): values[0], phi.diff(t): values[1]})
        .subs({phi: values[2], length: values[3]})
        for e in equations
    ]
    solved = sp.solve(flat, second, dict=True)[0]
    arguments = (values[2], values[1], force, mass, m, values[3], g, rate)
    return sp.lambdify(arguments, [solved[s] for s in second])


def random_case(rng):
    low = (-1.5, -5.0, -100.0, 0.1, 0.01, 0.05, 1.0, -1.0)
    high = (1.5, 5.0, 100.0, 2.0, 0.5, 1.0, 20.0, 1.0)
    return rng.uniform(low, high)


def test_accelerations_are_those_of_the_lagrangian_with_l_of_t():
    derived = lagrangian_accelerations()
    for seed in range(50):
        case = random_case(np.random.default_rng(seed))
        expected = np.array(derived(*case))
        off = np.abs(np.array(stretching_accelerations(*case)) - expected)
        assert (off <= ROUND_OFF * (1.0 + np.abs(expected))).all(), seed


def test_without_a_rate_it_is_the_paper_s_plant():
    case = random_case(np.random.default_rng(7))[:-1]
    frozen = np.array([cart_acceleration(*case), pole_acceleration(*case)])
    np.testing.assert_allclose(stretching_accelerations(*case, 0.0), frozen, rtol=1e-13)
