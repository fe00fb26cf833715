"""Disturbances along z: a rectangular force pulse and an ideal impulse (decision D6)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.values import (
    Checked,
    Positive,
    Time,
    check_fields,
    instant,
    require_finite,
)

LARGEST = 1e5
"""Largest force [N] or momentum [N s] of a disturbance that a simulator has to handle."""


def require_moderate(thing: str, value: object) -> float:
    """Return `value` as a float, or raise unless its absolute value is at most `LARGEST`."""
    number = require_finite(thing, value)
    if abs(number) > LARGEST:
        raise InvalidValueError(thing, f"must be at most {LARGEST:g} in absolute value", number)
    return number


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

    force: Annotated[float, require_moderate]
    start: Time
    duration: Positive

    def __post_init__(self) -> None:
        """Validate every field and store it as a float."""
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

    def force_at(self, time: float) -> float:
        """Return the force [N] at `time`, after the edge if there is one.

        Parameters
        ----------
        time
            Time [s].
        """
        return self.force if self.start <= time < self.end else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Impulse(Checked):
    """An ideal impulse on the cart: a jump of the momentum along z at one instant.

    Attributes
    ----------
    momentum
        Jump of the generalised momentum of z [N s].
    time
        When it acts [s], not negative.
    """

    momentum: Annotated[float, require_moderate]
    time: Time

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """The instant [s]."""
        return (self.time,)
