"""The cart-pole near upright, as a control law models it: (P1), (P2) to first order.

With ``cos(phi) = 1``, ``sin(phi) = phi`` and no products of small quantities they read
``(4/3) l phi'' = z'' + g phi`` and ``(M + m) z'' - m l phi'' = F``. The first gives phi'' in terms
of z''; substituted in the second, it leaves ``mu z'' = F + (3/4) m g phi`` with ``mu = M + m/4``,
the mass that the force has to accelerate. Everything below follows from these two.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.parameters import CartPoleParameters


class LinearModel(NamedTuple):
    """A linear model ``x' = A x + B v`` of x = (z, phi, z_dot, phi_dot)."""

    a: NDArray[np.float64]  # A, shape (4, 4)
    b: NDArray[np.float64]  # B, shape (4,); v is the force [N], or the cart's acceleration [m/s^2]


def accelerated_mass(parameters: CartPoleParameters) -> float:
    """Return mu = M + m/4 [kg]: at upright, the force for a unit acceleration of the cart."""
    return parameters.cart_mass + 0.25 * parameters.pole_mass


def upright_model(parameters: CartPoleParameters) -> LinearModel:
    """Return the model at upright, its input the force [N]."""
    p, mu = parameters, accelerated_mass(parameters)
    return _model(
        cart=(0.75 * p.pole_mass * p.gravity / mu, 1.0 / mu),
        pole=(
            0.75 * (p.cart_mass + p.pole_mass) * p.gravity / (p.half_length * mu),
            0.75 / (p.half_length * mu),
        ),
    )


def partially_linear_model(half_length: float, gravity: float) -> LinearModel:
    """Return the model at upright under the input map (L1), its input z'' [m/s^2].

    half_length, gravity: l [m] and g [m/s^2].
    """
    share = 0.75 / half_length
    return _model(cart=(0.0, 1.0), pole=(share * gravity, share))


def _model(cart: tuple[float, float], pole: tuple[float, float]) -> LinearModel:
    """Return the model in which z'' and phi'' have these factors of phi and of the input."""
    a, b = np.zeros((4, 4)), np.zeros(4)
    a[0, 2] = a[1, 3] = 1.0
    a[2, 1], b[2] = cart
    a[3, 1], b[3] = pole
    return LinearModel(a, b)


def pole_placing_gains(model: LinearModel, poles: Sequence[complex]) -> NDArray[np.float64]:
    """Return the gains k with which ``v = -k x`` gives a model these poles.

    With z'' = c phi + p v and phi'' = a phi + q v, the closed loop's polynomial is
    ``s^4 + (p k3 + q k4) s^3 + (p k1 + q k2 - a) s^2 - (a p - c q) (k3 s + k1)``.

    poles: Four, real or in conjugate pairs [1/s].
    Returns ndarray: Gains of (z, phi, z_dot, phi_dot), shape (4,).
    """
    polynomial = np.poly(np.asarray(poles))
    if len(polynomial) != 5 or np.iscomplexobj(polynomial):
        raise InvalidValueError("poles", "must be four, real or in conjugate pairs", list(poles))
    _, s3, s2, s1, s0 = polynomial.tolist()
    c, p, a, q = model.a[2, 1], model.b[2], model.a[3, 1], model.b[3]
    coupling = a * p - c * q
    k1, k3 = -s0 / coupling, -s1 / coupling
    return np.array([k1, (s2 + a - p * k1) / q, k3, (s3 - p * k3) / q])
