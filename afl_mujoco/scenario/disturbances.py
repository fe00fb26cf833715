"""Disturbances of an input or a coordinate: a force pulse, an ideal impulse (decision D6)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from afl_mujoco.errors import InvalidValueError, UnknownNameError
from afl_mujoco.plants.plant import Plant
from afl_mujoco.values import Checked, Positive, Text, Time, check_fields, instant, require_finite

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


def channel_of(one: ForcePulse | Impulse, plant: Plant) -> int:
    """Return which of the channels of a plant a disturbance acts on, or raise."""
    if one.input and one.coordinate:
        raise InvalidValueError("disturbance", "must act on an input or a coordinate, not both")
    if one.coordinate:
        if one.coordinate not in plant.coordinates:
            raise UnknownNameError.among("coordinate", one.coordinate, plant.coordinates)
        return len(plant.inputs) + plant.coordinates.index(one.coordinate)
    if one.input:
        if one.input not in plant.inputs:
            raise UnknownNameError.among("input", one.input, plant.inputs)
        return plant.inputs.index(one.input)
    if len(plant.inputs) != 1:
        known = ", ".join(channels_of(plant))
        rule = f"must say its input or coordinate, for there are several: {known}"
        raise InvalidValueError("disturbance", rule)
    return 0
