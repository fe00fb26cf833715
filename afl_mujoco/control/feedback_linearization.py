"""Approximate feedback linearisation: the input map (L1) and the coordinates (L2)-(L7).

Plain functions of floats or arrays that also compile. They are singular at ``|phi| = pi/2``;
callers keep away from it. Units: `phi` rad, `phi_dot` rad/s, `half_length` l m, `gravity` g m/s^2.
"""

# One-letter and Greek names are the paper's; every function is one numbered equation.
from __future__ import annotations

import numpy as np
from numba.extending import register_jitable


@register_jitable
def linearizing_force(u, phi, phi_dot, cart_mass, pole_mass, half_length, gravity):
    """Return the force F [N] that makes z'' = u and phi'' = 3/(4l) (g sin + u cos), Eq. (L1)."""
    sin, cos = np.sin(phi), np.cos(phi)
    inertia = (cart_mass + pole_mass) - 0.75 * pole_mass * cos**2
    centripetal = pole_mass * half_length * phi_dot**2 * sin
    return inertia * u + centripetal - 0.75 * pole_mass * gravity * sin * cos


@register_jitable
def xi1(z, phi, half_length):
    """Return the output coordinate xi1 [m], Eq. (L2), ln((1 + sin)/cos) written as arcsinh(tan).

    The two are equal; the second is odd to the last bit and has no cancellation near -pi/2.
    """
    return z - 4.0 / 3.0 * half_length * np.arcsinh(np.sin(phi) / np.cos(phi))


@register_jitable
def xi2(z_dot, phi, phi_dot, half_length):
    """Return xi2 = xi1' [m/s], Eq. (L3)."""
    return z_dot - 4.0 / 3.0 * half_length * phi_dot / np.cos(phi)


@register_jitable
def xi3(phi, phi_dot, half_length, gravity):
    """Return xi3 = xi2' [m/s^2], Eq. (L4)."""
    sin, cos = np.sin(phi), np.cos(phi)
    return -sin / cos * (gravity + 4.0 / 3.0 * half_length * phi_dot**2 / cos)


@register_jitable
def xi4(phi, phi_dot, half_length, gravity):
    """Return xi4 [m/s^3], Eq. (L5): xi3' without its term -2 phi' tan(phi) u."""
    cos = np.cos(phi)
    square = cos * cos
    cubic = 4.0 / 3.0 * half_length * (2.0 / square - 1.0) / cos
    return -(cubic * phi_dot**2 + (3.0 / square - 2.0) * gravity) * phi_dot


@register_jitable
def alpha(phi, phi_dot, half_length, gravity):
    """Return the drift alpha of xi4' [m/s^4], Eq. (L6)."""
    sin, cos = np.sin(phi), np.cos(phi)
    square = cos * cos
    rate2 = phi_dot * phi_dot
    quartic = 4.0 / 3.0 * half_length * sin / square * (6.0 / square - 1.0)
    quadratic = 3.0 * gravity * sin / cos * (4.0 / square - 1.0)
    constant = 0.75 * gravity**2 / half_length * sin * (2.0 - 3.0 / square)
    return constant - (quartic * rate2 + quadratic) * rate2


@register_jitable
def beta(phi, phi_dot, half_length, gravity):
    """Return the input gain beta of xi4' [1/s^2], Eq. (L7); negative near upright."""
    cos = np.cos(phi)
    rate_part = 3.0 * phi_dot**2 * (1.0 - 2.0 / (cos * cos))
    return rate_part - 0.75 * gravity / half_length * (3.0 / cos - 2.0 * cos)
