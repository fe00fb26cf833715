"""What controllers assume of the plant: the table ``[belief]`` of a scenario."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Annotated, Any

from afl_mujoco.errors import InvalidValueError, UnknownNameError
from afl_mujoco.values import (
    EMPTY,
    ByName,
    called_with,
    check_fields,
    require_finite,
    short_repr,
    within,
)

TRUE, NOMINAL = "true", "nominal"  # the value at each instant; at t = 0, before draws
ERROR = "_error"  # ending of the name of a parameter's error, in sweeps and ranges


def require_error(name: str, value: Any) -> float:
    """Return a relative error as a float, or raise unless it is above -1."""
    number = require_finite(name, value)
    if number <= -1.0:
        raise InvalidValueError(name, "must be above -1", number)
    return number


@dataclass(frozen=True, slots=True)
class Assumed:
    """What is assumed of one parameter."""

    value: str | float = TRUE  # `TRUE`, `NOMINAL`, or a number
    error: Annotated[float, require_error] = 0.0  # relative error, above -1: 0.1 is 10 % too large

    def __post_init__(self) -> None:
        if self.value not in (TRUE, NOMINAL):
            if isinstance(self.value, str):
                raise UnknownNameError.among("value", self.value, (TRUE, NOMINAL, "a number"))
            object.__setattr__(self, "value", require_finite("value", self.value))
        check_fields(self)

    @classmethod
    def of(cls, given: Any) -> Assumed:
        """Return what a file or a caller gives: `TRUE`, `NOMINAL`, a number, or a table."""
        if isinstance(given, cls):
            return given
        return called_with(cls, "", given) if isinstance(given, Mapping) else cls(value=given)

    @property
    def plain(self) -> Any:
        """What `of` takes, in its shortest form."""
        return asdict(self) if self.error else self.value


@dataclass(frozen=True, slots=True)
class Belief:
    """What controllers assume of each parameter, the true value by default.

    A controller with parameters of its own assumes those; one that estimates parameters is not
    told them.
    """

    assumed: ByName[Assumed] = EMPTY  # by name, without those that are just true

    @classmethod
    def of(cls, given: Any, names: Sequence[str]) -> Belief:
        """Return what a file or a caller gives for parameters: one word for all, or a table."""
        if isinstance(given, cls):
            given = given.assumed
        if isinstance(given, str):
            given = dict.fromkeys(names, given)
        if not isinstance(given, Mapping):
            rule = f"must be a table by name, {TRUE!r} or {NOMINAL!r}"
            raise InvalidValueError("belief", rule, repr(given))
        found = {}
        for name, one in given.items():
            if name not in names:
                raise UnknownNameError.among("belief.key", name, names)
            with within(f"belief.{name} "):
                found[name] = Assumed.of(one)
        named = {name: found[name] for name in names if name in found}
        return cls(ByName({name: one for name, one in named.items() if one != Assumed()}))

    def one(self, name: str) -> Assumed:
        """Return what is assumed of one parameter."""
        return self.assumed.get(name) or Assumed()

    __repr__ = short_repr

    @property
    def table(self) -> Any:
        """What `of` takes, in its shortest form."""
        return {name: one.plain for name, one in self.assumed.items()}

    def known(self, nominal: Mapping[str, float]) -> Belief:
        """Return the same with numbers for the nominal values of some parameters."""

        def known(name: str) -> Assumed:
            one = self.one(name)
            return replace(one, value=nominal[name]) if one.value == NOMINAL else one

        return Belief.of({name: known(name) for name in nominal}, [*nominal])

    def told(self, name: str, truth: Any, nominal: float | None = None) -> Any:
        """Return what is assumed of one parameter, given its true values."""
        one = self.one(name)
        value = one.value
        if value == NOMINAL and nominal is not None:
            value = nominal
        base = truth if value in (TRUE, NOMINAL) else 0.0 * truth + value
        return base * (1.0 + one.error)

    def changed(self, **errors: float) -> Belief:
        """Return the same with other errors, by name with the ending `ERROR`."""
        keys = [name.removesuffix(ERROR) for name in errors]
        new = {key: replace(self.one(key), error=errors[f"{key}{ERROR}"]) for key in keys}
        return Belief(ByName({**self.assumed, **new}))

    def error(self, name: str) -> float:
        """Return an error by its name with the ending `ERROR`."""
        return self.one(name.removesuffix(ERROR)).error


def is_error(path: str) -> bool:
    """Return whether a path names an error of the belief."""
    return path.endswith(ERROR)


TRUTH = Belief()  # controllers are told the truth at each instant
