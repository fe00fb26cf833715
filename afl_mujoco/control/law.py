"""The paper's law: approximate feedback linearization (L1 to L7), sliding mode (L8 to L10)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from afl_mujoco.compiled import jitable, kernel
from afl_mujoco.control.gains import Gains
from afl_mujoco.errors import ControllerDomainError
from afl_mujoco.scenario.parameters import CartPoleParameters

# One-letter and Greek names are the paper's; every function is one numbered equation.


@jitable
def linearizing_force(u, phi, phi_dot, cart_mass, pole_mass, half_length, gravity):
    """Return the force F [N] that makes z'' = u and phi'' = 3/(4l) (g sin + u cos), Eq. (L1)."""
    sin, cos = np.sin(phi), np.cos(phi)
    inertia = (cart_mass + pole_mass) - 0.75 * pole_mass * cos**2
    centripetal = pole_mass * half_length * phi_dot**2 * sin
    return inertia * u + centripetal - 0.75 * pole_mass * gravity * sin * cos


@jitable
def xi1(z, phi, half_length):
    """Return the output coordinate xi1 [m], Eq. (L2), ln((1 + sin)/cos) written as arcsinh(tan).

    The two are equal; the second is odd to the last bit and has no cancellation near -pi/2.
    """
    return z - 4.0 / 3.0 * half_length * np.arcsinh(np.sin(phi) / np.cos(phi))


@jitable
def xi2(z_dot, phi, phi_dot, half_length):
    """Return xi2 = xi1' [m/s], Eq. (L3)."""
    return z_dot - 4.0 / 3.0 * half_length * phi_dot / np.cos(phi)


@jitable
def xi3(phi, phi_dot, half_length, gravity):
    """Return xi3 = xi2' [m/s^2], Eq. (L4)."""
    sin, cos = np.sin(phi), np.cos(phi)
    return -sin / cos * (gravity + 4.0 / 3.0 * half_length * phi_dot**2 / cos)


@jitable
def xi4(phi, phi_dot, half_length, gravity):
    """Return xi4 [m/s^3], Eq. (L5): xi3' without its term -2 phi' tan(phi) u."""
    cos = np.cos(phi)
    square = cos * cos
    cubic = 4.0 / 3.0 * half_length * (2.0 / square - 1.0) / cos
    return -(cubic * phi_dot**2 + (3.0 / square - 2.0) * gravity) * phi_dot


@jitable
def alpha(phi, phi_dot, half_length, gravity):
    """Return the drift alpha of xi4' [m/s^4], Eq. (L6)."""
    sin, cos = np.sin(phi), np.cos(phi)
    square = cos * cos
    rate2 = phi_dot * phi_dot
    quartic = 4.0 / 3.0 * half_length * sin / square * (6.0 / square - 1.0)
    quadratic = 3.0 * gravity * sin / cos * (4.0 / square - 1.0)
    constant = 0.75 * gravity**2 / half_length * sin * (2.0 - 3.0 / square)
    return constant - (quartic * rate2 + quadratic) * rate2


@jitable
def beta(phi, phi_dot, half_length, gravity):
    """Return the input gain beta of xi4' [1/s^2], Eq. (L7); negative near upright."""
    cos = np.cos(phi)
    rate_part = 3.0 * phi_dot**2 * (1.0 - 2.0 / (cos * cos))
    return rate_part - 0.75 * gravity / half_length * (3.0 / cos - 2.0 * cos)


@jitable
def sliding_surface(xi_1, xi_2, xi_3, xi_4, slope):
    """Return s = (d/dt + lambda)^3 xi1 [m/s^3], Eq. (L8)."""
    return xi_4 + slope * (3.0 * xi_3 + slope * (3.0 * xi_2 + slope * xi_1))


@jitable
def surface_drift(alpha, xi_2, xi_3, xi_4, slope):
    """Return a, the part of s' without the input [m/s^4], first half of Eq. (L9)."""
    return alpha + slope * (3.0 * xi_4 + slope * (3.0 * xi_3 + slope * xi_2))


@jitable
def saturation(x):
    """Return sat(x) = clip(x, -1, 1)."""
    return np.minimum(np.maximum(x, -1.0), 1.0)


@jitable
def commanded_acceleration(surface, drift, input_gain, switching, boundary_layer):
    """Return u = -a/b + K sat(s/Phi) [m/s^2], Eq. (L10), with b = beta of (L7)."""
    return -drift / input_gain + switching * saturation(surface / boundary_layer)


@jitable
def sliding_and_drift(z, phi, z_dot, phi_dot, half_length, gravity, slope):
    """Return s of Eq. (L8) and a of Eq. (L9)."""
    x1 = xi1(z, phi, half_length)
    x2 = xi2(z_dot, phi, phi_dot, half_length)
    x3 = xi3(phi, phi_dot, half_length, gravity)
    x4 = xi4(phi, phi_dot, half_length, gravity)
    drift = surface_drift(alpha(phi, phi_dot, half_length, gravity), x2, x3, x4, slope)
    return sliding_surface(x1, x2, x3, x4, slope), drift


@jitable
def _force(
    z, phi, z_dot, phi_dot, cart_mass, pole_mass, half_length, gravity, switching, slope, layer
):
    surface, drift = sliding_and_drift(z, phi, z_dot, phi_dot, half_length, gravity, slope)
    gain = beta(phi, phi_dot, half_length, gravity)
    u = commanded_acceleration(surface, drift, gain, switching, layer)
    return linearizing_force(u, phi, phi_dot, cart_mass, pole_mass, half_length, gravity)


@kernel
def force_kernel(
    z, phi, z_dot, phi_dot, cart_mass, pole_mass, half_length, gravity, switching, slope, layer
):
    """Return the force [N] of the control law, or NaN where it has no value (``|phi| >= pi/2``).

    This is its only compiled form: every loop and the dm_control agent call it, so that their
    forces are equal bit for bit. Floats only; arguments as in `control_force`.
    """
    if not abs(phi) < 0.5 * np.pi:
        return np.nan
    return _force(
        z, phi, z_dot, phi_dot, cart_mass, pole_mass, half_length, gravity, switching, slope, layer
    )


@kernel
def afl_force(state, inputs, home=0.0):
    """Return the force [N] from a state and (M, m, l, g, K, lambda, Phi) as assumed, about a z."""
    return force_kernel(
        state[0] - home, state[1], state[2], state[3],
        inputs[0], inputs[1], inputs[2], inputs[3], inputs[4], inputs[5], inputs[6],
    )  # fmt: skip


def control_force(
    state: ArrayLike, parameters: CartPoleParameters, gains: Gains
) -> NDArray[np.float64]:
    """Return the force of the control law, Eqs. (L1)-(L10).

    Parameters
    ----------
    state
        (z, phi, z_dot, phi_dot) [m, rad, m/s, rad/s], shape (..., 4).
    parameters
        The assumed parameters of the plant.
    gains
        K, lambda, Phi.

    Returns
    -------
    ndarray
        Force on the cart [N], shape (...).

    Raises
    ------
    ControllerDomainError
        If a pole angle is not inside ``|phi| < pi/2``.
    """
    z, phi, z_dot, phi_dot = _components(state)
    p, g = parameters, gains
    return np.asarray(
        _force(
            z, phi, z_dot, phi_dot, p.cart_mass, p.pole_mass, p.half_length, p.gravity,
            g.switching, g.slope, g.boundary_layer,
        )
    )  # fmt: skip


def sliding_variable(
    state: ArrayLike, parameters: CartPoleParameters, gains: Gains
) -> NDArray[np.float64]:
    """Return the sliding variable s, Eq. (L8).

    Parameters
    ----------
    state
        (z, phi, z_dot, phi_dot), shape (..., 4).
    parameters
        The assumed parameters of the plant.
    gains
        Only `slope` is used.

    Returns
    -------
    ndarray
        s [m/s^3], shape (...).

    Raises
    ------
    ControllerDomainError
        If a pole angle is not inside ``|phi| < pi/2``.
    """
    z, phi, z_dot, phi_dot = _components(state)
    p = parameters
    surface, _ = sliding_and_drift(z, phi, z_dot, phi_dot, p.half_length, p.gravity, gains.slope)
    return np.asarray(surface)


def _components(state: ArrayLike) -> NDArray[np.float64]:
    """Return the state, components on the first axis, or raise outside the control law's domain."""
    components = np.moveaxis(np.asarray(state, dtype=np.float64), -1, 0)
    phi = components[1]
    outside = ~(np.abs(phi) < 0.5 * np.pi)
    if np.any(outside):
        raise ControllerDomainError(
            "pole angle phi",
            "must lie inside (-pi/2, pi/2)",
            f"{np.extract(outside, phi)[0]:g} rad",
        )
    return components
