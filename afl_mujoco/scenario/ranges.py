"""What varies from run to run: the table ``[ranges]`` of a scenario."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Annotated, Any

from afl_mujoco.errors import InvalidValueError, UnknownNameError, meant, require_count
from afl_mujoco.plants.cartpole import CART_POLE
from afl_mujoco.plants.plant import Plant
from afl_mujoco.scenario.belief import is_error, require_error
from afl_mujoco.scenario.imperfections import DECLARATIONS, DRAWS, Imperfections, declarations
from afl_mujoco.scenario.parameters import SCHEDULES
from afl_mujoco.values import (
    EMPTY,
    ByName,
    Positive,
    check_fields,
    checks,
    require_finite,
    require_positive,
    short_repr,
    table_of,
    within,
)

Range = tuple[float, float]

_FIXED = ("control_period", "differentiated")
"""Imperfections that may not vary: a period, which other periods must divide, and a switch."""


@cache
def hardware_of(plant: Plant) -> tuple[str, ...]:
    """Return the imperfections of a plant that may vary, in the order of their axes."""
    known = declarations(plant)
    drawn = DRAWS if known is DECLARATIONS else {}
    return (*drawn, *(name for name in known if name not in drawn and name not in _FIXED))


@cache
def scheduled(plant: Plant) -> tuple[str, ...]:
    """Return the parameters of a plant that may change during a run."""
    return tuple(SCHEDULES) if plant is CART_POLE else tuple(plant.parameters)


def scheduled_columns(plant: Plant) -> list[int]:
    """Return where they stand among all parameters of the plant."""
    return [[*plant.parameters].index(name) for name in scheduled(plant)]


@cache
def variable(plant: Plant) -> tuple[str, ...]:
    """Return everything of a plant that may vary, in the order of the axes."""
    constants = [name for name in plant.parameters if name not in scheduled(plant)]
    return (*plant.states, *scheduled(plant), *hardware_of(plant), *constants)


def unit_of(plant: Plant, name: str) -> str:
    """Return the unit of something that may vary."""
    units = plant.units
    return units[name] if name in units else declarations(plant)[name].unit


MOST_CHANGES = 100  # largest number of changes of a drawn schedule


def _changes(thing: str, value: object) -> int:
    return require_count(thing, value, 0, MOST_CHANGES)


@dataclass(frozen=True, slots=True, kw_only=True)
class Ranges:
    """What varies from run to run, and how far; the rest is as the scenario says."""

    # least and largest value by name, one of `variable`; values are drawn uniformly. Where a
    # parameter varies, its schedule is drawn, with levels within the range
    varied: Mapping[str, Range] = EMPTY
    # largest absolute rate of change of drawn schedules, by name [unit/s]; without one they jump
    rates: Annotated[Any, table_of(require_positive)] = EMPTY
    # how many times parameters change to another level, 0 for levels that stay. None for the
    # paper's shapes: one level, two jumps between three levels or a trapezoid between two
    changes: Annotated[int, _changes] | None = None
    # latest time at which parameters begin to change [s]; half the duration if None
    last_change: Positive | None = None

    def __post_init__(self) -> None:
        varied = ByName({name: _range(name, bounds) for name, bounds in self.varied.items()})
        object.__setattr__(self, "varied", varied)
        check_fields(self)

    def of_plant(self, plant: Plant) -> Ranges:
        """Return the same in a plant's order, or raise."""
        if self == FIXED:
            return self
        known, changing = variable(plant), scheduled(plant)
        for name, bounds in self.varied.items():
            if name not in known:
                which = (
                    f"known keys: {', '.join((*known, *settings_of(plant)))}{meant(name, known)}"
                )
                raise InvalidValueError(f"ranges.{name}", f"is not a known key; {which}")
            if name in hardware_of(plant) and name in plant.units:
                rule = "must not be an imperfection and a name of the plant: rename the plant's"
                raise InvalidValueError(f"ranges.{name}", rule)
            with within("ranges."):
                _require_allowed(plant, name, bounds)
        for name in self.rates:
            if name not in changing:
                raise UnknownNameError.among("rate", name, changing).within("ranges.")
            if name not in self.varied:
                raise InvalidValueError(f"ranges.{name}{RATE}", f"needs a range of {name}")
        drawn = (self.changes, self.last_change) != (None, None)
        if drawn and not self.varied.keys() & {*changing}:
            thing = "changes" if self.changes is not None else "last_change"
            raise InvalidValueError(f"ranges.{thing}", f"needs a range of {' or '.join(changing)}")
        varied = ByName({name: self.varied[name] for name in known if name in self.varied})
        return replace(self, varied=varied, rates=self.rates.ordered(changing))

    __repr__ = short_repr

    @classmethod
    def of(cls, table: Mapping[str, Any]) -> Ranges:
        """Return the ranges from the table of a file."""
        varied: dict[str, Any] = {}
        rates: dict[str, Any] = {}
        for name, value in table.items():
            if isinstance(value, Mapping):
                varied |= {f"{name}.{part}": bounds for part, bounds in value.items()}
            elif name.endswith(RATE) and name != "slew_rate":
                rates[name.removesuffix(RATE)] = value
            elif name not in SETTINGS:
                varied[name] = value
        own = {name: table[name] for name in SETTINGS if name in table}
        return cls(varied=varied, rates=rates, **own)

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


RATE = "_rate"  # ending of the key of the largest rate of a schedule

SETTINGS = ("changes", "last_change")


def settings_of(plant: Plant) -> tuple[str, ...]:
    """Return the keys of the table besides the ranges."""
    return (*(f"{name}{RATE}" for name in scheduled(plant)), *SETTINGS)


def _range(name: str, bounds: Any) -> Range:
    if isinstance(bounds, str) or not isinstance(bounds, Sequence) or len(bounds) != 2:
        rule = "must be a range: its least and its largest value"
        raise InvalidValueError(name, rule, repr(bounds))
    low, high = (require_finite(name, x) for x in bounds)
    if not low <= high:
        raise InvalidValueError(name, "must not decrease", f"{low:g} to {high:g}")
    return low, high


def _require_allowed(plant: Plant, name: str, bounds: Range) -> None:
    rule_of: Callable[[str, Any], Any] = require_finite
    if name in plant.parameters:
        if (plant.parameters[name].low or 0.0) > 0.0:
            rule_of = require_positive
    elif is_error(name):
        rule_of = require_error
    elif name not in plant.states:
        rule_of = checks(Imperfections)[name.partition(".")[0]]
    for x in bounds:
        rule_of(name, x)


FIXED = Ranges()  # nothing varies
