"""What varies from run to run: the table ``[ranges]`` of a scenario."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from afl_mujoco.errors import InvalidValueError, UnknownNameError, meant
from afl_mujoco.scenario.imperfections import DECLARATIONS, DRAWS
from afl_mujoco.scenario.parameters import require_finite, require_positive, short_repr

Range = tuple[float, float]

STATE = MappingProxyType({"z": "m", "phi": "rad", "z_dot": "m/s", "phi_dot": "rad/s"})
"""The initial state and its units."""

SCHEDULES = MappingProxyType({"cart_mass": "kg", "half_length": "m"})
"""The parameters that schedules prescribe, and their units."""

CONSTANTS = MappingProxyType({"pole_mass": "kg", "gravity": "m/s²"})
"""The other parameters of the plant, and their units."""

_FIXED = ("control_period", "differentiated", "seed")
"""Imperfections that may not vary: a period, which other periods must divide, a switch, a seed."""

HARDWARE = (
    *DRAWS,
    *(name for name in DECLARATIONS if name not in DRAWS and name not in _FIXED),
)
"""Imperfections that may vary, in the order of their axes."""

VARIABLE = (*STATE, *SCHEDULES, *HARDWARE, *CONSTANTS)
"""Everything that may vary."""


def unit_of(name: str) -> str:
    """Return the unit of something that may vary."""
    units = {**STATE, **SCHEDULES, **CONSTANTS}
    return units[name] if name in units else DECLARATIONS[name].unit


@dataclass(frozen=True, slots=True, kw_only=True)
class Ranges:
    """What varies from run to run, and how far; the rest is as the scenario says."""

    # least and largest value by name, one of `VARIABLE`; values are drawn uniformly. Where M or l
    # varies, its schedule is drawn, with levels within the range
    varied: Mapping[str, Range] = field(default_factory=dict)
    # largest abs(dM/dt) [kg/s] and abs(dl/dt) [m/s] of drawn schedules; None lets them jump
    cart_mass_rate: float | None = None
    half_length_rate: float | None = None
    # how many times M and l change to another level, 0 for levels that stay. None for the paper's
    # shapes: one level, two jumps between three levels or a trapezoid between two
    changes: int | None = None
    # latest time at which M and l begin to change [s]; half the duration if None
    last_change: float | None = None

    def __post_init__(self) -> None:
        """Validate every range and store its numbers as floats."""
        varied = {name: _range(name, bounds) for name, bounds in self.varied.items()}
        object.__setattr__(self, "varied", {n: varied[n] for n in VARIABLE if n in varied})
        for name in ("cart_mass_rate", "half_length_rate", "last_change"):
            if (value := getattr(self, name)) is not None:
                object.__setattr__(self, name, require_positive(name, value))
        changes = self.changes
        if changes is not None and (isinstance(changes, bool) or not isinstance(changes, int)):
            raise InvalidValueError("changes", "must be a whole number", repr(changes))
        if changes is not None and not 0 <= changes <= MOST_CHANGES:
            raise InvalidValueError("changes", f"must lie in 0 to {MOST_CHANGES}", changes)
        for name in SCHEDULES:
            if getattr(self, f"{name}_rate") is not None and name not in varied:
                raise InvalidValueError(f"{name}_rate", f"needs a range of {name}")
        drawn = (changes, self.last_change) != (None, None)
        if drawn and not varied.keys() & SCHEDULES.keys():
            thing = "changes" if changes is not None else "last_change"
            raise InvalidValueError(thing, f"needs a range of {' or '.join(SCHEDULES)}")

    __repr__ = short_repr

    def __hash__(self) -> int:
        """Return a hash: scenarios are hashable, and hold ranges."""
        settings = tuple(getattr(self, name) for name in SETTINGS)
        return hash((tuple(self.varied.items()), settings))

    @classmethod
    def of(cls, table: Mapping[str, Any]) -> Ranges:
        """Return the ranges from a flat table of ranges and the other attributes by name."""
        varied = {name: value for name, value in table.items() if name not in SETTINGS}
        for name in varied:
            if name not in VARIABLE:
                known = (*VARIABLE, *SETTINGS)
                which = f"known keys: {', '.join(known)}{meant(name, known)}"
                raise InvalidValueError(name, f"is not a known key; {which}")
        return cls(
            varied=varied, **{name: value for name, value in table.items() if name in SETTINGS}
        )

    @property
    def table(self) -> dict[str, Any]:
        """The flat table that `of` takes; empty if nothing varies."""
        settings = {name: getattr(self, name) for name in SETTINGS}
        return {
            **{name: list(bounds) for name, bounds in self.varied.items()},
            **{name: value for name, value in settings.items() if value is not None},
        }


SETTINGS = ("cart_mass_rate", "half_length_rate", "changes", "last_change")
"""Attributes of `Ranges` besides the ranges."""

MOST_CHANGES = 100
"""Largest number of changes of a drawn schedule."""


def _range(name: str, bounds: Any) -> Range:
    """Return a range as it is stored, or raise."""
    if name not in VARIABLE:
        raise UnknownNameError.among("range", name, VARIABLE)
    if isinstance(bounds, str) or not isinstance(bounds, Sequence) or len(bounds) != 2:
        rule = "must be a range: its least and its largest value"
        raise InvalidValueError(name, rule, repr(bounds))
    rule_of: Callable[[str, Any], Any] = require_finite
    if name in SCHEDULES or name in CONSTANTS:
        rule_of = require_positive
    elif name in DECLARATIONS:
        rule_of = DECLARATIONS[name].rule
    low, high = (float(rule_of(name, require_finite(name, x))) for x in bounds)
    if name == "phi" and not max(-low, high) < 0.5 * math.pi:
        rule = "must lie between -pi/2 and pi/2, at which a pole has fallen"
        raise InvalidValueError(name, rule, f"{low:g} to {high:g}")
    if not low <= high:
        raise InvalidValueError(name, "must not decrease", f"{low:g} to {high:g}")
    return low, high


FIXED = Ranges()
"""Nothing varies."""
