"""How a threshold compares with the reference hardware."""

from __future__ import annotations

from afl_mujoco.document.numbers import short
from afl_mujoco.scenario.imperfections import Imperfection
from afl_mujoco.studies.bisection import LOWER, UPPER, Threshold
from afl_mujoco.studies.thresholds.imperfections import COMBINED
from afl_mujoco.studies.thresholds.result import Result, Sweep

FAILS, LITTLE, SOME, MUCH, IDLE = range(5)
"""Classes of a threshold: the reference hardware fails; it is survived with less than 3 times, less
than 10 times, or at least 10 times to spare; the imperfection does not act on the controller."""

CLASSES = (
    "fails on the reference hardware",
    "less than 3 × to spare",
    "3 to 10 × to spare",
    "more than 10 ×, or all that was tried",
    "the force does not depend on it",
)


def level_text(imperfection: Imperfection, level: float) -> str:
    """Return a level [SI] in the unit of its imperfection, with two digits."""
    digits = 3 if imperfection.name == COMBINED.name else 2  # near 1 a third digit matters
    return short(imperfection.scale * level, digits)


def unit_text(result: Result, imperfection: Imperfection) -> str:
    """Return the unit of a level, and whether it is the total where the scenario has its own."""
    own = [s.hardware(key) for s in result.scenarios for key in list(imperfection.fields)[:1]]
    if not any(own):
        return imperfection.unit
    return f"{imperfection.unit}, {'added' if imperfection.adds else 'total'}"


def threshold_text(imperfection: Imperfection, threshold: Threshold) -> str:
    """Return a threshold: the level of the failure, or that all levels hold or none."""
    past, before = ("<", ">") if imperfection.less_is_worse else (">", "<")
    if threshold.fails_at is None:
        return f"{past} {level_text(imperfection, reached(threshold))}"
    sign = f"{before} " if threshold.bound == UPPER else ""
    return f"{sign}{level_text(imperfection, threshold.fails_at)}"


def reached(threshold: Threshold) -> float:
    """Return the level of a threshold: that of the failure, or the last one tried."""
    level = threshold.holds_at if threshold.fails_at is None else threshold.fails_at
    if level is None:
        raise ValueError("a threshold needs a level")
    return level


def tolerated(imperfection: Imperfection, sweep: Sweep) -> float:
    """Return how many times the reference level was survived at most; 0 if no level was."""
    level = sweep.survives.holds_at
    return 0.0 if level is None else times_reference(imperfection, level)


def times_reference(imperfection: Imperfection, level: float) -> float:
    """Return how many times worse than the reference a level is."""
    ratio = level / imperfection.reference
    return round(1.0 / ratio if imperfection.less_is_worse else ratio, 9)  # 10 is 10


def class_of(imperfection: Imperfection, sweep: Sweep) -> int:
    """Return the class of a sweep: `FAILS`, `LITTLE`, `SOME` or `MUCH`."""
    if not sweep.applies:
        return IDLE
    if not sweep.reference.survives:
        return FAILS
    if sweep.survives.bound == LOWER:
        return MUCH
    ratio = tolerated(imperfection, sweep)
    return MUCH if ratio >= 10.0 else SOME if ratio >= 3.0 else LITTLE


def unsettled(sweep: Sweep) -> bool:
    """Return whether a controller survives the reference hardware but does not settle on it."""
    return sweep.reference.survives and not sweep.reference.settles
