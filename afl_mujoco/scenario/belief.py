"""What controllers assume of the plant: the table ``[belief]`` of a scenario."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Annotated, Any

from afl_mujoco.errors import InvalidValueError, UnknownNameError
from afl_mujoco.values import (
    EMPTY,
    ByName,
    check_fields,
    require_finite,
    require_type,
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
                kinds = (TRUE, NOMINAL, "a number")
                raise UnknownNameError.among("value", self.value, kinds)
            object.__setattr__(self, "value", require_finite("value", self.value))
        check_fields(self)

    @classmethod
    def of(cls, given: Any) -> Assumed:
        """Return what a file or a caller gives: `TRUE`, `NOMINAL`, a number, or a table."""
        if isinstance(given, cls):
            return given
        if not isinstance(given, Mapping):
            return cls(value=given)
        known = [one.name for one in fields(cls)]
        for name in given:
            if name not in known:
                raise UnknownNameError.among("key", name, known)
        return cls(**given)

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
    rest: str = TRUE  # what is assumed of the others, `TRUE` or `NOMINAL`

    @classmethod
    def of(cls, given: Any) -> Belief:
        """Return what a file or a caller gives: one word for all parameters, or a table."""
        if isinstance(given, cls):
            return given
        if isinstance(given, str):
            word = Assumed(value=given).value
            return cls(rest=str(word))
        require_type("belief", given, Mapping)
        found = {}
        for name, one in given.items():
            with within(f"{name} "):
                found[str(name)] = Assumed.of(one)
        return cls(ByName(found))

    def of_plant(self, names: Sequence[str]) -> Belief:
        """Return the same in the order of a plant's parameters, or raise."""
        for name in self.assumed:
            if name not in names:
                raise UnknownNameError.among("key", name, names)
        found = {name: self.one(name) for name in names}
        if self.rest == NOMINAL and all(one == Assumed(NOMINAL) for one in found.values()):
            return Belief(rest=NOMINAL)
        return Belief(ByName({name: one for name, one in found.items() if one != Assumed()}))

    def one(self, name: str) -> Assumed:
        """Return what is assumed of one parameter."""
        return self.assumed.get(name) or Assumed(value=self.rest)

    __repr__ = short_repr

    @property
    def table(self) -> Any:
        """What `of` takes, in its shortest form."""
        if self.rest != TRUE and not self.assumed:
            return self.rest
        return {name: one.plain for name, one in self.assumed.items()}

    def known(self, nominal: Mapping[str, float]) -> Belief:
        """Return the same with numbers for the nominal values of some parameters."""

        def known(name: str) -> Assumed:
            one = self.one(name)
            return replace(one, value=nominal[name]) if one.value == NOMINAL else one

        return Belief(ByName({name: known(name) for name in nominal})).of_plant([*nominal])

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
        return Belief(ByName({**self.assumed, **new}), self.rest)

    def error(self, name: str) -> float:
        """Return an error by its name with the ending `ERROR`."""
        return self.one(name.removesuffix(ERROR)).error


def is_error(path: str) -> bool:
    """Return whether a path names an error of the belief."""
    return path.endswith(ERROR)


TRUTH = Belief()  # controllers are told the truth at each instant
