"""The parameters of the plant, how a run changes them, and checks of numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from types import UnionType
from typing import Any, NamedTuple

from afl_mujoco.errors import InvalidValueError, UnknownNameError


def require_finite(thing: str, value: object) -> float:
    """Return `value` as a float, or raise unless it is a finite real number."""
    boolean = isinstance(value, bool) or getattr(value, "dtype", None) == "bool"  # NumPy's too
    if boolean or isinstance(value, str | bytes):
        raise InvalidValueError(thing, "must be a number", repr(value))
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        raise InvalidValueError(thing, "must be a number", repr(value)) from None
    except OverflowError:
        raise InvalidValueError(thing, "must be finite", "a number too large for a float") from None
    if not math.isfinite(number):
        raise InvalidValueError(thing, "must be finite", number)
    return number


def require_positive(thing: str, value: object) -> float:
    """Return `value` as a float, or raise unless it is finite and above zero."""
    number = require_finite(thing, value)
    if number <= 0.0:
        raise InvalidValueError(thing, "must be positive", number)
    return number


PER_SECOND = 1e12
"""Instants that a second has: times within a picosecond are one."""


def instant(time: float) -> float:
    """Return a time [s] to the picosecond, so that times that differ by round-off are equal."""
    return round(time * PER_SECOND) / PER_SECOND if abs(time) < 1e9 else time


SMALLEST, LARGEST = 1e-9, 1e9
"""Bounds of a plant's numbers in SI units; beyond them, products overflow."""

LARGEST_STATE = 1e6
"""Largest magnitude of any state in SI units; a run that exceeds it counts as diverged."""


LARGEST_START_ANGLE = 2.0 * math.pi
"""Largest magnitude of an angle from which a run may start [rad]: a whole turn."""


def require_start_angle(thing: str, phi: float) -> None:
    """Raise if an angle [rad] is more than a turn, as one in degrees by mistake."""
    if abs(phi) > LARGEST_START_ANGLE:
        hint = f"{phi:g} degrees is {math.radians(phi):.4f} rad"
        raise InvalidValueError(thing, f"must lie in -2 pi to 2 pi rad ({hint})", f"{phi:g}")


def require_plausible(thing: str, value: object) -> float:
    """Return `value` as a float, or raise unless it is positive and within the bounds."""
    number = require_positive(thing, value)
    if not SMALLEST <= number <= LARGEST:
        raise InvalidValueError(thing, f"must lie in {SMALLEST:g} to {LARGEST:g}", number)
    return number


def require_type(thing: str, value: object, kind: type | UnionType) -> None:
    """Raise unless `value` is an instance of `kind`."""
    if not isinstance(value, kind):
        names = [
            one.__name__ for one in (kind.__args__ if isinstance(kind, UnionType) else (kind,))
        ]
        raise InvalidValueError(thing, f"must be of type {' or '.join(names)}", repr(value))


def departures(table: Any) -> dict[str, Any]:
    """Return the fields of a dataclass that differ from their defaults, by name."""
    values = {field.name: (getattr(table, field.name), field.default) for field in fields(table)}
    return {name: value for name, (value, default) in values.items() if value != default}


def short_repr(table: Any) -> str:
    """Return the call that makes a dataclass, defaults left out, for ``__repr__``."""
    given = (f"{name}={value!r}" for name, value in departures(table).items())
    return f"{type(table).__name__}({', '.join(given)})"


def require_distinct(thing: str, names: Sequence[str], hint: str = "") -> None:
    """Raise if there is no name, or a name occurs twice; a hint says what then to do."""
    if not names:
        raise InvalidValueError(f"{thing}s", "must be at least one", 0)
    for i, name in enumerate(names):
        if name in names[:i]:
            raise InvalidValueError(f"{thing} names", "must differ", f"{name!r} twice{hint}")


@dataclass(frozen=True, slots=True, kw_only=True)
class CartPoleParameters:
    """Parameters of a cart with a uniform rod hinged on it (decision D1).

    Attributes
    ----------
    cart_mass
        Mass M of the cart [kg].
    pole_mass
        Mass m of the pole [kg].
    half_length
        Distance l from the pivot to the pole's centre of mass [m]; the rod is 2 l long.
    gravity
        Gravitational acceleration g [m/s^2], pointing down.

    Raises
    ------
    InvalidValueError
        If a value is not a positive finite number.
    """

    cart_mass: float = 1.0
    pole_mass: float = 0.05
    half_length: float = 0.5
    gravity: float = 9.81

    def __post_init__(self) -> None:
        """Validate every field and store it as a float."""
        for field in fields(self):
            value = require_positive(field.name, getattr(self, field.name))
            object.__setattr__(self, field.name, value)


NOMINAL = CartPoleParameters()
"""The plant for which the paper gives its fixed gains: M = 1 kg, l = 0.5 m, m = 0.05 kg."""

CART_MASSES = tuple(k / 10 for k in range(1, 21))
"""M [kg] of the paper's grid of plants."""

HALF_LENGTHS = tuple(k / 20 for k in range(1, 21))
"""l [m] of the paper's grid of plants."""


class PlantRange(NamedTuple):
    """The plants of a run: least and largest M [kg] and l [m], and m [kg] and g [m/s^2]."""

    cart_mass: tuple[float, float]
    half_length: tuple[float, float]
    pole_mass: float
    gravity: float

    @classmethod
    def of(cls, plant: CartPoleParameters) -> PlantRange:
        """Return the range that holds one plant."""
        p = plant
        return cls((p.cart_mass,) * 2, (p.half_length,) * 2, p.pole_mass, p.gravity)


QUASI_STATIC, STRETCHING_ROD = "quasi-static", "stretching-rod"
DYNAMICS = (QUASI_STATIC, STRETCHING_ROD)
"""Whether the rate of l enters the equations of motion."""

VELOCITIES, MOMENTA = "velocities", "momenta"
JUMPS = (VELOCITIES, MOMENTA)
"""What a step of M or l keeps."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterChange:
    """What a change of M and l does.

    Attributes
    ----------
    dynamics
        ``"quasi-static"``: nothing; M and l are frozen at each instant, as in the paper;
        ``"stretching-rod"``: the rod stretches uniformly at the rate of l.
    jumps
        ``"velocities"``: a step keeps z_dot and phi_dot, as in the paper: mass that is added
        already moves with the body it joins. ``"momenta"``: a step keeps the momenta of z and phi:
        mass that is added starts from rest, and a rod that grows turns more slowly.

    Raises
    ------
    UnknownNameError
        If a value is not one of these.
    """

    dynamics: str = QUASI_STATIC
    jumps: str = VELOCITIES

    def __post_init__(self) -> None:
        """Validate both choices."""
        if self.dynamics not in DYNAMICS:
            raise UnknownNameError.among("dynamics", self.dynamics, DYNAMICS)
        if self.jumps not in JUMPS:
            raise UnknownNameError.among("jumps", self.jumps, JUMPS)

    @property
    def stretching(self) -> bool:
        """Whether the rate of l enters the equations of motion."""
        return self.dynamics == STRETCHING_ROD

    @property
    def keeps_momenta(self) -> bool:
        """Whether a step keeps the momenta."""
        return self.jumps == MOMENTA

    @property
    def is_the_papers(self) -> bool:
        """Whether both choices are those of the paper."""
        return not self.stretching and not self.keeps_momenta

    def describe(self) -> dict[str, str]:
        """Return the choices as plain data, for provenance."""
        return {"dynamics": self.dynamics, "jumps": self.jumps}
