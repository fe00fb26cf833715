"""The inputs of a search: its settings, its box and its seed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from afl_mujoco.errors import InvalidValueError, require_count

ROUND_OFF = 1e-9
"""Round-off that is tolerated in a sum of shares, and in a whole number of groups."""

SHARES = ("reproduction", "crossover", "mutation")

Seed = int | tuple[int, ...]


MOST = 1_000_000
"""Most chromosomes, and most generations."""

LARGEST_SEED = 2**63 - 1


def _require_finite(thing: str, value: object) -> float:
    """Return `value` as a float, or raise unless it is a finite number."""
    try:
        if isinstance(value, bool | np.bool_ | str | bytes):
            raise TypeError
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        raise InvalidValueError(thing, "must be a number", repr(value)) from None
    if not math.isfinite(number):
        raise InvalidValueError(thing, "must be finite", number)
    return number


def require_seed(seed: object) -> Seed:
    """Return a seed, or raise unless it is one.

    Parameters
    ----------
    seed
        An int, or a tuple of ints (at least one); none negative.
    """
    if isinstance(seed, tuple) and seed:
        return tuple(require_count("seed", part, 0, LARGEST_SEED) for part in seed)
    return require_count("seed", seed, 0, LARGEST_SEED)


@dataclass(frozen=True, slots=True, kw_only=True)
class GeneticSettings:
    """Settings of the search; the defaults are the paper's.

    Attributes
    ----------
    population_size
        Chromosomes Np.
    generations
        Generations bred from the initial population.
    reproduction, crossover, mutation
        Shares Pr, Pc, Pm of the next generation that are copied, crossed and mutated; their sum
        is 1. If the last group cannot be filled, copies take its place.
    mutation_constant
        c of Eq. (A2), in the unit of the genes.
    parents
        Chromosomes in a group of Eq. (A1): 3 in the paper; 2 gives two-parent crossover.
    """

    population_size: int = 1000
    generations: int = 1000
    reproduction: float = 0.45
    crossover: float = 0.45
    mutation: float = 0.1
    mutation_constant: float = 1e-7
    parents: int = 3

    def __post_init__(self) -> None:
        """Check each value, and the values in combination."""
        for name, least in (("population_size", 1), ("generations", 1), ("parents", 2)):
            object.__setattr__(self, name, require_count(name, getattr(self, name), least, MOST))
        for name in (*SHARES, "mutation_constant"):
            object.__setattr__(self, name, _require_finite(name, getattr(self, name)))
        if not self.mutation_constant > 0.0:
            raise InvalidValueError("mutation_constant", "must be positive", self.mutation_constant)
        self._check_shares()
        for what, there in (
            (f"a group of {self.parents}", self.groups or not self.crossover),
            ("a mutant", self.mutants or not self.mutation),
            ("a copy of the best", self.copies >= 1),
        ):
            if not there:
                rule = f"must be large enough for {what}"
                raise InvalidValueError("population_size", rule, self.population_size)

    def _check_shares(self) -> None:
        """Raise unless the shares add up to 1 and leave room for something new."""
        shares = {name: getattr(self, name) for name in SHARES}
        for name, share in shares.items():
            if not 0.0 <= share <= 1.0:
                raise InvalidValueError(name, "must lie in [0, 1]", share)
        if abs((total := sum(shares.values())) - 1.0) > ROUND_OFF:
            raise InvalidValueError(" + ".join(shares), "must be 1", total)
        if not (self.crossover or self.mutation):
            raise InvalidValueError(
                "reproduction", "must leave a share for crossover or mutation", self.reproduction
            )

    @property
    def groups(self) -> int:
        """Groups crossed in a generation."""
        exact = self.crossover * self.population_size / self.parents
        return math.floor(exact + ROUND_OFF)

    @property
    def mutants(self) -> int:
        """Chromosomes mutated in a generation."""
        return round(self.mutation * self.population_size)

    @property
    def copies(self) -> int:
        """Chromosomes copied in a generation."""
        return self.population_size - self.groups * self.parents - self.mutants


@dataclass(frozen=True, slots=True)
class Box:
    """Bounds of the search; a gene whose bounds are equal stays fixed.

    Attributes
    ----------
    lower, upper
        Lower and upper bounds of the D genes.
    """

    lower: tuple[float, ...]
    upper: tuple[float, ...]

    def __post_init__(self) -> None:
        """Check the bounds."""
        for field in fields(self):
            bounds: Sequence[float] = getattr(self, field.name)
            checked = tuple(_require_finite(f"{field.name}[{i}]", x) for i, x in enumerate(bounds))
            object.__setattr__(self, field.name, checked)
        if not self.lower:
            raise InvalidValueError("lower", "must have at least one bound", self.lower)
        if len(self.lower) != len(self.upper):
            rule = f"must be as long as lower, which has {len(self.lower)}"
            raise InvalidValueError("upper", rule, len(self.upper))
        for i, (low, high) in enumerate(zip(self.lower, self.upper, strict=True)):
            if low > high:
                raise InvalidValueError(f"upper[{i}]", f"must not be below lower {low}", high)
