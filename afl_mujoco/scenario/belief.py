"""What controllers assume of the plant: the table ``[belief]`` of a scenario."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Annotated, Any

from afl_mujoco.errors import InvalidValueError, UnknownNameError
from afl_mujoco.scenario.parameters import CartPoleParameters
from afl_mujoco.values import (
    check_fields,
    require_finite,
    require_plausible,
    require_type,
    short_repr,
    within,
)

TRUE, NOMINAL = "true", "nominal"
"""The scenario's value at each instant; its value at t = 0, before anything is drawn."""

ERROR = "_error"
"""Ending of the name of a parameter's error, where errors have names: in sweeps and ranges."""


def require_error(name: str, value: Any) -> float:
    """Return a relative error as a float, or raise unless it is above -1."""
    number = require_finite(name, value)
    if number <= -1.0:
        raise InvalidValueError(name, "must be above -1", number)
    return number


@dataclass(frozen=True, slots=True, kw_only=True)
class Assumed:
    """What is assumed of one parameter."""

    value: str | float = TRUE  # `TRUE`, `NOMINAL`, or a number
    error: Annotated[float, require_error] = 0.0  # relative error, above -1: 0.1 is 10 % too large

    def __post_init__(self) -> None:
        """Validate both fields."""
        if self.value not in (TRUE, NOMINAL):
            if isinstance(self.value, str):
                kinds = (TRUE, NOMINAL, "a number")
                raise UnknownNameError.among("value", self.value, kinds)
            object.__setattr__(self, "value", require_plausible("value", self.value))
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Belief:
    """What controllers assume of each parameter, the true value by default.

    A controller with parameters of its own assumes those; one that estimates M and l is not told
    them. Each field takes what `Assumed.of` takes.
    """

    cart_mass: Assumed = Assumed()
    pole_mass: Assumed = Assumed()
    half_length: Assumed = Assumed()
    gravity: Assumed = Assumed()

    def __post_init__(self) -> None:
        """Normalise every field."""
        for name in PARAMETERS:
            with within(f"{name} "):
                assumed = Assumed.of(getattr(self, name))
            object.__setattr__(self, name, assumed)

    __repr__ = short_repr

    @classmethod
    def of(cls, given: Any) -> Belief:
        """Return what a file or a caller gives: one value for all parameters, or a table."""
        if isinstance(given, cls):
            return given
        if isinstance(given, str):
            return cls(**dict.fromkeys(PARAMETERS, Assumed(value=given)))
        require_type("belief", given, Mapping)
        for name in given:
            if name not in PARAMETERS:
                raise UnknownNameError.among("key", name, PARAMETERS)
        return cls(**given)

    @property
    def table(self) -> Any:
        """What `of` takes, without what is true; one word where all parameters are nominal."""
        if self == Belief.of(NOMINAL):
            return NOMINAL
        found = {name: getattr(self, name).plain for name in PARAMETERS}
        return {name: value for name, value in found.items() if value != TRUE}

    def known(self, nominal: CartPoleParameters) -> Belief:
        """Return the same with numbers for the nominal values of some parameters."""

        def known(name: str) -> Assumed:
            one: Assumed = getattr(self, name)
            return replace(one, value=getattr(nominal, name)) if one.value == NOMINAL else one

        return Belief(**{name: known(name) for name in PARAMETERS})

    def about(self, plant: CartPoleParameters) -> CartPoleParameters:
        """Return what is assumed of a plant, for which it takes the nominal one to be `plant`."""
        told = {name: self.told(name, getattr(plant, name)) for name in PARAMETERS}
        return CartPoleParameters(**told)

    def told(self, name: str, truth: Any, nominal: float | None = None) -> Any:
        """Return what is assumed of one parameter, given its true values."""
        one: Assumed = getattr(self, name)
        value = one.value
        if value == NOMINAL and nominal is not None:
            value = nominal
        base = truth if value in (TRUE, NOMINAL) else 0.0 * truth + value
        return base * (1.0 + one.error)

    def changed(self, **errors: float) -> Belief:
        """Return the same with other errors, by the names of `ERRORS`."""
        return replace(
            self,
            **{
                (key := name.removesuffix(ERROR)): replace(getattr(self, key), error=error)
                for name, error in errors.items()
            },
        )

    def error(self, name: str) -> float:
        """Return an error by one of the names of `ERRORS`."""
        found: float = getattr(self, name.removesuffix(ERROR)).error
        return found


PARAMETERS = tuple(one.name for one in fields(Belief))
"""Everything that is assumed."""

ERRORS = tuple(f"{name}{ERROR}" for name in PARAMETERS)
"""Names of the errors of what is assumed."""

TRUTH = Belief()
"""Controllers are told the truth at each instant."""
