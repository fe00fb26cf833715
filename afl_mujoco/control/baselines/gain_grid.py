"""Gains of a state feedback by plant: a table over M and l."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from afl_mujoco.control.compiled_controller import interpolated_gains
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.parameters import PlantRange

GAIN_COUNT = 4


@dataclass(frozen=True, slots=True, eq=False)
class GainGrid:
    """Gains of (z, phi, z_dot, phi_dot) at the nodes of a grid over M and l.

    Attributes
    ----------
    masses, lengths
        Nodes M [kg] and l [m], positive and increasing; a single node applies to every M or l.
    table
        Gains at the nodes, shape (len(masses), len(lengths), 4), read-only.

    Raises
    ------
    InvalidValueError
        If a value breaks its rule.
    """

    masses: NDArray[np.float64]
    lengths: NDArray[np.float64]
    table: NDArray[np.float64]

    def __post_init__(self) -> None:
        """Check the arrays and freeze them."""
        for name in ("masses", "lengths", "table"):
            try:
                array = np.array(getattr(self, name), dtype=np.float64)
            except (TypeError, ValueError):
                raise InvalidValueError(f"{name} of the gain grid", "must be numbers") from None
            if not np.isfinite(array).all():
                raise InvalidValueError(f"{name} of the gain grid", "must be finite")
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        for name, nodes in (("masses", self.masses), ("lengths", self.lengths)):
            if nodes.ndim != 1 or not len(nodes) or np.any(np.diff(nodes, prepend=0.0) <= 0.0):
                rule = "must be positive and increasing"
                raise InvalidValueError(f"{name} of the gain grid", rule, nodes.tolist())
        shape = (len(self.masses), len(self.lengths), GAIN_COUNT)
        if self.table.shape != shape:
            raise InvalidValueError("table of gains", f"must have shape {shape}", self.table.shape)

    @classmethod
    def constant(cls, gains: ArrayLike) -> GainGrid:
        """Return the grid that always gives the same gains.

        Parameters
        ----------
        gains
            Gains of (z, phi, z_dot, phi_dot) [N/m, N/rad, N s/m, N s/rad], or [1/s^2,
            m/(rad s^2), 1/s, m/(rad s)] for state feedback through (L1).
        """
        k = tuple(gains) if isinstance(gains, Iterable) else (gains,)
        if len(k) != GAIN_COUNT:
            raise InvalidValueError("gains", "must be four", len(k))
        return cls(np.ones(1), np.ones(1), np.array([[k]]))

    def over(self, plants: PlantRange) -> GainGrid:
        """Return the grid itself, or raise InvalidValueError if plants lie beyond its nodes."""
        axes = (("M", "kg", self.masses, plants.cart_mass), ("l", "m", self.lengths, plants[1]))
        for name, unit, nodes, ends in axes:
            least, largest = nodes[0] * (1.0 - SLACK), nodes[-1] * (1.0 + SLACK)
            for value in ends:
                if len(nodes) > 1 and not least <= value <= largest:
                    rule = f"must lie within its nodes, {nodes[0]:g} to {nodes[-1]:g} {unit}"
                    raise InvalidValueError(f"{name} for the gain grid", rule, f"{value:g} {unit}")
        return self

    def gains(self, cart_mass: float, half_length: float) -> NDArray[np.float64]:
        """Return the gains for one plant, shape (4,), NaN beyond the nodes.

        Parameters
        ----------
        cart_mass, half_length
            M [kg] and l [m].
        """
        arrays = (self.table.copy(), self.masses.copy(), self.lengths.copy())
        return np.array(interpolated_gains(*arrays, float(cart_mass), float(half_length)))


SLACK = 1e-10
"""Relative amount by which round-off may pass an end node; `interpolated_gains` allows more."""
