"""Schedules drawn at random over the paper's box of parameters, shaped like those of its cases."""

from __future__ import annotations

CART_MASS_RANGE, HALF_LENGTH_RANGE = (0.1, 2.0), (0.05, 1.0)
"""The paper's box of M [kg] and l [m]."""

LAST_CHANGE = 10.0
"""Changes begin and end within this [s]; the horizon is twice as long."""

GRID = 1e-3
"""Instants of change are multiples of this [s]."""
