"""Sliding mode in the linearising coordinates: (L8)-(L10).

`coordinates` are the values (xi1, xi2, xi3, xi4) of (L2)-(L5). The functions take floats or arrays
and can be compiled.
"""

from __future__ import annotations

import numpy as np
from numba.extending import register_jitable


@register_jitable
def sliding_surface(xi_1, xi_2, xi_3, xi_4, slope):
    """Return s = (d/dt + lambda)^3 xi1 [m/s^3], Eq. (L8)."""
    return xi_4 + slope * (3.0 * xi_3 + slope * (3.0 * xi_2 + slope * xi_1))


@register_jitable
def surface_drift(alpha, xi_2, xi_3, xi_4, slope):
    """Return a, the part of s' without the input [m/s^4], first half of Eq. (L9)."""
    return alpha + slope * (3.0 * xi_4 + slope * (3.0 * xi_3 + slope * xi_2))


@register_jitable
def saturation(x):
    """Return sat(x) = clip(x, -1, 1)."""
    return np.minimum(np.maximum(x, -1.0), 1.0)


@register_jitable
def commanded_acceleration(surface, drift, input_gain, switching, boundary_layer):
    """Return u = -a/b + K sat(s/Phi) [m/s^2], Eq. (L10), with b = beta of (L7)."""
    return -drift / input_gain + switching * saturation(surface / boundary_layer)
