"""Gains of the paper's controller: constants, and functions of M and l (G1)."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from importlib import resources
from importlib.resources.abc import Traversable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.compiled import jitable
from afl_mujoco.errors import InvalidValueError, reading
from afl_mujoco.scenario.parameters import CART_MASSES, HALF_LENGTHS, PlantRange
from afl_mujoco.values import Checked, Positive, require_finite, require_type


@dataclass(frozen=True, slots=True, kw_only=True)
class Gains(Checked):
    """Gains of the sliding-mode controller, Eq. (L10).

    Attributes
    ----------
    switching
        Switching gain K [m/s^2].
    slope
        Slope lambda of the sliding surface [1/s].
    boundary_layer
        Width Phi of the boundary layer, in the unit of the sliding variable [m/s^3].

    Raises
    ------
    InvalidValueError
        If a value is not a positive finite number.
    """

    switching: Positive
    slope: Positive
    boundary_layer: Positive


FIXED_GAINS = Gains(switching=109.9651, slope=1.2849, boundary_layer=100.0004)
"""The paper's constants, tuned for M = 1 kg, l = 0.5 m, m = 0.05 kg; K and Phi as Table 2 and the
text name them, not as the header of Table 1 does (decision D2)."""


GAIN_NAMES = ("switching", "slope", "boundary_layer")


@jitable
def scheduled_gain(cart_mass, half_length, w):
    """Return one gain C = w1 + w2 M^w3 + w4 l^w5, Eq. (G1), for floats or arrays M [kg], l [m]."""
    gain = w[0]
    if w[1] != 0.0:
        gain = gain + w[1] * cart_mass ** w[2]
    if w[3] != 0.0:
        gain = gain + w[3] * half_length ** w[4]
    return gain


def shipped_file(name: str) -> Traversable:
    """Return a data file of the package."""
    return resources.files("afl_mujoco.control") / "data" / name


def shipped_data(name: str) -> Any:
    """Return the content of a data file of the package."""
    file = shipped_file(name)
    with reading(file, "is not JSON"):
        return json.loads(file.read_text(encoding="utf-8"))


@dataclass(frozen=True, slots=True, kw_only=True)
class GainFunction:
    """Coefficients (w1, ..., w5) of (G1), one set for each gain.

    Attributes
    ----------
    switching, slope, boundary_layer
        Coefficients for K, lambda and Phi.
    """

    switching: tuple[float, ...]
    slope: tuple[float, ...]
    boundary_layer: tuple[float, ...]

    def __post_init__(self) -> None:
        for name in GAIN_NAMES:
            require_type(f"{name} coefficients", getattr(self, name), Iterable)
            w = tuple(require_finite(f"{name} coefficients", x) for x in getattr(self, name))
            if len(w) != 5:
                raise InvalidValueError(f"{name} coefficients", "must be five", len(w))
            object.__setattr__(self, name, w)

    @classmethod
    def constant(cls, gains: Gains) -> GainFunction:
        """Return the gain function that always gives `gains`.

        Parameters
        ----------
        gains
            The constant gains.
        """
        return cls(**{name: (getattr(gains, name), 0.0, 0.0, 0.0, 0.0) for name in GAIN_NAMES})

    @classmethod
    def published(cls) -> GainFunction:
        """Return the paper's coefficients, Table 2.

        Raises
        ------
        FileError
            If the package's data file is missing or malformed.
        """
        return cls._shipped("gain_function.json")

    @classmethod
    def retuned(cls) -> GainFunction:
        """Return the coefficients fitted to the package's own gain table, with lambda damped.

        Raises
        ------
        FileError
            If the package's data file is missing or malformed.
        """
        return cls._shipped("gain_functions.json")

    @classmethod
    def _shipped(cls, name: str) -> GainFunction:
        table = shipped_data(name)
        with reading(name, "is not a gain function"):
            return cls(**{gain: tuple(table["coefficients"][gain]) for gain in GAIN_NAMES})

    @property
    def is_constant(self) -> bool:
        """Whether the gains are the same for every plant."""
        return not self.coefficients[:, 1:].any()

    @property
    def coefficients(self) -> NDArray[np.float64]:
        """The coefficients as an array, shape (3, 5): rows K, lambda, Phi."""
        return np.array([getattr(self, name) for name in GAIN_NAMES])

    def gains(self, cart_mass: float, half_length: float) -> Gains:
        """Return the gains for one plant, Eq. (G1).

        Parameters
        ----------
        cart_mass, half_length
            M [kg] and l [m].

        Raises
        ------
        InvalidValueError
            If a gain is not positive.
        """
        return Gains(
            **{
                name: scheduled_gain(cart_mass, half_length, getattr(self, name))
                for name in GAIN_NAMES
            }
        )


def beyond_table(plants: PlantRange) -> list[tuple[str, str]]:
    """Return where plants lie beyond the table: what it covers, and what is reached, in words."""
    axes = (
        ("M", "kg", CART_MASSES, plants.cart_mass),
        ("l", "m", HALF_LENGTHS, plants.half_length),
    )
    return [
        (f"{symbol} {nodes[0]:g} to {nodes[-1]:g} {unit}", f"{symbol} reaches {far:g} {unit}")
        for symbol, unit, nodes, ends in axes
        for far, beyond in ((ends[0], ends[0] < nodes[0]), (ends[1], ends[1] > nodes[-1]))
        if beyond
    ]
