"""Equations of motion (P3), (P4) and the mass matrix behind them.

`cart_acceleration` and `pole_acceleration` take floats or arrays and can be compiled: NumPy callers
and compiled loops share one implementation.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from afl_mujoco.compiled import jitable

if TYPE_CHECKING:
    from afl_mujoco.scenario.parameters import CartPoleParameters


@jitable
def determinant(phi, cart_mass, pole_mass):
    """Return D = 4/3 (M + m) - m cos^2(phi) [kg], the denominator of (P3) and (P4).

    phi: Pole angle [rad].
    cart_mass, pole_mass: M, m [kg].
    """
    return 4.0 / 3.0 * (cart_mass + pole_mass) - pole_mass * np.cos(phi) ** 2


@jitable
def cart_acceleration(phi, phi_dot, force, cart_mass, pole_mass, half_length, gravity):
    """Return z'' [m/s^2], Eq. (P3).

    phi, phi_dot: Pole angle [rad] and its rate [rad/s].
    force: Force on the cart [N].
    cart_mass, pole_mass, half_length, gravity: M, m [kg], l [m], g [m/s^2].
    """
    centripetal = pole_mass * half_length * phi_dot**2 * np.sin(phi)
    weight = pole_mass * gravity * np.sin(phi) * np.cos(phi)
    return (weight - 4.0 / 3.0 * centripetal + 4.0 / 3.0 * force) / determinant(
        phi, cart_mass, pole_mass
    )


@jitable
def pole_acceleration(phi, phi_dot, force, cart_mass, pole_mass, half_length, gravity):
    """Return phi'' [rad/s^2], Eq. (P4).

    phi, phi_dot: Pole angle [rad] and its rate [rad/s].
    force: Force on the cart [N].
    cart_mass, pole_mass, half_length, gravity: M, m [kg], l [m], g [m/s^2].
    """
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
    p = parameters
    arguments = (phi, phi_dot, np.asarray(force), p.cart_mass, p.pole_mass, p.half_length)
    return np.stack(
        np.broadcast_arrays(
            cart_acceleration(*arguments, p.gravity), pole_acceleration(*arguments, p.gravity)
        ),
        axis=-1,
    )


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
    phi = np.asarray(state, dtype=np.float64)[..., 1]
    p = parameters
    matrix = np.empty((*phi.shape, 2, 2))
    matrix[..., 0, 0] = p.cart_mass + p.pole_mass
    matrix[..., 0, 1] = matrix[..., 1, 0] = -p.pole_mass * p.half_length * np.cos(phi)
    matrix[..., 1, 1] = 4.0 / 3.0 * p.pole_mass * p.half_length**2
    return matrix


def velocity_jump(
    state: ArrayLike, impulse: float, parameters: CartPoleParameters
) -> NDArray[np.float64]:
    """Return the jump of (z_dot, phi_dot) that an ideal impulse on the cart causes.

    state: (z, phi, z_dot, phi_dot), shape (..., 4).
    impulse: Momentum given to the cart along z [N s].
    Returns ndarray: Shape (..., 2): mass matrix^-1 (impulse, 0) [m/s, rad/s].
    """
    matrix = mass_matrix(state, parameters)
    push = np.zeros((*matrix.shape[:-1], 1))
    push[..., 0, 0] = impulse
    return np.asarray(np.linalg.solve(matrix, push)[..., 0])
