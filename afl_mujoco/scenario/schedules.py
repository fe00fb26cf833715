"""What changes with time: parameters by piecewise-linear schedules, inputs by disturbances."""

from __future__ import annotations

import itertools
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from afl_mujoco.errors import InvalidValueError, UnknownNameError
from afl_mujoco.plants.plant import Floats, Plant
from afl_mujoco.values import (
    Checked,
    Positive,
    Text,
    Time,
    check_fields,
    instant,
    require_finite,
    require_type,
)


@dataclass(frozen=True, slots=True)
class Schedule:
    """A piecewise-linear function of time, constant before its first knot and after its last.

    A time given twice is a jump; at the jump itself the schedule has the value after it.
    Build one with `constant`, `staircase`, `trapezoid`, `piecewise_linear` or `joined`.

    Parameters
    ----------
    times
        Knots [s], increasing, kept to the picosecond; a time given twice is a jump.
    values
        The value at each knot.

    Raises
    ------
    InvalidValueError
        If the knots are empty, not finite, of unequal number or out of order.
    """

    times: tuple[float, ...]
    values: tuple[float, ...]
    _rates: tuple[float, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        require_type("times", self.times, Iterable)
        require_type("values", self.values, Iterable)
        times = tuple(instant(require_finite("times", t)) for t in self.times)
        values = tuple(require_finite("values", v) for v in self.values)
        if not times:
            raise InvalidValueError("times", "must hold at least one time")
        if len(times) != len(values):
            rule = f"must be as many as times ({len(times)})"
            raise InvalidValueError("values", rule, len(values))
        for before, after in itertools.pairwise(times):
            if after < before:
                raise InvalidValueError("times", "must increase", f"{after} after {before}")
        for first, third in zip(times, times[2:], strict=False):
            if first == third:
                raise InvalidValueError("times", "may repeat a time once, for a jump", third)
        lines = itertools.pairwise(zip(times, values, strict=True))
        rates = tuple((w - v) / (t - s) if t > s else 0.0 for (s, v), (t, w) in lines)
        if not np.isfinite(rates).all():
            raise InvalidValueError("times", "must be far enough apart for a finite slope")
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "_rates", (*rates, 0.0))

    def __repr__(self) -> str:
        """Return the call that makes it, of `constant` where that is shorter."""
        if self.times == (0.0,):
            return f"constant({self.values[0]!r})"
        return f"Schedule(times={self.times!r}, values={self.values!r})"

    @property
    def knots(self) -> Floats:
        """Time [s] and value of each knot, shape (knots, 2)."""
        return np.column_stack([self.times, self.values])

    def at(self, time: float) -> float:
        """Return the value at one time, after the jump if there is one.

        Parameters
        ----------
        time
            Time [s].
        """
        value, _ = self.piece(time)
        return value

    def before(self, time: float) -> float:
        """Return the value at one time, before the jump if there is one.

        Parameters
        ----------
        time
            Time [s].
        """
        k = bisect_left(self.times, time)
        if k < len(self.times) and self.times[k] == time:  # without the rounding of a slope
            return self.values[k]
        return self._line(k - 1, time)[0]

    def piece(self, time: float) -> tuple[float, float]:
        """Return value and slope at `time`, valid from there to the next breakpoint.

        Parameters
        ----------
        time
            Time [s].

        Returns
        -------
        tuple of float
            The value just after `time` and the slope [1/s] there.
        """
        return self._line(bisect_right(self.times, time) - 1, time)

    def _line(self, index: int, time: float) -> tuple[float, float]:
        """Return value and slope at `time` on the line that starts at knot `index`."""
        if index < 0:
            return self.values[0], 0.0
        rate = self._rates[index]
        return self.values[index] + rate * (time - self.times[index]), rate

    def __call__(self, time: ArrayLike) -> Floats:
        """Return the values at times [s] of any shape, after the jump where there is one."""
        t = np.asarray(time, dtype=np.float64)
        found = np.searchsorted(self.times, t, side="right") - 1
        index = np.maximum(found, 0)
        elapsed = np.where(found < 0, 0.0, t - np.asarray(self.times)[index])
        result: Floats = np.asarray(self.values)[index] + np.asarray(self._rates)[index] * elapsed
        return result

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times [s] at which the schedule jumps or changes slope."""
        jumps = {t for t, after in itertools.pairwise(self.times) if t == after}
        knots = zip(self.times, (0.0, *self._rates[:-1]), self._rates, strict=True)
        return tuple(dict.fromkeys(t for t, old, new in knots if t in jumps or old != new))


def constant(value: float) -> Schedule:
    """Return the schedule that always has `value`.

    Parameters
    ----------
    value
        The value.
    """
    return Schedule((0.0,), (require_finite("value", value),))


def staircase(times: Sequence[float], values: Sequence[float]) -> Schedule:
    """Return the staircase that jumps to ``values[i + 1]`` at ``times[i]``.

    Parameters
    ----------
    times
        Times of the jumps [s], shape (J,), increasing.
    values
        The levels, shape (J + 1,).

    Raises
    ------
    InvalidValueError
        If the numbers of times and levels do not match, or the times do not increase.
    """
    times, values = _listed("times", times), _listed("values", values)
    if len(values) != len(times) + 1:
        rule = f"must be one more than the times ({len(times)})"
        raise InvalidValueError("values", rule, len(values))
    _require_increasing("times", times)
    if not times:
        return constant(values[0])
    return Schedule(
        tuple(t for t in times for _ in range(2)),
        tuple(v for pair in itertools.pairwise(values) for v in pair),
    )


def trapezoid(times: Sequence[float], low: float, high: float) -> Schedule:
    """Return the trapezoid that ramps from `low` to `high` and back.

    Parameters
    ----------
    times
        Start and end of the ramp up, start and end of the ramp down [s], shape (4,), increasing.
    low, high
        The two levels.

    Raises
    ------
    InvalidValueError
        If there are not four increasing times.
    """
    times = _listed("times", times)
    if len(times) != 4:
        raise InvalidValueError("times", "must be four for a trapezoid", len(times))
    _require_increasing("times", times)
    low, high = require_finite("low", low), require_finite("high", high)
    return Schedule(times, (low, high, high, low))


def piecewise_linear(times: Sequence[float], values: Sequence[float]) -> Schedule:
    """Return the schedule that joins the knots of a table by straight lines.

    Parameters
    ----------
    times
        Knots [s], shape (K,), increasing; a time given twice is a jump.
    values
        The value at each knot, shape (K,).
    """
    return Schedule(_listed("times", times), _listed("values", values))


def joined(starts: Sequence[float], pieces: Sequence[Schedule]) -> Schedule:
    """Return the schedule that follows each piece from its start to the start of the next.

    Each piece runs on its own clock, which reads zero at its start.

    Parameters
    ----------
    starts
        Start of each piece [s], shape (J,), increasing.
    pieces
        The pieces, shape (J,).

    Raises
    ------
    InvalidValueError
        If there is no piece, the numbers of starts and pieces differ, or the starts do not
        increase.
    """
    starts, pieces = _listed("starts", starts), _listed("pieces", pieces)
    for piece in pieces:
        require_type("piece", piece, Schedule)
    if not pieces or len(starts) != len(pieces):
        rule = f"must be as many as the pieces ({len(pieces)}), at least one"
        raise InvalidValueError("starts", rule, len(starts))
    _require_increasing("starts", starts)
    knots: list[tuple[float, float]] = []
    for start, end, piece in zip(starts, [*starts[1:], np.inf], pieces, strict=True):
        inner = [(t, v) for t, v in zip(piece.times, piece.values, strict=True) if t > 0.0]
        knots.append((start, piece.at(0.0)))
        knots += [(start + t, v) for t, v in inner if start + t < end]
        if np.isfinite(end):
            cut_off = [t for t, _ in inner if start + t >= end]
            knots.append((end, piece.before(min([end - start, *cut_off]))))
    kept = [knot for knot, _ in itertools.groupby(knots)]
    return Schedule(tuple(t for t, _ in kept), tuple(v for _, v in kept))


def _listed(thing: str, values: Iterable[Any]) -> tuple[Any, ...]:
    require_type(thing, values, Iterable)
    return tuple(values)


def _require_increasing(thing: str, times: Sequence[float]) -> None:
    finite = [require_finite(thing, t) for t in times]
    for before, after in itertools.pairwise(finite):
        if after <= before:
            raise InvalidValueError(thing, "must increase", f"{after} after {before}")


LARGEST = 1e5  # largest force [N] or momentum [N s] of a disturbance that a simulator has to handle


def require_moderate(thing: str, value: object) -> float:
    """Return `value` as a float, or raise unless its absolute value is at most `LARGEST`."""
    number = require_finite(thing, value)
    if abs(number) > LARGEST:
        raise InvalidValueError(thing, f"must be at most {LARGEST:g} in absolute value", number)
    return number


@dataclass(frozen=True, slots=True, kw_only=True)
class ForcePulse:
    """A constant force over ``start <= t < start + duration``, to the picosecond.

    Attributes
    ----------
    force
        The force [N], or torque [N m].
    start
        When it begins [s], not negative.
    duration
        How long it lasts [s], positive.
    input, coordinate
        Where it acts: beside the drive of an input, or along a coordinate [N, N m]; on the only
        input by default.
    """

    force: Annotated[float, require_moderate]
    start: Time
    duration: Positive
    input: Text = ""
    coordinate: Text = ""

    def __post_init__(self) -> None:
        check_fields(self)
        if not self.start < self.end:
            rule = "must be at least a picosecond"
            raise InvalidValueError("duration", rule, f"{self.duration:g} s")

    @property
    def end(self) -> float:
        """When the pulse ends [s]."""
        return instant(self.start + self.duration)

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """The two edges [s]."""
        return self.start, self.end


@dataclass(frozen=True, slots=True, kw_only=True)
class Impulse(Checked):
    """An ideal impulse: a jump of a momentum at one instant.

    Attributes
    ----------
    momentum
        Jump of the generalised momentum [N s, N m s].
    time
        When it acts [s], not negative.
    input, coordinate
        Where it acts, as in `ForcePulse`.
    """

    momentum: Annotated[float, require_moderate]
    time: Time
    input: Text = ""
    coordinate: Text = ""

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """The instant [s]."""
        return (self.time,)


def channels_of(plant: Plant) -> tuple[str, ...]:
    """Return where disturbances can act: on inputs, then along coordinates."""
    return (*plant.inputs, *plant.coordinates)


def channel_of(one: ForcePulse | Impulse, plant: Plant, thing: str = "disturbance") -> int:
    """Return which of the channels of a plant a disturbance acts on, or raise."""
    if one.input and one.coordinate:
        raise InvalidValueError(thing, "must act on an input or a coordinate, not both")
    if one.coordinate:
        if one.coordinate not in plant.coordinates:
            raise UnknownNameError.among(f"{thing}.coordinate", one.coordinate, plant.coordinates)
        return len(plant.inputs) + plant.coordinates.index(one.coordinate)
    if one.input:
        if one.input not in plant.inputs:
            raise UnknownNameError.among(f"{thing}.input", one.input, plant.inputs)
        return plant.inputs.index(one.input)
    if len(plant.inputs) != 1:
        inputs, others = ", ".join(plant.inputs), ", ".join(plant.coordinates)
        rule = f"must say its input ({inputs or 'none'}) or its coordinate ({others})"
        raise InvalidValueError(thing, rule)
    return 0
