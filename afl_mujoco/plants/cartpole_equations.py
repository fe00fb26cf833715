"""The cart-pole with its equations: (P3) and (P4) are what its MJCF has to obey."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from afl_mujoco.plant.dynamics import cart_acceleration, pole_acceleration
from afl_mujoco.plants.cartpole import CART_POLE


def accelerations(q: Any, v: Any, u: Any, p: Any) -> tuple[Any, Any]:
    """Return (z'', phi''), Eqs. (P3) and (P4)."""
    given = (q[1], v[1], u[0], p.cart_mass, p.pole_mass, p.half_length, p.gravity)
    return cart_acceleration(*given), pole_acceleration(*given)


plant = replace(CART_POLE, accelerations=accelerations, origin="cart-pole")
