"""A TOML file that says what the columns of a log mean, and what is known about its cart-pole."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from types import MappingProxyType

from afl_mujoco.errors import (
    AflMujocoError,
    FileError,
    InvalidValueError,
    UnknownNameError,
)
from afl_mujoco.files import parse_json, toml_as_json
from afl_mujoco.scenario.values import require_finite, require_positive

UNITS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "time": MappingProxyType({"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}),
        "phi": MappingProxyType({"rad": 1.0, "deg": math.pi / 180.0, "turn": 2.0 * math.pi}),
        "z": MappingProxyType({"m": 1.0, "cm": 1e-2, "mm": 1e-3}),
    }
)
"""SI value of each unit, by signal."""


SMALLEST = 1e-4
"""Smallest value of masses, lengths and forces in SI units; the largest value is its inverse."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeColumn:
    """Time of a reading, from any origin."""

    column: str = "time"  # header of the column
    unit: str = "s"  # unit of the readings, one of `UNITS`

    def __post_init__(self) -> None:
        """Refuse an unknown unit."""
        _require_unit("time", self.unit)


@dataclass(frozen=True, slots=True, kw_only=True)
class AngleColumn:
    """Angle of the pole: 0 upright, positive if it leans towards -z."""

    column: str = "phi"  # header of the column
    unit: str = "rad"  # unit of the readings and of the values below, one of `UNITS`
    sign: int = 1  # -1 if the readings grow as the pole leans towards +z
    zero: float = 0.0  # reading of the upright pole, as far as it is known
    resolution: float = 0.0  # resolution of the readings
    # start and end of the readings that are not valid, such as those of a potentiometer that does
    # not cover a whole turn; the scale is then identified too. None if every reading is valid and
    # the sensor measures whole turns
    dead_zone: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        """Validate every field."""
        _require_signal("phi", self)
        require_finite("zero", self.zero)
        if self.dead_zone is not None and not self.dead_zone[0] < self.dead_zone[1]:
            raise InvalidValueError("dead_zone", "must increase", list(self.dead_zone))

    @property
    def radians(self) -> float:
        """One unit of the readings [rad], signed."""
        return self.sign * UNITS["phi"][self.unit]


@dataclass(frozen=True, slots=True, kw_only=True)
class PositionColumn:
    """Position of the cart."""

    column: str = "z"  # header of the column
    unit: str = "m"  # unit of the readings and of the resolution, one of `UNITS`
    sign: int = 1  # -1 if the readings grow towards -z
    resolution: float = 0.0  # resolution of the readings

    def __post_init__(self) -> None:
        """Validate every field."""
        _require_signal("z", self)

    @property
    def metres(self) -> float:
        """One unit of the readings [m], signed."""
        return self.sign * UNITS["z"][self.unit]


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandColumn:
    """Command to the drive, held from the time of its row to that of the next."""

    column: str = "command"  # header of the column
    sign: int = 1  # -1 if a positive command drives the cart towards -z
    limit: float = 1.0  # largest command

    def __post_init__(self) -> None:
        """Validate every field."""
        _require_sign(self.sign)
        require_positive("limit", self.limit)


@dataclass(frozen=True, slots=True, kw_only=True)
class Nominal:
    """Nominal values of the cart-pole, given by its owners."""

    # m [kg] and l [m] of a uniform rod. Every identified mass and force is proportional to m, which
    # motion alone cannot determine
    pole_mass: float
    half_length: float
    cart_mass: float  # M [kg]
    force: float  # force per unit of command [N]
    hinge_damping: float = 0.0  # viscous friction of hinge [N m s/rad] and rail [N s/m]
    rail_damping: float = 0.0
    rail_half_length: float | None = None  # how far the cart can go to either side [m]
    gravity: float = 9.81  # g [m/s^2]

    def __post_init__(self) -> None:
        """Validate every field."""
        for name in ("pole_mass", "half_length", "cart_mass", "force", "gravity"):
            value = require_positive(name, getattr(self, name))
            if not SMALLEST <= value <= 1.0 / SMALLEST:
                raise InvalidValueError(
                    name, f"must lie in {SMALLEST:g} to {1.0 / SMALLEST:g}", value
                )
        for name in ("hinge_damping", "rail_damping"):
            if require_finite(name, getattr(self, name)) < 0.0:
                raise InvalidValueError(name, "must not be negative", getattr(self, name))
        if self.rail_half_length is not None:
            require_positive("rail_half_length", self.rail_half_length)

    @property
    def gravity_term(self) -> float:
        """3 g / (4 l) of a uniform rod [1/s^2]: its falling rate, squared."""
        return 0.75 * self.gravity / self.half_length


@dataclass(frozen=True, slots=True, kw_only=True)
class Description:
    """What the columns of a log mean, and what is known about its cart-pole."""

    name: str  # name of the cart-pole
    # nominal time between two rows [s]; a log whose period differs by more than a tenth is refused
    period: float
    nominal: Nominal  # nominal values, given by its owners
    time: TimeColumn = field(default_factory=TimeColumn)  # the columns
    phi: AngleColumn = field(default_factory=AngleColumn)
    z: PositionColumn = field(default_factory=PositionColumn)
    command: CommandColumn = field(default_factory=CommandColumn)
    # limits of statements that `afl-mujoco hardware` judges, by their id, where they are to be
    # others than those of the recordings that come with the package
    limits: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Validate period and limits, and that no column is used for two signals."""
        require_positive("period", self.period)
        for name, limit in self.limits.items():
            require_positive(f"limits.{name}", limit)
        names = list(self.columns.values())
        for name in names:
            if names.count(name) > 1:
                raise InvalidValueError("column", "must be for one signal alone", repr(name))

    @property
    def columns(self) -> dict[str, str]:
        """The header of each signal."""
        return {name: getattr(self, name).column for name in ("time", "phi", "z", "command")}

    @property
    def angle_count(self) -> float:
        """Resolution of the angle [rad]."""
        return abs(self.phi.radians) * self.phi.resolution

    @property
    def position_count(self) -> float:
        """Resolution of the position [m]."""
        return abs(self.z.metres) * self.z.resolution


def load_description(path: str | Path) -> Description:
    """Read a description from a TOML file."""
    text = toml_as_json(path)
    try:
        return parse_json(text, Description)
    except AflMujocoError as error:  # pydantic lets errors through that are not a ValueError
        raise error.within(f"{path}: ") from None
    except ValueError as error:
        raise FileError(f"{path}:", str(error)) from None


def to_table(description: Description) -> dict[str, object]:
    """Return a description as the table of a TOML file, without values that are None or empty."""

    def plain(one: object) -> dict[str, object]:
        values = {f.name: getattr(one, f.name) for f in fields(one)}  # type: ignore[arg-type]
        return {
            name: plain(v) if hasattr(v, "__dataclass_fields__") else v
            for name, v in values.items()
            if v is not None and v != {}
        }

    return plain(description)


def _require_unit(signal: str, unit: str) -> None:
    """Raise if a signal has no such unit."""
    if unit not in UNITS[signal]:
        raise UnknownNameError.among(f"{signal}.unit", unit, UNITS[signal])


def _require_sign(sign: int) -> None:
    """Raise unless a sign is 1 or -1."""
    if sign not in (-1, 1):
        raise InvalidValueError("sign", "must be 1 or -1", sign)


def _require_signal(signal: str, column: AngleColumn | PositionColumn) -> None:
    """Raise if unit, sign or resolution break a rule."""
    _require_unit(signal, column.unit)
    _require_sign(column.sign)
    if require_finite("resolution", column.resolution) < 0.0:
        raise InvalidValueError("resolution", "must not be negative", column.resolution)
