"""The names and parameters of the plant, and how a run changes them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.plants.plant import Floats
from afl_mujoco.values import Checked, Positive

COORDINATES = MappingProxyType({"z": "m", "phi": "rad"})  # the coordinates and their units

RATES = MappingProxyType({f"{name}_dot": f"{unit}/s" for name, unit in COORDINATES.items()})
"""The rates of the coordinates and their units."""

STATE = MappingProxyType({**COORDINATES, **RATES})  # the state and its units

GREEK = {
    "alpha": "α", "beta": "β", "gamma": "γ", "delta": "δ", "theta": "θ", "phi": "φ", "psi": "ψ",
    "omega": "ω",
}  # fmt: skip


def symbol(name: str) -> str:
    """Return a name of a state, an input or a signal as a report writes it."""
    whole, prime = name.removesuffix("_dot"), "′" if name.endswith("_dot") else ""
    return f"{GREEK.get(whole, whole)}{prime}"


def from_target(name: str, target: float) -> str:
    """Return what is said of a deviation, such as α − 0.5; of one from 0 the symbol alone."""
    sign = "−" if target > 0.0 else "+"
    return f"{symbol(name)} {sign} {abs(target):.4g}" if target else symbol(name)


def labelled(name: str, unit: str) -> str:
    """Return a name as a report writes it with its unit, if it has one."""
    return f"{symbol(name)} [{unit}]" if unit else symbol(name)


SCHEDULES = MappingProxyType({"cart_mass": "kg", "half_length": "m"})
"""The parameters that may change during a run, and their units."""

CONSTANTS = MappingProxyType({"pole_mass": "kg", "gravity": "m/s²"})
"""The other parameters of the plant, and their units."""

LARGEST_STATE = 1e6  # in SI units; a run with a larger state counts as diverged


LARGEST_START_ANGLE = 2.0 * math.pi  # from which a run may start [rad]: a whole turn


def require_start_angle(thing: str, phi: float) -> None:
    """Raise if an angle [rad] is more than a turn, as one in degrees by mistake."""
    if abs(phi) > LARGEST_START_ANGLE:
        hint = f"{phi:g} degrees is {math.radians(phi):.4f} rad"
        raise InvalidValueError(thing, f"must lie in -2 pi to 2 pi rad ({hint})", f"{phi:g}")


@dataclass(frozen=True, slots=True, kw_only=True)
class CartPoleParameters(Checked):
    """Parameters of a cart with a uniform rod hinged on it (decision D1).

    Attributes
    ----------
    cart_mass
        Mass M of the cart [kg].
    pole_mass
        Mass m of the pole [kg].
    half_length
        Distance l from the pivot to the pole's centre of mass [m]; the rod is 2 l long.
    gravity
        Gravitational acceleration g [m/s^2], pointing down.

    Raises
    ------
    InvalidValueError
        If a value is not a positive finite number.
    """

    cart_mass: Positive = 1.0
    pole_mass: Positive = 0.05
    half_length: Positive = 0.5
    gravity: Positive = 9.81


NOMINAL = CartPoleParameters()  # the plant of the paper's fixed gains
CART_MASSES = tuple(k / 10 for k in range(1, 21))  # M [kg] of the paper's grid of plants
HALF_LENGTHS = tuple(k / 20 for k in range(1, 21))  # l [m] of the paper's grid of plants


class PlantRange(NamedTuple):
    """The plants of a run: least and largest M [kg] and l [m], and m [kg] and g [m/s^2]."""

    cart_mass: tuple[float, float]
    half_length: tuple[float, float]
    pole_mass: float
    gravity: float

    @classmethod
    def of(cls, plant: CartPoleParameters) -> PlantRange:
        """Return the range that holds one plant."""
        p = plant
        return cls((p.cart_mass,) * 2, (p.half_length,) * 2, p.pole_mass, p.gravity)

    def grid(self, count: int) -> Floats:
        """Return evenly spaced plants, in rows of M, m, l, g, shape (count^2, 4)."""
        masses, lengths = (np.linspace(*ends, count) for ends in self[:2])
        axes = np.meshgrid(masses, self.pole_mass, lengths, self.gravity)
        return np.column_stack([one.ravel() for one in axes])
