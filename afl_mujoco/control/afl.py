"""The paper's control law (L1)-(L10): state and model in, force out."""

from __future__ import annotations

import numpy as np
from numba.extending import register_jitable
from numpy.typing import ArrayLike, NDArray

from afl_mujoco.compiled import kernel
from afl_mujoco.control import feedback_linearization as fl
from afl_mujoco.control.gains import Gains
from afl_mujoco.control.sliding_mode import (
    commanded_acceleration,
    sliding_surface,
    surface_drift,
)
from afl_mujoco.errors import ControllerDomainError
from afl_mujoco.scenario.parameters import CartPoleParameters

_xi1, _xi2, _xi3, _xi4 = fl.xi1, fl.xi2, fl.xi3, fl.xi4
_alpha, _beta, _linearizing_force = fl.alpha, fl.beta, fl.linearizing_force


@register_jitable
def sliding_and_drift(z, phi, z_dot, phi_dot, half_length, gravity, slope):
    """Return s of Eq. (L8) and a of Eq. (L9)."""
    x1 = _xi1(z, phi, half_length)
    x2 = _xi2(z_dot, phi, phi_dot, half_length)
    x3 = _xi3(phi, phi_dot, half_length, gravity)
    x4 = _xi4(phi, phi_dot, half_length, gravity)
    drift = surface_drift(_alpha(phi, phi_dot, half_length, gravity), x2, x3, x4, slope)
    return sliding_surface(x1, x2, x3, x4, slope), drift


@register_jitable
def _force(
    z, phi, z_dot, phi_dot, cart_mass, pole_mass, half_length, gravity, switching, slope, layer
):
    """Return F of Eqs. (L1) and (L10)."""
    surface, drift = sliding_and_drift(z, phi, z_dot, phi_dot, half_length, gravity, slope)
    gain = _beta(phi, phi_dot, half_length, gravity)
    u = commanded_acceleration(surface, drift, gain, switching, layer)
    return _linearizing_force(u, phi, phi_dot, cart_mass, pole_mass, half_length, gravity)


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
def afl_force(state, inputs):
    """Return the force [N] at one state from gains that are already looked up.

    state: (z, phi, z_dot, phi_dot), shape (4,).
    inputs: (M, m, l, g, K, lambda, Phi) as the controller assumes them, shape (7,).
    """
    return force_kernel(
        state[0], state[1], state[2], state[3],
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


def saturation_ratio(
    states: NDArray[np.float64], inputs: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return s / Phi at each of many states.

    inputs: M, m, l, g, K, lambda, Phi, shape (N, 7).
    """
    z, phi, z_dot, phi_dot = states.T
    surface, _ = sliding_and_drift(z, phi, z_dot, phi_dot, inputs[:, 2], inputs[:, 3], inputs[:, 5])
    return np.asarray(surface / inputs[:, 6])
