"""The closed loop on a constant plant without transcendental functions; its tail in closed form.

By (L1) the closed loop has ``z'' = u`` and ``phi'' = 3/(4l) (g sin + u cos)``, so that M enters
only the force. With ``tau = tan(phi)`` and ``sigma = ln((1 + sin)/cos)`` integrated along with z,
one square root and one division remain. The batch integrates this form; the equations as the paper
writes them are in `control.feedback_linearization`, and tests compare the two.
"""

from __future__ import annotations

import math

from numba.extending import register_jitable


@register_jitable(forceinline=True)
def reduced_slopes(
    z, z_dot, sigma, tau, phi_dot, lever, lever_inverse, gravity, switching, slope, layer_inverse
):
    """Return u, phi'', sigma', tau', s, xi1, xi2, xi3 and cos(phi) of the closed loop, (L1)-(L10).

    Parameters
    ----------
    z, z_dot, sigma, tau, phi_dot
        The state.
    lever, lever_inverse
        4 l / 3 [m], and its inverse.
    gravity, switching, slope, layer_inverse
        g, K, lambda and 1 / Phi.
    """
    g, rate2 = gravity, phi_dot * phi_dot
    sec2 = 1.0 + tau * tau
    sec = math.sqrt(sec2)
    beta_sec = 3.0 * rate2 * sec * (1.0 - 2.0 * sec2) - g * lever_inverse * (3.0 * sec2 - 2.0)
    shared = 1.0 / (sec2 * beta_sec)  # the one division: 1 / cos^-1 and 1 / beta from it
    cos, beta_inverse = sec * beta_sec * shared, sec2 * sec * shared
    xi1 = z - lever * sigma
    xi2 = z_dot - lever * phi_dot * sec
    xi3 = -tau * (g + lever * rate2 * sec)
    xi4 = -(lever * (2.0 * sec2 - 1.0) * sec * rate2 + (3.0 * sec2 - 2.0) * g) * phi_dot
    quadratic = lever * tau * sec * (6.0 * sec2 - 1.0) * rate2 + 3.0 * g * tau * (4.0 * sec2 - 1.0)
    alpha = g * g * lever_inverse * tau * cos * (2.0 - 3.0 * sec2) - quadratic * rate2
    surface = xi4 + slope * (3.0 * xi3 + slope * (3.0 * xi2 + slope * xi1))
    drift = alpha + slope * (3.0 * xi4 + slope * (3.0 * xi3 + slope * xi2))
    saturated = min(1.0, max(-1.0, surface * layer_inverse))
    u = switching * saturated - drift * beta_inverse
    phi_ddot = (g * tau + u) * cos * lever_inverse
    return u, phi_ddot, phi_dot * sec, phi_dot * sec2, surface, xi1, xi2, xi3, cos


@register_jitable(forceinline=True)
def reduced_force(u, tau, phi_dot, cos, cart_mass, pole_mass, lever, gravity):
    """Return the force [N] of Eq. (L1)."""
    inertia = cart_mass + pole_mass - 0.75 * pole_mass * cos * cos
    return inertia * u + 0.75 * pole_mass * tau * cos * (lever * phi_dot * phi_dot - gravity * cos)


@register_jitable(forceinline=True)
def tail_bound(xi1, xi2, xi3, slope):
    """Return a bound on the future ``g abs(phi)`` on the surface s = 0, nearly upright."""
    first = xi2 + slope * xi1
    second = xi3 + slope * (first + xi2)
    linear, square = abs(slope * first - 2.0 * second), abs(second)
    return abs(xi3) + 0.368 * linear + 0.271 * square  # t e^-t < 0.368, t^2 e^-t / 2 < 0.271


@register_jitable(forceinline=True)
def tail_integrals(xi1, xi2, xi3, slope, lever, gravity, duration):
    """Return the integrals of abs(z) and abs(phi) over the rest of a run that is nearly upright.

    There ``s = (d/dt + lambda)^3 xi1 = 0`` and ``xi3 = -g phi``: xi1 and phi are parabolas times
    ``exp(-lambda t)``, and so is ``z = xi1 + (4l/3) phi``.

    Parameters
    ----------
    xi1, xi2, xi3
        Where the tail starts.
    slope, lever, gravity
        lambda, 4 l / 3 and g.
    duration
        Length of the tail [s].
    """
    first = xi2 + slope * xi1
    second = xi3 + slope * (first + xi2)
    phi0 = -xi3 / gravity
    phi1 = -slope * (slope * first - 2.0 * second) / gravity
    phi2 = -slope * slope * second / gravity
    iae_phi = _absolute_integral(phi0, phi1, phi2, slope, duration)
    iae_z = _absolute_integral(
        xi1 + lever * phi0, first + lever * phi1, second + lever * phi2, slope, duration
    )
    return iae_z, iae_phi


@register_jitable(forceinline=True)
def _absolute_integral(c0, c1, c2, slope, duration):
    """Return the integral of ``abs(c0 + c1 t + c2 t^2 / 2) exp(-slope t)`` over the duration."""
    first_root = second_root = -1.0
    discriminant = c1 * c1 - 2.0 * c2 * c0
    if discriminant > 0.0:
        q = -(c1 + math.copysign(math.sqrt(discriminant), c1))
        roots = (q / c2 if c2 != 0.0 else -1.0), (2.0 * c0 / q if q != 0.0 else -1.0)
        first_root, second_root = min(roots[0], roots[1]), max(roots[0], roots[1])
    total, start = 0.0, 0.0
    for end in (first_root, second_root, duration):
        end = min(end, duration)
        if end > start:
            total += abs(_primitive(c0, c1, c2, slope, end) - _primitive(c0, c1, c2, slope, start))
            start = end
    return total


@register_jitable(forceinline=True)
def _primitive(c0, c1, c2, slope, t):
    """Return a primitive of ``(c0 + c1 t + c2 t^2 / 2) exp(-slope t)``."""
    parabola, derivative = c0 + t * (c1 + 0.5 * c2 * t), c1 + c2 * t
    return -(parabola + (derivative + c2 / slope) / slope) / slope * math.exp(-slope * t)


@register_jitable(forceinline=True)
def absolute_area(f0, f1, d0, d1, h):
    """Return the integral of the absolute value of a cubic over a step, split where it crosses 0.

    Parameters
    ----------
    f0, f1, d0, d1
        Values and derivatives at both ends (Hermite).
    h
        The step.
    """
    whole = h * (0.5 * (f0 + f1) + h * (d0 - d1) * (1.0 / 12.0))
    crosses = f0 * f1 < 0.0
    a1, a2, a3 = h * d0, 3.0 * (f1 - f0) - h * (2.0 * d0 + d1), 2.0 * (f0 - f1) + h * (d0 + d1)
    root = f0 / (f0 - f1 if crosses else 1.0)  # followed by one step of Newton's method
    value = f0 + root * (a1 + root * (a2 + root * a3))
    steepness = a1 + root * (2.0 * a2 + 3.0 * root * a3)
    root = min(1.0, max(0.0, root - value / (steepness if crosses else 1.0)))
    part = h * root * (f0 + root * (0.5 * a1 + root * (a2 * (1.0 / 3.0) + root * 0.25 * a3)))
    return abs(part) + abs(whole - part) if crosses else abs(whole)
