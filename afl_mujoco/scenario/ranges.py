"""What varies from run to run: the table ``[ranges]`` of a scenario."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from afl_mujoco.errors import InvalidValueError, UnknownNameError, meant
from afl_mujoco.scenario.belief import ERRORS, require_error
from afl_mujoco.scenario.imperfections import DECLARATIONS, DRAWS, Imperfections
from afl_mujoco.scenario.parameters import CONSTANTS, SCHEDULES, STATE
from afl_mujoco.values import (
    EMPTY,
    ByName,
    Positive,
    check_fields,
    checks,
    require_finite,
    require_positive,
    require_whole,
    short_repr,
    table_of,
)

Range = tuple[float, float]

_FIXED = ("control_period", "differentiated")
"""Imperfections that may not vary: a period, which other periods must divide, and a switch."""

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


MOST_CHANGES = 100
"""Largest number of changes of a drawn schedule."""


def _changes(thing: str, value: object) -> int:
    return require_whole(thing, value, 0, MOST_CHANGES)


@dataclass(frozen=True, slots=True, kw_only=True)
class Ranges:
    """What varies from run to run, and how far; the rest is as the scenario says."""

    # least and largest value by name, one of `VARIABLE`; values are drawn uniformly. Where M or l
    # varies, its schedule is drawn, with levels within the range
    varied: Mapping[str, Range] = EMPTY
    # largest absolute rate of change of drawn schedules, by name [unit/s]; without one they jump
    rates: Annotated[Any, table_of(require_positive)] = EMPTY
    # how many times M and l change to another level, 0 for levels that stay. None for the paper's
    # shapes: one level, two jumps between three levels or a trapezoid between two
    changes: Annotated[int, _changes] | None = None
    # latest time at which M and l begin to change [s]; half the duration if None
    last_change: Positive | None = None

    def __post_init__(self) -> None:
        """Validate every range and store its numbers as floats."""
        varied = ByName({name: _range(name, bounds) for name, bounds in self.varied.items()})
        object.__setattr__(self, "varied", varied.ordered(VARIABLE))
        check_fields(self)
        object.__setattr__(self, "rates", self.rates.ordered([*SCHEDULES]))
        for name in self.rates:
            if name not in varied:
                raise InvalidValueError(f"{name}{RATE}", f"needs a range of {name}")
        drawn = (self.changes, self.last_change) != (None, None)
        if drawn and not varied.keys() & SCHEDULES.keys():
            thing = "changes" if self.changes is not None else "last_change"
            raise InvalidValueError(thing, f"needs a range of {' or '.join(SCHEDULES)}")

    __repr__ = short_repr

    @classmethod
    def of(cls, table: Mapping[str, Any]) -> Ranges:
        """Return the ranges from the table of a file."""
        varied: dict[str, Any] = {}
        for name, value in table.items():
            if isinstance(value, Mapping):
                varied |= {f"{name}.{part}": bounds for part, bounds in value.items()}
            elif name not in SETTINGS:
                varied[name] = value
        for name in varied:
            if name not in VARIABLE:
                known = (*VARIABLE, *SETTINGS)
                which = f"known keys: {', '.join(known)}{meant(name, known)}"
                raise InvalidValueError(name, f"is not a known key; {which}")
        return cls(
            varied=varied,
            rates={name: table[key] for name in SCHEDULES if (key := f"{name}{RATE}") in table},
            **{name: table[name] for name in ("changes", "last_change") if name in table},
        )

    @property
    def table(self) -> dict[str, Any]:
        """The table that `of` takes; empty if nothing varies."""
        found: dict[str, Any] = {}
        for path, bounds in self.varied.items():
            name, _, part = path.partition(".")
            if part:
                found.setdefault(name, {})[part] = list(bounds)
            else:
                found[name] = list(bounds)
        found |= {f"{name}{RATE}": rate for name, rate in self.rates.items()}
        settings = {"changes": self.changes, "last_change": self.last_change}
        return found | {name: value for name, value in settings.items() if value is not None}


RATE = "_rate"
"""Ending of the key of the largest rate of a schedule."""

SETTINGS = (*(f"{name}{RATE}" for name in SCHEDULES), "changes", "last_change")
"""Keys of the table besides the ranges."""


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
    elif name in ERRORS:
        rule_of = require_error
    elif name in DECLARATIONS:
        rule_of = checks(Imperfections)[name.partition(".")[0]]
    low, high = (float(rule_of(name, require_finite(name, x))) for x in bounds)
    if name == "phi" and not max(-low, high) < 0.5 * math.pi:
        rule = "must lie between -pi/2 and pi/2, at which a pole has fallen"
        raise InvalidValueError(name, rule, f"{low:g} to {high:g}")
    if not low <= high:
        raise InvalidValueError(name, "must not decrease", f"{low:g} to {high:g}")
    return low, high


FIXED = Ranges()
"""Nothing varies."""
