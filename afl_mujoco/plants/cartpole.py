"""The cart-pole of the paper as a plant: (P3) and (P4) are the equations of its MJCF."""

from __future__ import annotations

import math
from importlib import resources
from pathlib import Path
from typing import Any

from afl_mujoco.plant.dynamics import cart_acceleration, pole_acceleration
from afl_mujoco.plants.plant import Parameter, Plant, box, rod


def accelerations(q: Any, v: Any, u: Any, p: Any) -> tuple[Any, Any]:
    """Return (z'', phi''), Eqs. (P3) and (P4)."""
    given = (q[1], v[1], u[0], p.cart_mass, p.pole_mass, p.half_length, p.gravity)
    return cart_acceleration(*given), pole_acceleration(*given)


def write(p: Any) -> dict[str, Any]:
    """Return what M, m, l and g are in the MJCF; a hundredth of the inertia is about the pole."""
    length = 2.0 * p.half_length
    radius = p.half_length * math.sqrt(0.02 / 3.0)
    return {
        "body cart": box(mass=p.cart_mass, lengths=(0.4, 0.3, 0.2)),
        "body pole": rod(mass=p.pole_mass, length=length, radius=radius),
        "geom pole size 1": p.half_length,
        "geom pole pos 2": p.half_length,
        "site tip pos 2": length,
        "option gravity 2": -p.gravity,
    }


def _model() -> Path:
    """Return the path of the MJCF, in an installed wheel or in the source tree."""
    packaged = Path(str(resources.files("afl_mujoco") / "models" / "cartpole.xml"))
    return packaged if packaged.exists() else packaged.parents[2] / "models" / "cartpole.xml"


plant = Plant(
    name="cart-pole",
    model=_model(),
    coordinates=("z", "phi"),
    inputs=("force",),
    parameters={
        "cart_mass": Parameter(1.0, "kg", low=0.1, high=2.0),
        "pole_mass": Parameter(0.05, "kg", low=0.01, high=1.0),
        "half_length": Parameter(0.5, "m", low=0.05, high=1.0),
        "gravity": Parameter(9.81, "m/s^2", low=1.0, high=20.0),
    },
    write=write,
    accelerations=accelerations,
    upright=(0.0, 0.0),
    wraps=("phi",),
)
