"""The cart-pole of the paper: its names, and what its parameters are in the MJCF.

Its equations are in `cartpole_equations`, where nothing that puts it into MuJoCo can see them.
"""

from __future__ import annotations

import math
from importlib import resources
from pathlib import Path
from typing import Any

from afl_mujoco.plants.plant import Parameter, Plant, Shape, known_as

CART_HALF_SIZE = (0.2, 0.15, 0.1)
"""Half-size of the cart's box [m]; its inertia is that of a uniform box, but it never rotates."""

AXIAL_SHARE = 0.01
"""Inertia about the pole's own axis, about which it never rotates, as a share of that across it."""

FALL_ANGLE = 0.5 * math.pi - 1e-3
"""A run ends as fallen when ``|phi|`` reaches this [rad]: the controller is singular at pi/2."""


def model_file(name: str) -> Path:
    """Return the path of a file of `models/`, in an installed wheel or in the source tree."""
    packaged = Path(str(resources.files("afl_mujoco") / "models" / name))
    return packaged if packaged.exists() else packaged.parents[2] / "models" / name


def capsule_inertia(mass: Any, half_length: Any, radius: float) -> Any:
    """Return the inertia across a uniform solid capsule, about its middle [kg m^2]."""
    length = 2.0 * half_length
    caps = mass * (4.0 * radius) / (4.0 * radius + 3.0 * length)  # volumes without pi r^2 / 3
    barrel = mass - caps
    return barrel * (radius * radius / 4.0 + length * length / 12.0) + caps * (
        0.4 * radius * radius + length * length / 4.0 + 0.375 * length * radius
    )


def write(p: Any) -> dict[str, Any]:
    """Return what M, m, l and g are in the MJCF, a share of m a point at the tip, the rest at l."""
    m, length, share = p.pole_mass, p.half_length, getattr(p, "tip_mass_share", 0.0)
    radius = getattr(p, "pole_radius", 0.0)
    x2, y2, z2 = (half * half for half in CART_HALF_SIZE)
    across = m * length * length / 3.0
    if radius > 0.0:
        across = capsule_inertia(m, length, radius)
    across = (1.0 - share) * across + share * (1.0 - share) * m * length * length
    sums = (y2 + z2, x2 + z2, x2 + y2)
    inertia = tuple(p.cart_mass * (one / 3.0) for one in sums)
    grown = 0.75 + 0.25 * p.cart_mass  # width and depth of the drawing, linear as M is: no physics
    return {
        "body cart": Shape(p.cart_mass, (0.0, 0.0, 0.0), (inertia[0], inertia[1], inertia[2])),
        "body pole": Shape(
            m, (0.0, 0.0, (1.0 + share) * length), (across, across, AXIAL_SHARE * across)
        ),
        "geom cart size 0": CART_HALF_SIZE[0] * grown,
        "geom cart size 1": CART_HALF_SIZE[1] * grown,
        "geom pole size 1": length,
        "geom pole pos 2": length,
        "site tip pos 2": 2.0 * length,
        "option gravity 2": -p.gravity,
    }


CART_POLE = known_as(
    Plant(
        name="cart-pole",
        model=model_file("cartpole.xml"),
        coordinates=("z", "phi"),
        inputs=("force",),
        parameters={
            "cart_mass": Parameter(1.0, "kg", low=0.1, high=2.0),
            "pole_mass": Parameter(0.05, "kg", low=0.01, high=1.0),
            "half_length": Parameter(0.5, "m", low=0.05, high=1.0),
            "gravity": Parameter(9.81, "m/s²", low=1.0, high=20.0),
        },
        write=write,
        upright=(0.0, 0.0),
        wraps=("phi",),
        start=(0.0, -math.pi / 3, 0.0, 0.0),
        ends_at={"phi": FALL_ANGLE},
        details={"tip_mass_share": 0.0, "pole_radius": 0.0},
    ),
    "afl_mujoco.plants.cartpole:CART_POLE",
)
"""The plant of a scenario that names none."""


def has_its_names(plant: Plant) -> bool:
    """Return whether a plant has the states and the parameters of the cart-pole."""
    own = CART_POLE
    return plant.states == own.states and [*plant.parameters] == [*own.parameters]
