"""Energy and momentum of the cart-pole, with which (P1) and (P2) are consistent."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from afl_mujoco.plant.dynamics import mass_matrix

if TYPE_CHECKING:
    from afl_mujoco.scenario.parameters import CartPoleParameters


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
