"""The cart-pole's description before MuJoCo compiles it: its file, its sizes, its inertias."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from numba.extending import register_jitable
from numpy.typing import NDArray

from afl_mujoco.scenario.imperfections import Imperfections
from afl_mujoco.scenario.parameters import CartPoleParameters

CART_HALF_SIZE = (0.2, 0.15, 0.1)
"""Half-size of the cart's box [m]; its inertia is that of a uniform box, but it never rotates."""

POLE_RADIUS = 0.02
"""Radius of the drawn pole [m]; by default the pole of the physics is a slender rod."""

AXIAL_SHARE = 0.01
"""Inertia about the pole's own axis, about which it never rotates, as a share of that across it."""


FRICTION_SOLREF, FRICTION_SOLIMP = (0.004, 1.0), (0.99, 0.9999, 0.001, 0.5, 2.0)
"""Constraint of dry friction: below break-away the cart creeps at some 1e-5 m/s."""

STOP_SOLREF = (0.005, 1.0)
"""Constraint of the end stops [s, 1]: stiffer than MuJoCo's default, critically damped."""

PASSIVE = (
    *("dof_damping", "dof_armature", "dof_frictionloss", "dof_solref", "dof_solimp"),
    *("jnt_limited", "jnt_range", "jnt_solref"),
)
"""Fields of MjModel that hold the passive physics."""


def model_file(name: str) -> Path:
    """Return the path of a file of `models/`, in an installed wheel or in the source tree."""
    packaged = Path(str(resources.files("afl_mujoco") / "models" / name))
    return packaged if packaged.exists() else packaged.parents[2] / "models" / name


@register_jitable
def capsule_inertia(mass, half_length, radius):
    """Return the inertia across a uniform solid capsule, about its middle [kg m^2].

    mass: Its mass [kg].
    half_length, radius: Half the length of its cylinder, and the radius of cylinder and end caps
        [m].
    """
    length = 2.0 * half_length
    caps = mass * (4.0 * radius) / (4.0 * radius + 3.0 * length)  # volumes without pi r^2 / 3
    barrel = mass - caps
    return barrel * (radius * radius / 4.0 + length * length / 12.0) + caps * (
        0.4 * radius * radius + length * length / 4.0 + 0.375 * length * radius
    )


@register_jitable
def pole_inertia(rod, pole_mass, half_length, tip_share, radius):
    """Return the pole's inertia across it, about its own centre of mass [kg m^2].

    A share of the mass is a point at the tip, the rest a rod or capsule centred at `half_length`;
    the centre of mass lies at ``(1 + tip_share) half_length``.

    rod: Inertia of the whole mass as a slender rod [kg m^2], the result without share and radius.
    pole_mass, half_length: m [kg] and l [m].
    """
    if radius > 0.0:
        rod = capsule_inertia(pole_mass, half_length, radius)
    between = tip_share * (1.0 - tip_share) * pole_mass * half_length * half_length
    return (1.0 - tip_share) * rod + between


def describe(spec: Any, p: CartPoleParameters) -> None:
    """Write the parameters of the ideal plant into the description that is about to be compiled."""
    x2, y2, z2 = (half * half for half in CART_HALF_SIZE)
    rod = p.pole_mass * p.half_length * p.half_length / 3.0
    cart, pole, geom = spec.body("cart"), spec.body("pole"), spec.geom("pole")
    cart.mass = p.cart_mass
    cart.inertia = [p.cart_mass * (sum_ / 3.0) for sum_ in (y2 + z2, x2 + z2, x2 + y2)]
    pole.mass = p.pole_mass
    pole.inertia = [rod, rod, AXIAL_SHARE * rod]
    pole.ipos = [0.0, 0.0, p.half_length]
    spec.geom("cart").size = CART_HALF_SIZE
    geom.size = [POLE_RADIUS, p.half_length, 0.0]
    geom.pos = [0.0, 0.0, p.half_length]
    spec.site("tip").pos = [0.0, 0.0, 2.0 * p.half_length]
    spec.option.gravity = [0.0, 0.0, -p.gravity]


def passive_arrays(
    compiled: Mapping[str, NDArray[Any]], imperfections: Imperfections, slider: Any, hinge: Any
) -> dict[str, NDArray[Any]]:
    """Return the fields of MjModel with the passive physics of `imperfections`."""
    arrays, r = {name: array.copy() for name, array in compiled.items()}, imperfections
    z, phi = slider.dofadr[0], hinge.dofadr[0]
    arrays["dof_damping"][[z, phi]] += r.rail_damping, r.hinge_damping
    arrays["dof_armature"][[z, phi]] += r.rail_armature, r.hinge_armature
    for dof, friction in ((z, r.rail_friction), (phi, r.hinge_friction)):
        if friction > 0.0:
            arrays["dof_frictionloss"][dof] += friction
            arrays["dof_solref"][dof], arrays["dof_solimp"][dof] = FRICTION_SOLREF, FRICTION_SOLIMP
    if r.rail_half_length is not None:
        arrays["jnt_limited"][slider.id] = True
        arrays["jnt_range"][slider.id] = -r.rail_half_length, r.rail_half_length
        arrays["jnt_solref"][slider.id] = STOP_SOLREF
    return arrays
