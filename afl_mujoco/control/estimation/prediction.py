"""The estimator's own model of the cart-pole over one control period: motion and its sensitivity.

The motion is (L1) solved for z'', and the pole equation that it leaves,
phi'' = 3/(4 l) (g sin + z'' cos). The state of the estimator is (z, phi, z', phi', ln M, ln l).
"""

from __future__ import annotations

import numpy as np

from afl_mujoco.compiled import kernel

STATES = 6
"""Length of the estimator's state."""


@kernel
def accelerations(phi, phi_dot, force, plant):
    """Return (z'', phi'') [m/s^2, rad/s^2], Eq. (E1).

    phi, phi_dot: Pole angle [rad] and its rate [rad/s].
    force: Force on the cart [N].
    """
    cart_mass, pole_mass, half_length, gravity = plant
    sin, cos = np.sin(phi), np.cos(phi)
    inertia = (cart_mass + pole_mass) - 0.75 * pole_mass * cos * cos
    centripetal = pole_mass * half_length * phi_dot * phi_dot * sin
    cart = (force - centripetal + 0.75 * pole_mass * gravity * sin * cos) / inertia
    return cart, 0.75 / half_length * (gravity * sin + cart * cos)


@kernel
def moved(z, phi, z_dot, phi_dot, force, plant, dt):
    """Return (z, phi, z_dot, phi_dot) after `dt` under a held force: one step of RK4, Eq. (E2).

    force: Force on the cart [N].
    dt: Length of the step [s].
    """
    half = 0.5 * dt
    z1, p1 = accelerations(phi, phi_dot, force, plant)
    z2, p2 = accelerations(phi + half * phi_dot, phi_dot + half * p1, force, plant)
    z3, p3 = accelerations(phi + half * (phi_dot + half * p1), phi_dot + half * p2, force, plant)
    z4, p4 = accelerations(phi + dt * (phi_dot + half * p2), phi_dot + dt * p3, force, plant)
    return (
        z + dt * (z_dot + dt / 6.0 * (z1 + z2 + z3)),
        phi + dt * (phi_dot + dt / 6.0 * (p1 + p2 + p3)),
        z_dot + dt / 6.0 * (z1 + 2.0 * (z2 + z3) + z4),
        phi_dot + dt / 6.0 * (p1 + 2.0 * (p2 + p3) + p4),
    )


@kernel
def linearise(phi, phi_dot, force, plant, cart_row, pole_row):
    """Write the derivatives of z'' and phi'' with respect to the states, Eq. (E3).

    phi, phi_dot: Pole angle [rad] and its rate [rad/s].
    force: Force on the cart [N].
    """
    cart_mass, pole_mass, half_length, gravity = plant
    sin, cos = np.sin(phi), np.cos(phi)
    cart, pole = accelerations(phi, phi_dot, force, plant)
    inertia = (cart_mass + pole_mass) - 0.75 * pole_mass * cos * cos
    lever = pole_mass * half_length * phi_dot
    weight = 0.75 * pole_mass * gravity * (cos * cos - sin * sin)
    cart_row[0] = cart_row[2] = pole_row[0] = 0.0
    cart_row[1] = (weight - lever * phi_dot * cos - 1.5 * pole_mass * sin * cos * cart) / inertia
    cart_row[3] = -2.0 * lever * sin / inertia
    cart_row[4] = -cart_mass * cart / inertia
    cart_row[5] = -lever * phi_dot * sin / inertia
    coupling = 0.75 / half_length * cos
    for i in range(1, STATES):
        pole_row[i] = coupling * cart_row[i]
    pole_row[1] += 0.75 / half_length * (gravity * cos - cart * sin)
    pole_row[5] -= pole
    return coupling, cart, pole


@kernel
def fill_transition(cart_row, pole_row, dt, transition):
    """Write the transition matrix I + A dt + (A dt)^2 / 2 of the six states, Eq. (E4).

    dt: Length of the step [s].
    transition: Written, shape (6, 6).
    """
    half = 0.5 * dt * dt
    cart_by_phi, cart_by_rate = cart_row[1], cart_row[3]
    pole_by_phi, pole_by_rate = pole_row[1], pole_row[3]
    transition[:] = 0.0
    for j in range(STATES):
        transition[j, j] = 1.0
    for j in range(STATES):
        transition[0, j] += half * cart_row[j]
        transition[1, j] += half * pole_row[j]
        transition[2, j] += dt * cart_row[j] + half * cart_by_rate * pole_row[j]
        transition[3, j] += dt * pole_row[j] + half * pole_by_rate * pole_row[j]
    transition[0, 2] += dt
    transition[1, 3] += dt
    transition[2, 3] += half * cart_by_phi
    transition[3, 3] += half * pole_by_phi
