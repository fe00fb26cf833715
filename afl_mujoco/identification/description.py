"""A TOML file that says what the columns of a log mean, and what is known about its cart-pole."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from afl_mujoco.errors import AflMujocoError, FileError, InvalidValueError, UnknownNameError
from afl_mujoco.files import parse_json, toml_as_json
from afl_mujoco.values import (
    Check,
    Checked,
    Finite,
    NotNegative,
    Positive,
    check_fields,
    require_distinct,
    require_plausible,
    require_positive,
    table_of,
)

UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "phi": {"rad": 1.0, "deg": math.pi / 180.0, "turn": 2.0 * math.pi},
    "z": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
}
"""SI value of each unit, by signal."""


def _unit_of(signal: str) -> Check:
    def check(thing: str, value: Any) -> Any:
        if value not in UNITS[signal]:
            raise UnknownNameError.among(f"{signal}.{thing}", value, UNITS[signal])
        return value

    return check


def _require_zone(thing: str, value: Any) -> Any:
    if not value[0] < value[1]:
        raise InvalidValueError(thing, "must increase", list(value))
    return value


Sign = Literal[1, -1]
Likely = Annotated[float, require_plausible]


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeColumn(Checked):
    """Time of a reading, from any origin."""

    column: str = "time"  # header of the column
    unit: Annotated[str, _unit_of("time")] = "s"  # unit of the readings, one of `UNITS`


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorColumn(Checked):
    """Readings of a sensor; values are in the unit of the readings, one of `UNITS`."""

    column: str = ""  # header of the column
    unit: str = ""
    sign: Sign = 1  # -1 if the readings grow the other way
    resolution: NotNegative = 0.0  # resolution of the readings

    @property
    def si(self) -> float:
        """One unit of the readings [rad or m], signed."""
        return self.sign * {**UNITS["phi"], **UNITS["z"]}[self.unit]

    @property
    def count(self) -> float:
        """Resolution [rad or m]."""
        return abs(self.si) * self.resolution


@dataclass(frozen=True, slots=True, kw_only=True)
class AngleColumn(SensorColumn):
    """Angle of the pole: 0 upright, positive if it leans towards -z."""

    column: str = "phi"
    unit: Annotated[str, _unit_of("phi")] = "rad"
    zero: Finite = 0.0  # reading of the upright pole, as far as it is known
    # start and end of the readings that are not valid, such as those of a potentiometer that does
    # not cover a whole turn; the scale is then identified too. None if every reading is valid and
    # the sensor measures whole turns
    dead_zone: Annotated[tuple[float, float], _require_zone] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class PositionColumn(SensorColumn):
    """Position of the cart."""

    column: str = "z"
    unit: Annotated[str, _unit_of("z")] = "m"


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandColumn(Checked):
    """Command to the drive, held from the time of its row to that of the next."""

    column: str = "command"  # header of the column
    sign: Sign = 1  # -1 if a positive command drives the cart towards -z
    limit: Positive = 1.0  # largest command


@dataclass(frozen=True, slots=True, kw_only=True)
class Nominal(Checked):
    """Nominal values of the cart-pole, given by its owners."""

    # m [kg] and l [m] of a uniform rod. Every identified mass and force is proportional to m, which
    # motion alone cannot determine
    pole_mass: Likely
    half_length: Likely
    cart_mass: Likely  # M [kg]
    force: Likely  # force per unit of command [N]
    hinge_damping: NotNegative = 0.0  # viscous friction of hinge [N m s/rad] and rail [N s/m]
    rail_damping: NotNegative = 0.0
    rail_half_length: Positive | None = None  # how far the cart can go to either side [m]
    gravity: Likely = 9.81  # g [m/s^2]

    @property
    def gravity_term(self) -> float:
        """3 g / (4 l) of a uniform rod [1/s^2]: its falling rate, squared."""
        return 0.75 * self.gravity / self.half_length


@dataclass(frozen=True, slots=True, kw_only=True)
class Description:
    """What the columns of a log mean, and what is known about its cart-pole."""

    name: str  # name of the cart-pole
    # nominal time between two rows [s]; a log whose period differs by more than a tenth is refused
    period: Positive
    nominal: Nominal
    time: TimeColumn = field(default_factory=TimeColumn)
    phi: AngleColumn = field(default_factory=AngleColumn)
    z: PositionColumn = field(default_factory=PositionColumn)
    command: CommandColumn = field(default_factory=CommandColumn)
    # limits of statements that `afl-mujoco hardware` judges, by their id, where they are to be
    # others than those of the recordings that come with the package
    limits: Annotated[dict[str, float], table_of(require_positive)] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check every field by its type, and that no column is used for two signals."""
        check_fields(self)
        require_distinct("column", list(self.columns.values()))

    @property
    def columns(self) -> dict[str, str]:
        """The header of each signal."""
        return {name: getattr(self, name).column for name in ("time", "phi", "z", "command")}


def load_description(path: str | Path) -> Description:
    """Read a description from a TOML file."""
    text = toml_as_json(path)
    try:
        return parse_json(text, Description)
    except AflMujocoError as error:  # pydantic lets errors through that are not a ValueError
        raise error.within(f"{path}: ") from None
    except ValueError as error:
        raise FileError(f"{path}:", str(error)) from None


def to_table(one: Any) -> dict[str, object]:
    """Return a description as the table of a TOML file, without values that are None or empty."""
    values = {f.name: getattr(one, f.name) for f in fields(one)}
    return {
        name: to_table(value) if is_dataclass(value) else value
        for name, value in values.items()
        if value is not None and value != {}
    }
