"""Where something stops holding: a scan on a logarithmic grid, then bisection."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from afl_mujoco.errors import InvalidValueError

LOWER, UPPER, BRACKETED = "lower", "upper", "bracketed"
"""What is known about a threshold: a lower bound, if the property holds on the whole range; an
upper bound, if it holds nowhere on it; or both."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Threshold:
    """Where a property is lost on the way from a benign level to a harsh one."""

    bound: str  # `LOWER`, `UPPER` or `BRACKETED`
    # harshest level found such that it and every more benign level tried hold
    holds_at: float | None
    fails_at: float | None  # most benign level found at which it does not hold
    # number of harsher levels tried that hold again; if there are any, the property is not monotone
    islands: int


def scan_levels(benign: float, harsh: float, count: int) -> list[float]:
    """Return levels from benign to harsh, evenly spaced in their logarithm."""
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
    *,
    closer: int = 0,
) -> Threshold:
    """Return the first level at which a property is lost.

    tolerance: Largest relative width of the bracket, unless no level lies within it [1].
    """
    known: dict[float, bool] = {}

    def tried(level: float) -> bool:
        if level not in known:
            known[level] = holds(level)
        return known[level]

    levels = list(dict.fromkeys(snapped(level) for level in scan))
    found = [tried(level) for level in levels]
    if all(found):
        return Threshold(bound=LOWER, holds_at=levels[-1], fails_at=None, islands=0)
    first = found.index(False)
    if first == 0:
        return Threshold(bound=UPPER, holds_at=None, fails_at=levels[0], islands=sum(found))
    good, bad = _bisected(tried, levels[first - 1], levels[first], tolerance, snapped)
    ratio = math.sqrt(1.0 + tolerance) ** (1 if levels[0] > levels[-1] else -1)
    good, bad = _descended(tried, good, bad, levels[0], lambda x: x * ratio, snapped, closer)
    harsher = [level for level in known if abs(math.log(level / levels[0])) > _far(bad, levels[0])]
    islands = sum(known[level] for level in harsher)
    return Threshold(bound=BRACKETED, holds_at=good, fails_at=bad, islands=islands)


def _far(level: float, benign: float) -> float:
    """Return how far a level is from the benign end."""
    return abs(math.log(level / benign))


def _bisected(
    holds: Callable[[float], bool],
    good: float,
    bad: float,
    tolerance: float,
    snapped: Callable[[float], float],
) -> tuple[float, float]:
    """Narrow a bracket."""
    while abs(math.log(bad / good)) > math.log1p(tolerance):
        middle = snapped(math.sqrt(good * bad))
        if middle in (good, bad):
            break
        if holds(middle):
            good = middle
        else:
            bad = middle
    return good, bad


def _descended(
    holds: Callable[[float], bool],
    good: float,
    bad: float,
    benign: float,
    eased: Callable[[float], float],
    snapped: Callable[[float], float],
    closer: int,
) -> tuple[float, float]:
    """Move a bracket to the benign side until the `closer` levels beside it hold."""
    level, clean, lost = good, 0, False
    while clean < closer:
        level = eased(level)
        at = snapped(level) if _far(level, bad) < _far(benign, bad) else benign
        if not holds(at):
            bad, clean, lost = at, 0, True
            continue
        if lost:
            good, lost = at, False
        if at == benign:
            break
        clean += 1
    return good, bad
