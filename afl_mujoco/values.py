"""Checks of values: the type of a field says its rule, and one function applies it.

A field annotated ``Annotated[float, require_positive]`` is checked and stored by `check_fields`,
wherever its dataclass is made: from a file, from Python, or by `replace`.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields
from functools import cache
from types import UnionType
from typing import Annotated, Any, TypeVar, get_args, get_type_hints

from afl_mujoco.errors import AflMujocoError, InvalidValueError, UnknownNameError, meant

Check = Callable[[str, Any], Any]  # ``check(thing, value)``: the value as stored, or raises

Value = TypeVar("Value")


def require_type(thing: str, value: object, kind: type | UnionType) -> None:
    """Raise unless `value` is an instance of `kind`."""
    if not isinstance(value, kind):
        names = (one.__name__ for one in get_args(kind) or (kind,))
        raise InvalidValueError(thing, f"must be of type {' or '.join(names)}", repr(value))


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


def require_not_negative(thing: str, value: object) -> float:
    """Return `value` as a float, or raise unless it is finite and zero or above."""
    number = require_finite(thing, value)
    if number < 0.0:
        raise InvalidValueError(thing, "must not be negative", number)
    return number


PER_SECOND = 1e12  # instants that a second has: times within a picosecond are one


def instant(time: float) -> float:
    """Return a time [s] to the picosecond, so that times that differ by round-off are equal."""
    return round(time * PER_SECOND) / PER_SECOND if abs(time) < 1e9 else time


def require_time(thing: str, value: object) -> float:
    """Return `value` as an instant [s], or raise unless it is finite and not negative."""
    return instant(require_not_negative(thing, value))


SMALLEST, LARGEST = 1e-9, 1e9  # of a plant's numbers in SI units; beyond, products overflow


def require_plausible(thing: str, value: object) -> float:
    """Return `value` as a float, or raise unless it is positive and within the bounds."""
    number = require_positive(thing, value)
    if not SMALLEST <= number <= LARGEST:
        raise InvalidValueError(thing, f"must lie in {SMALLEST:g} to {LARGEST:g}", number)
    return number


def require_text(thing: str, value: object) -> str:
    """Return `value`, or raise unless it is text."""
    if not isinstance(value, str):
        raise InvalidValueError(thing, "must be text", repr(value))
    return value


def require_switch(thing: str, value: object) -> bool:
    """Return `value`, or raise unless it is true or false."""
    if not isinstance(value, bool):
        raise InvalidValueError(thing, "must be true or false", repr(value))
    return value


def require_distinct(thing: str, names: Sequence[str], hint: str = "") -> None:
    """Raise if there is no name, or a name occurs twice; a hint says what then to do."""
    if not names:
        raise InvalidValueError(f"{thing}s", "must be at least one", 0)
    for i, name in enumerate(names):
        if name in names[:i]:
            raise InvalidValueError(f"{thing} names", "must differ", f"{name!r} twice{hint}")


Finite = Annotated[float, require_finite]
Positive = Annotated[float, require_positive]
NotNegative = Annotated[float, require_not_negative]
Time = Annotated[float, require_time]
Switch = Annotated[bool, require_switch]
Text = Annotated[str, require_text]


class ByName(dict[str, Value]):
    """Values by the plant's names; it can be hashed, and is not changed."""

    def __hash__(self) -> int:  # type: ignore[override]
        return hash(frozenset(self.items()))

    def ordered(self, names: Sequence[str]) -> ByName[Value]:
        """Return the values in the order of the names, and raise if one is not among them."""
        for name in self:
            if name not in names:
                raise UnknownNameError.among("name", name, names)
        return ByName({name: self[name] for name in names if name in self})


EMPTY: ByName[Any] = ByName()


def by_name(check: Check) -> Check:
    """Return the check of one value for everything, or of a table of values by name."""

    def checked(thing: str, value: Any) -> Any:
        if not isinstance(value, Mapping):
            return check(thing, value)
        return ByName({str(name): check(f"{thing}.{name}", x) for name, x in value.items()})

    return checked


def table_of(check: Check) -> Check:
    """Return the check of a table of values by name."""
    return lambda thing, value: by_name(check)(thing, require_table(thing, value))


def require_table(thing: str, value: Any) -> Mapping[str, Any]:
    """Return `value`, or raise unless it is a table."""
    if not isinstance(value, Mapping):
        raise InvalidValueError(thing, "must be a table", repr(value))
    return value


def require_known(table: Mapping[str, Any], known: Iterable[str]) -> None:
    """Raise if a table of a file has a key that is not among the known ones."""
    names = [*known]
    for key in table:
        if key not in names:
            which = f"known keys: {', '.join(names)}{meant(key, names)}"
            raise InvalidValueError(key or "''", f"is not a known key; {which}")


def called_with(function: Callable[..., Value], thing: str, table: Any) -> Value:
    """Return what a function or a class returns for a table of a file, or raise by its keys."""
    known = inspect.signature(function).parameters
    require_table(thing, table)
    with within(thing and f"{thing}."):
        require_known(table, known)
        for key, one in known.items():
            if one.default is one.empty and key not in table:
                raise InvalidValueError(key, "is missing")
        return function(**table)


def check_fields(one: Any) -> None:
    """Check every field of a dataclass by its type, and store it; called by ``__post_init__``."""
    for name, check in checks(one.__class__).items():
        object.__setattr__(one, name, check(name, getattr(one, name)))


class Checked:
    """A dataclass whose fields are checked by their types."""

    __slots__ = ()

    def __post_init__(self) -> None:
        check_fields(self)


@cache
def checks(kind: Any) -> Mapping[str, Check]:
    """Return the check of each field of a dataclass whose type has one."""
    hints = get_type_hints(kind, include_extras=True)
    found: dict[str, Check] = {}
    for one in fields(kind):
        hint = hints[one.name]
        for part in (hint, *get_args(hint)):  # of ``Positive | None``, the part with the check
            if check := next(filter(callable, getattr(part, "__metadata__", ())), None):
                found[one.name] = _optional(check) if type(None) in get_args(hint) else check
    return found


def _optional(check: Check) -> Check:
    return lambda thing, value: None if value is None else check(thing, value)


def departures(table: Any) -> dict[str, Any]:
    """Return the fields of a dataclass that differ from their defaults, by name."""
    values = {field.name: (getattr(table, field.name), field.default) for field in fields(table)}
    return {name: value for name, (value, default) in values.items() if value != default}


def short_repr(table: Any) -> str:
    """Return the call that makes a dataclass, defaults left out, for ``__repr__``."""
    given = (f"{name}={value!r}" for name, value in departures(table).items())
    return f"{type(table).__name__}({', '.join(given)})"


@contextmanager
def within(place: str) -> Iterator[None]:
    """Put a place before the thing that an error raised in the block names."""
    try:
        yield
    except AflMujocoError as error:
        raise error.within(place) from None
