"""The equations of motion (P3), (P4) of the cart-pole, its mass matrix, energy and momentum.

The compiled functions take floats or arrays: NumPy callers and compiled loops share them. `plant`
is the cart-pole whose MJCF has to obey them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from afl_mujoco.compiled import jitable
from afl_mujoco.plants.cartpole import CART_POLE
from afl_mujoco.plants.plant import known_as

if TYPE_CHECKING:
    from afl_mujoco.scenario.parameters import CartPoleParameters


@jitable
def determinant(phi, cart_mass, pole_mass):
    """Return D = 4/3 (M + m) - m cos^2(phi) [kg], the denominator of (P3) and (P4)."""
    return 4.0 / 3.0 * (cart_mass + pole_mass) - pole_mass * np.cos(phi) ** 2


@jitable
def cart_acceleration(phi, phi_dot, force, cart_mass, pole_mass, half_length, gravity):
    """Return z'' [m/s^2], Eq. (P3)."""
    centripetal = pole_mass * half_length * phi_dot**2 * np.sin(phi)
    weight = pole_mass * gravity * np.sin(phi) * np.cos(phi)
    return (weight - 4.0 / 3.0 * centripetal + 4.0 / 3.0 * force) / determinant(
        phi, cart_mass, pole_mass
    )


@jitable
def pole_acceleration(phi, phi_dot, force, cart_mass, pole_mass, half_length, gravity):
    """Return phi'' [rad/s^2], Eq. (P4)."""
    centripetal = pole_mass * half_length * phi_dot**2 * np.sin(phi)
    weight = (cart_mass + pole_mass) * gravity * np.sin(phi)
    return (weight + (force - centripetal) * np.cos(phi)) / (
        half_length * determinant(phi, cart_mass, pole_mass)
    )


def acceleration(
    state: ArrayLike, force: ArrayLike, parameters: CartPoleParameters
) -> NDArray[np.float64]:
    """Return the accelerations (z'', phi''), Eqs. (P3) and (P4).

    Parameters
    ----------
    state
        (z, phi, z_dot, phi_dot) [m, rad, m/s, rad/s], shape (..., 4).
    force
        Force on the cart [N], shape (...).
    parameters
        The plant.

    Returns
    -------
    ndarray
        (z'', phi'') [m/s^2, rad/s^2], shape (..., 2).
    """
    _, phi, _, phi_dot = np.moveaxis(np.asarray(state, dtype=np.float64), -1, 0)
    found = _accelerations((0.0, phi), (0.0, phi_dot), (np.asarray(force),), parameters)
    return np.stack(np.broadcast_arrays(*found), axis=-1)


def _accelerations(q: Any, v: Any, u: Any, p: Any) -> tuple[Any, Any]:
    """Return (z'', phi''), Eqs. (P3) and (P4), as a `Plant` has them."""
    given = (q[1], v[1], u[0], p.cart_mass, p.pole_mass, p.half_length, p.gravity)
    return cart_acceleration(*given), pole_acceleration(*given)


def terms(q: Any, v: Any, p: Any) -> Any:
    """Return M, h and B of M v' + h = B u, the coefficients of (P2) and (P1)."""
    coupling = -p.pole_mass * p.half_length * np.cos(q[1])
    pole = 4.0 / 3.0 * p.pole_mass * p.half_length**2
    mass = ((p.cart_mass + p.pole_mass, coupling), (coupling, pole))
    centripetal = p.pole_mass * p.half_length * v[1] ** 2 * np.sin(q[1])
    weight = p.pole_mass * p.gravity * p.half_length * np.sin(q[1])
    return mass, (centripetal, -weight), ((1.0,), (0.0,))


plant = known_as(replace(CART_POLE, accelerations=_accelerations), CART_POLE.name)


def mass_matrix(state: ArrayLike, parameters: CartPoleParameters) -> NDArray[np.float64]:
    """Return the mass matrix of (z, phi): the coefficients of (P2) and (P1).

    Parameters
    ----------
    state
        (z, phi, z_dot, phi_dot), shape (..., 4).
    parameters
        The plant.

    Returns
    -------
    ndarray
        Shape (..., 2, 2), symmetric [kg, kg m; kg m, kg m^2].
    """
    q = np.moveaxis(np.asarray(state, dtype=np.float64), -1, 0)[:2]
    mass, _, _ = terms(q, np.zeros(2), parameters)
    matrix = np.empty((*q[1].shape, 2, 2))
    for i, row in enumerate(mass):
        for j, value in enumerate(row):
            matrix[..., i, j] = value
    return matrix


def velocity_jump(state: ArrayLike, impulse: float, parameters: Any) -> NDArray[np.float64]:
    """Return the jump of (z_dot, phi_dot) that an ideal impulse on the cart [N s] causes."""
    matrix = mass_matrix(state, parameters)
    push = np.zeros((*matrix.shape[:-1], 1))
    push[..., 0, 0] = impulse
    return np.asarray(np.linalg.solve(matrix, push)[..., 0])


def total_energy(state: ArrayLike, parameters: CartPoleParameters) -> NDArray[np.float64]:
    """Return kinetic plus potential energy, which is zero at the height of the pivot.

    Parameters
    ----------
    state
        (z, phi, z_dot, phi_dot) [m, rad, m/s, rad/s], shape (..., 4).
    parameters
        The plant.

    Returns
    -------
    ndarray
        Energy [J], shape (...).
    """
    s = np.asarray(state, dtype=np.float64)
    p = parameters
    velocity = s[..., 2:]
    kinetic = 0.5 * np.einsum("...i,...ij,...j", velocity, mass_matrix(s, p), velocity)
    potential = p.pole_mass * p.gravity * p.half_length * np.cos(s[..., 1])
    return np.asarray(kinetic + potential)


def linear_momentum(state: ArrayLike, parameters: CartPoleParameters) -> NDArray[np.float64]:
    """Return the momentum of cart and pole along z: the left side of (P2) is its rate.

    Parameters
    ----------
    state
        (z, phi, z_dot, phi_dot), shape (..., 4).
    parameters
        The plant.

    Returns
    -------
    ndarray
        Momentum [kg m/s], shape (...).
    """
    s = np.asarray(state, dtype=np.float64)
    row = mass_matrix(s, parameters)[..., 0, :]
    return np.asarray(np.einsum("...j,...j", row, s[..., 2:]))
