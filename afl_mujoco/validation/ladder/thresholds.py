"""Where something stops holding: a scan on a logarithmic grid, then bisection."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from afl_mujoco.errors import InvalidValueError

ABOVE, BELOW, BETWEEN = "above", "below", "between"
"""It holds on the whole range; it holds nowhere on it; the threshold lies on the range."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Threshold:
    """Where a property is lost on the way from a benign level to a harsh one.

    Attributes
    ----------
    place
        `ABOVE`, `BELOW` or `BETWEEN`.
    holds_at
        Harshest level found at which it and everything more benign that was tried holds.
    fails_at
        Most benign level found at which it does not hold.
    islands
        How many harsher levels of the scan hold again: with any, the property is not monotone.
    """

    place: str
    holds_at: float | None
    fails_at: float | None
    islands: int


def scan_levels(benign: float, harsh: float, count: int) -> list[float]:
    """Return levels from benign to harsh, evenly spaced in their logarithm.

    Parameters
    ----------
    benign, harsh
        The ends, positive and different.
    count
        How many, at least two.

    Raises
    ------
    InvalidValueError
        If there is no such scan.
    """
    if not (benign > 0.0 and harsh > 0.0 and benign != harsh):
        raise InvalidValueError("levels", "must be positive and differ", (benign, harsh))
    if count < 2:
        raise InvalidValueError("scan", "must have at least 2 levels", count)
    levels: list[float] = np.geomspace(benign, harsh, count).tolist()
    return levels


def find_threshold(
    holds: Callable[[float], bool],
    scan: list[float],
    tolerance: float,
    snapped: Callable[[float], float] = lambda level: level,
) -> Threshold:
    """Return where a property is lost first.

    Parameters
    ----------
    holds
        Whether it holds at a level.
    scan
        From `scan_levels`; all are tried.
    tolerance
        Largest relative width of the bracket, unless no level lies within it [1].
    snapped
        Returns the nearest level that there is.
    """
    levels = list(dict.fromkeys(snapped(level) for level in scan))
    found = [holds(level) for level in levels]
    if all(found):
        return Threshold(place=ABOVE, holds_at=levels[-1], fails_at=None, islands=0)
    first = found.index(False)
    islands = sum(found[first:])
    if first == 0:
        return Threshold(place=BELOW, holds_at=None, fails_at=levels[0], islands=islands)
    good, bad = levels[first - 1], levels[first]
    while abs(math.log(bad / good)) > math.log1p(tolerance):
        middle = snapped(math.sqrt(good * bad))
        if middle in (good, bad):
            break
        if holds(middle):
            good = middle
        else:
            bad = middle
    return Threshold(place=BETWEEN, holds_at=good, fails_at=bad, islands=islands)
