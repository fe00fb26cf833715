"""Rates with their intervals, and two controllers compared on the same samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from scipy.stats import binomtest

from afl_mujoco.errors import InvalidValueError

CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True)
class Rate:
    """A count out of a total.

    Attributes
    ----------
    count, of
        The count and the total.

    Raises
    ------
    InvalidValueError
        If the total is zero, or the count is negative or above the total.
    """

    count: int
    of: int

    def __post_init__(self) -> None:
        """Check that it is a share."""
        if not 0 <= self.count <= self.of or self.of < 1:
            raise InvalidValueError("rate", "must be a share of at least one", str(self))

    def __str__(self) -> str:
        """Return the rate as a table shows it."""
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
        Numbers of samples that both passed, only one of them, or neither.
    """

    both: int
    only_first: int
    only_second: int
    neither: int

    @property
    def p_value(self) -> float:
        """McNemar's exact test: how likely a split this uneven is if both are equally good."""
        split = self.only_first + self.only_second
        return float(binomtest(self.only_first, split, 0.5).pvalue) if split else 1.0


def pair(first: Sequence[bool], second: Sequence[bool]) -> Pairing:
    """Return how many samples both, one or neither passed."""
    pairs = list(zip(first, second, strict=True))
    return Pairing(
        both=pairs.count((True, True)),
        only_first=pairs.count((True, False)),
        only_second=pairs.count((False, True)),
        neither=pairs.count((False, False)),
    )
