"""How an estimate of M or l follows the truth: error, time to find a step, lag on a ramp."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.scenario.schedules import Schedule

Array = NDArray[np.float64]

WINDOWS = {"0.05-1 s": (0.05, 1.0), "1-6 s": (1.0, 6.0), "6 s to the end": (6.0, math.inf)}
"""Time windows over which the error is judged [s]: after the start, while the paper's plants
change by steps, and after that."""

FOUND = 0.1
"""Relative error within which an estimate counts as found."""

SETTLING = 0.2
"""Time at the beginning of a ramp that is left out of its lag [s]."""

_BESIDE = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """A jump of the truth.

    Attributes
    ----------
    at
        Time of the jump [s].
    reached_after
        Time from the jump until the estimate is first within `FOUND` of the truth [s]; ``None`` if
        it never is before the next change of the truth.
    found_after
        Time from the jump until the estimate stays within `FOUND` up to the next change of the
        truth [s]; ``None`` if it does not.
    """

    at: float
    reached_after: float | None
    found_after: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Ramp:
    """A stretch of time in which the truth changes at a constant rate.

    Attributes
    ----------
    start, end
        Its first and last instant [s].
    lag
        Mean of (truth - estimate) / rate from `SETTLING` after the start on [s]; ``None`` for a
        shorter ramp.
    """

    start: float
    end: float
    lag: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Tracking:
    """How one estimate follows the truth.

    Attributes
    ----------
    rms
        Root mean square of ln(estimate / truth) in each of `WINDOWS`; ``None`` if the run has no
        instant there.
    steps, ramps
        Changes of the truth, and how the estimate follows them.
    """

    rms: dict[str, float | None]
    steps: tuple[Step, ...]
    ramps: tuple[Ramp, ...]


def tracking(truth: Schedule, time: Array, estimate: Array) -> Tracking:
    """Return how an estimate follows the truth.

    Parameters
    ----------
    truth
        M [kg] or l [m] over time.
    time
        Instants of the estimates [s], shape (T,), from 0 on.
    estimate
        Estimates of the truth, shape (T,).
    """
    error = np.log(estimate / truth(time))
    end = float(time[-1])
    edges = sorted({0.0, *(t for t in truth.breakpoints if 0.0 < t < end), end})
    spans = list(itertools.pairwise(edges))
    return Tracking(
        rms={name: _rms(error[_within(time, *span)]) for name, span in WINDOWS.items()},
        steps=tuple(
            _step(time, error, start, stop)
            for start, stop in spans
            if start > 0.0 and _differ(truth.before(start), truth.at(start))
        ),
        ramps=tuple(
            Ramp(start=start, end=stop, lag=_lag(truth, time, estimate, start, stop))
            for start, stop in spans
            if _rate(truth, start, stop)
        ),
    )


def _within(time: Array, start: float, end: float) -> NDArray[np.bool_]:
    """Return which instants lie in a stretch of time, excluding its end."""
    return np.asarray((time >= start - _BESIDE) & (time < end - _BESIDE))


def _rms(error: Array) -> float | None:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(error**2))) if len(error) else None


def _differ(one: float, other: float) -> bool:
    """Return whether two values differ by more than rounding."""
    return not math.isclose(one, other, rel_tol=1e-6)


def _rate(truth: Schedule, start: float, end: float) -> float:
    """Return how fast the truth changes between two breakpoints; 0 if only by rounding."""
    first, last = truth.at(start), truth.before(end)
    return (last - first) / (end - start) if _differ(first, last) else 0.0


def _step(time: Array, error: Array, start: float, end: float) -> Step:
    """Return how an estimate follows a step of the truth, up to `end`."""
    part = _within(time, start, end)
    near = np.abs(error[part]) <= math.log1p(FOUND)
    late = [float(t) for t in time[part] - start] + [None]
    outside = np.flatnonzero(~near)
    return Step(
        at=start,
        reached_after=late[int(near.argmax())] if near.any() else None,
        found_after=late[int(outside[-1]) + 1] if len(outside) else 0.0,
    )


def _lag(truth: Schedule, time: Array, estimate: Array, start: float, end: float) -> float | None:
    """Return how late the estimate is on a ramp."""
    part = _within(time, start + SETTLING, end)
    if not part.any():
        return None
    late = (truth(time[part]) - estimate[part]) / _rate(truth, start, end)
    return float(np.mean(late))
