"""What a ladder's thresholds say, in words and classes; from the plain data of ladder.json."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from afl_mujoco.document.numbers import short
from afl_mujoco.validation.ladder.thresholds import ABOVE, BELOW

Row = Mapping[str, Any]

TIMES = "× rig"
"""Unit of a whole rig, whose threshold near 1 deserves a third digit."""

FAILS, LITTLE, SOME, MUCH = range(4)
"""Classes of a threshold: the typical rig fails; it survives with less than 3 times, less than 10
times, or at least 10 times to spare."""

CLASSES = (
    "fails on a typical rig",
    "survives, less than 3 × to spare",
    "3 to 10 × to spare",
    "more than 10 ×, or all that was tried",
)


def rise_of(ladder: Row, rung: str, controller: str) -> Row:
    """Return one controller on one rung.

    Parameters
    ----------
    ladder
        What a ladder.json holds.
    rung, controller
        Names.
    """
    found: Row = next(
        rise for rise in ladder["rises"] if (rise["rung"], rise["controller"]) == (rung, controller)
    )
    return found


def level_text(rung: Row, level: float) -> str:
    """Return a level in the unit of its rung, with two or three digits.

    Parameters
    ----------
    rung
        As of ladder.json.
    level
        In SI units.
    """
    return short(rung["scale"] * level, 3 if rung["unit"] == TIMES else 2)


def threshold_text(rung: Row, threshold: Row) -> str:
    """Return a threshold: the level of the failure, or that all or no level holds.

    Parameters
    ----------
    rung
        As of ladder.json.
    threshold
        Of one of its rises.
    """
    past, before = ("<", ">") if rung["less_is_worse"] else (">", "<")
    if threshold["place"] == ABOVE:
        return f"{past} {level_text(rung, threshold['holds_at'])}"
    if threshold["place"] == BELOW:
        return f"{before} {level_text(rung, threshold['fails_at'])}"
    return level_text(rung, threshold["fails_at"])


def borne(rung: Row, rise: Row) -> float:
    """Return how many times the size of a typical rig's flaw was seen to be survived.

    Parameters
    ----------
    rung
        As of ladder.json.
    rise
        One of its rises; 0 where no level was survived.
    """
    level = rise["survives"]["holds_at"]
    if level is None:
        return 0.0
    ratio = level / rung["typical"]
    return float(1.0 / ratio if rung["less_is_worse"] else ratio)


def class_of(rung: Row, rise: Row) -> int:
    """Return the class of a rise: `FAILS`, `LITTLE`, `SOME` or `MUCH`.

    Parameters
    ----------
    rung
        As of ladder.json.
    rise
        One of its rises.
    """
    if not rise["typical"]["survives"]:
        return FAILS
    if rise["survives"]["place"] == ABOVE:
        return MUCH
    ratio = borne(rung, rise)
    return MUCH if ratio >= 10.0 else SOME if ratio >= 3.0 else LITTLE


def settles_at_typical(rise: Row) -> bool:
    """Return whether the typical rig settles within the bands.

    Parameters
    ----------
    rise
        As of ladder.json.
    """
    return bool(rise["typical"]["settles"])
