"""Rates with their intervals, and two controllers compared on the same samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from scipy.stats import binomtest

from afl_mujoco.errors import InvalidValueError

CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True)
class Rate:
    """How many of how many.

    Attributes
    ----------
    count, of
        So many of so many.

    Raises
    ------
    InvalidValueError
        If it is none of none, or more than all.
    """

    count: int
    of: int

    def __post_init__(self) -> None:
        """Check that it is a share."""
        if not 0 <= self.count <= self.of or self.of < 1:
            raise InvalidValueError("rate", "must be a share of at least one", str(self))

    def __str__(self) -> str:
        """Say it as a table does."""
        return f"{self.count} of {self.of}"

    @property
    def share(self) -> float:
        """The share [1]."""
        return self.count / self.of

    @property
    def interval(self) -> tuple[float, float]:
        """The exact (Clopper-Pearson) confidence interval of the share at `CONFIDENCE`."""
        test = binomtest(self.count, self.of)
        found = test.proportion_ci(confidence_level=CONFIDENCE, method="exact")
        return float(found.low), float(found.high)


@dataclass(frozen=True, slots=True, kw_only=True)
class Pairing:
    """Two controllers on the same samples.

    Attributes
    ----------
    both, only_first, only_second, neither
        How many samples both survived, one alone, none.
    """

    both: int
    only_first: int
    only_second: int
    neither: int

    @property
    def p_value(self) -> float:
        """McNemar's exact test: how likely so uneven a split would be were the two as good."""
        split = self.only_first + self.only_second
        return float(binomtest(self.only_first, split, 0.5).pvalue) if split else 1.0


def pair(first: Sequence[bool], second: Sequence[bool]) -> Pairing:
    """Return how many samples both, one or neither survived."""
    pairs = list(zip(first, second, strict=True))
    return Pairing(
        both=pairs.count((True, True)),
        only_first=pairs.count((True, False)),
        only_second=pairs.count((False, True)),
        neither=pairs.count((False, False)),
    )
