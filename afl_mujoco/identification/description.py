"""A TOML file that says what the columns of a log mean, and what is known about its cart-pole."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any

from afl_mujoco.errors import InvalidValueError, UnknownNameError
from afl_mujoco.files import read_toml
from afl_mujoco.values import (
    Check,
    Checked,
    Finite,
    NotNegative,
    Positive,
    Text,
    called_with,
    check_fields,
    require_distinct,
    require_finite,
    require_plausible,
    within,
)

UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "phi": {"rad": 1.0, "deg": math.pi / 180.0, "turn": 2.0 * math.pi},
    "z": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
}
"""SI value of each unit, by signal."""


def _unit_of(signal: str) -> Check:
    def check(thing: str, value: Any) -> Any:
        if not isinstance(value, str) or value not in UNITS[signal]:
            raise UnknownNameError.among(thing, value, UNITS[signal])
        return value

    return check


def _require_zone(thing: str, value: Any) -> tuple[float, float]:
    if isinstance(value, str) or not isinstance(value, Sequence) or len(value) != 2:
        raise InvalidValueError(thing, "must be two numbers", repr(value))
    low, high = (require_finite(thing, x) for x in value)
    if not low < high:
        raise InvalidValueError(thing, "must increase", [low, high])
    return low, high


def _require_sign(thing: str, value: Any) -> int:
    if value not in (1, -1) or isinstance(value, bool):
        raise InvalidValueError(thing, "must be 1 or -1", value)
    return int(value)


Sign = Annotated[int, _require_sign]
Likely = Annotated[float, require_plausible]


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeColumn(Checked):
    """Time of a reading, from any origin."""

    column: Text = "time"  # header of the column
    unit: Annotated[str, _unit_of("time")] = "s"  # unit of the readings, one of `UNITS`


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorColumn(Checked):
    """Readings of a sensor; values are in the unit of the readings, one of `UNITS`."""

    column: Text = ""  # header of the column
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

    column: Text = "phi"
    unit: Annotated[str, _unit_of("phi")] = "rad"
    zero: Finite = 0.0  # reading of the upright pole, as far as it is known
    # start and end of the readings that are not valid, such as those of a potentiometer that does
    # not cover a whole turn; the scale is then identified too. None if every reading is valid and
    # the sensor measures whole turns
    dead_zone: Annotated[tuple[float, float], _require_zone] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class PositionColumn(SensorColumn):
    """Position of the cart."""

    column: Text = "z"
    unit: Annotated[str, _unit_of("z")] = "m"


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandColumn(Checked):
    """Command to the drive, held from the time of its row to that of the next."""

    column: Text = "command"  # header of the column
    sign: Sign = 1  # -1 if a positive command drives the cart towards -z
    limit: Positive | None = None  # largest command, if one is known


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

    name: Text  # name of the cart-pole
    # nominal time between two rows [s]; a log whose period differs by more than a tenth is refused
    period: Positive
    nominal: Nominal
    time: TimeColumn = field(default_factory=TimeColumn)
    phi: AngleColumn = field(default_factory=AngleColumn)
    z: PositionColumn = field(default_factory=PositionColumn)
    command: CommandColumn = field(default_factory=CommandColumn)

    def __post_init__(self) -> None:
        """Check every field by its type, and that no column is used for two signals."""
        check_fields(self)
        require_distinct("column", list(self.columns.values()))

    @property
    def columns(self) -> dict[str, str]:
        """The header of each signal."""
        return {name: getattr(self, name).column for name in ("time", "phi", "z", "command")}


PARTS = {
    "time": TimeColumn, "phi": AngleColumn, "z": PositionColumn, "command": CommandColumn,
    "nominal": Nominal,
}  # fmt: skip
"""The tables of the file."""


def load_description(path: str | Path) -> Description:
    """Read a description from a TOML file."""
    table = read_toml(path)
    with within(f"{path}: "):
        parts = {
            name: called_with(PARTS[name], name, table[name]) for name in PARTS if name in table
        }
        return called_with(Description, "", {**table, **parts})


def to_table(one: Any) -> dict[str, object]:
    """Return a description as the table of a TOML file, without values that are None."""
    values = {f.name: getattr(one, f.name) for f in fields(one)}
    return {
        name: to_table(value) if is_dataclass(value) else value
        for name, value in values.items()
        if value is not None
    }
