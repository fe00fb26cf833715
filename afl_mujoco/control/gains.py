"""Gains of the sliding-mode controller, and the paper's constants for them."""

from __future__ import annotations

from dataclasses import dataclass, fields

from afl_mujoco.scenario.parameters import require_positive


@dataclass(frozen=True, slots=True, kw_only=True)
class Gains:
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

    switching: float
    slope: float
    boundary_layer: float

    def __post_init__(self) -> None:
        """Validate every field and store it as a float."""
        for field in fields(self):
            value = require_positive(field.name, getattr(self, field.name))
            object.__setattr__(self, field.name, value)


FIXED_GAINS = Gains(switching=109.9651, slope=1.2849, boundary_layer=100.0004)
"""The paper's constants, tuned for M = 1 kg, l = 0.5 m, m = 0.05 kg; K and Phi as Table 2 and the
text name them, not as the header of Table 1 does (decision D2)."""
