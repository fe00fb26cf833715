"""What varies from run to run: the table ``[ranges]`` of a scenario."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.plants.cartpole import CART_POLE
from afl_mujoco.plants.plant import Plant
from afl_mujoco.scenario.belief import is_error, require_error
from afl_mujoco.scenario.imperfections import DECLARATIONS, DRAWS, Imperfections, declarations
from afl_mujoco.scenario.parameters import SCHEDULES
from afl_mujoco.values import (
    ByName,
    checks,
    require_finite,
    require_known,
    require_positive,
    require_table,
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


def ranges_of(plant: Plant, given: Any) -> ByName[Range]:
    """Return the least and largest value of what varies, in the order of a plant's, or raise.

    Values are drawn uniformly. Where a parameter varies, its schedule is drawn, with levels within
    the range. What is said of a part may be in a table: ``{"noise": {"phi": (0.0, 1e-3)}}``.
    """
    flat: dict[str, Any] = {}
    for name, value in require_table("ranges", given).items():
        if (own := isinstance(value, Mapping)) and not value:
            raise InvalidValueError(f"ranges.{name}", "must have a least and a largest value")
        flat |= {f"{name}.{part}": x for part, x in value.items()} if own else {name: value}
    known = variable(plant)
    with within("ranges."):
        require_known(flat, known)
        for name, bounds in flat.items():
            if name in hardware_of(plant) and name in plant.units:
                rule = "must not be an imperfection and a name of the plant: rename the plant's"
                raise InvalidValueError(name, rule)
            flat[name] = _range(name, bounds)
            _require_allowed(plant, name, flat[name])
    return ByName({name: flat[name] for name in known if name in flat})


def ranges_to_table(ranges: Mapping[str, Range]) -> dict[str, Any]:
    """Return ranges as the table of a file."""
    found: dict[str, Any] = {}
    for path, bounds in ranges.items():
        name, _, part = path.partition(".")
        place, key = (found.setdefault(name, {}), part) if part else (found, name)
        place[key] = list(bounds)
    return found


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
