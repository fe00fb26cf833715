"""Disturbances along z: a rectangular force pulse and an ideal impulse (decision D6)."""

from __future__ import annotations

from dataclasses import dataclass

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.parameters import instant, require_finite, require_positive

LARGEST = 1e5
"""Largest force [N] or momentum [N s] of a disturbance that a simulator has to handle."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ForcePulse:
    """A constant force on the cart over ``start <= t < start + duration``, to the picosecond.

    Attributes
    ----------
    force
        Force along z [N].
    start
        When it begins [s], not negative.
    duration
        How long it lasts [s], positive.
    """

    force: float
    start: float
    duration: float

    def __post_init__(self) -> None:
        """Validate every field and store it as a float."""
        object.__setattr__(self, "force", _require_moderate("force", self.force))
        object.__setattr__(self, "start", _require_time("start", self.start))
        object.__setattr__(self, "duration", require_positive("duration", self.duration))
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

    def force_at(self, time: float) -> float:
        """Return the force [N] at `time`, after the edge if there is one.

        Parameters
        ----------
        time
            Time [s].
        """
        return self.force if self.start <= time < self.end else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Impulse:
    """An ideal impulse on the cart: a jump of the momentum along z at one instant.

    Attributes
    ----------
    momentum
        Jump of the generalised momentum of z [N s].
    time
        When it acts [s], not negative.
    """

    momentum: float
    time: float

    def __post_init__(self) -> None:
        """Validate every field and store it as a float."""
        object.__setattr__(self, "momentum", _require_moderate("momentum", self.momentum))
        object.__setattr__(self, "time", _require_time("time", self.time))

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """The instant [s]."""
        return (self.time,)


def _require_moderate(thing: str, value: object) -> float:
    """Return `value` as a float, or raise unless its absolute value is at most `LARGEST`."""
    number = require_finite(thing, value)
    if abs(number) > LARGEST:
        raise InvalidValueError(thing, f"must be at most {LARGEST:g} in absolute value", number)
    return number


def _require_time(thing: str, value: object) -> float:
    """Return `value` as a float, or raise unless it is finite and not negative."""
    time = instant(require_finite(thing, value))
    if time < 0.0:
        raise InvalidValueError(thing, "must not be negative", time)
    return time
