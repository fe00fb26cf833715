"""The settings of the estimator of M and l, and the record of them for compiled code."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.parameters import (
    CART_MASSES,
    HALF_LENGTHS,
    CartPoleParameters,
    PlantRange,
    require_positive,
    require_type,
)

SETTINGS = np.dtype(
    [
        *(("position_variance", np.float64), ("angle_variance", np.float64)),
        ("acceleration_intensity", np.float64),
        *(
            (name, np.float64, (2,))  # of M, then of l
            for name in (
                *("least_variance", "least_excitation"),
                *("ln_start", "ln_variance", "ln_lowest", "ln_highest"),
            )
        ),
        *(("speed_variance", np.float64), ("rate_variance", np.float64)),
        *(("excitation_memory", np.float64), ("pole_mass", np.float64), ("gravity", np.float64)),
        ("force_sensed", np.int64),
    ]
)
"""The settings as the compiled estimator takes them, SI units."""

_RANGES = ("cart_mass_range", "half_length_range")


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimatorSettings:
    """What the estimator assumes of the hardware, and how accurate each assumption is."""

    # standard deviation of the measured z [m] and phi [rad]; for an encoder that only rounds, its
    # step over the square root of 12. The defaults are for steps of 0.35 mm and 3600 counts per
    # turn
    position_noise: float = 1e-4
    angle_noise: float = 5e-4
    # intensity of the white acceleration of the cart that the model does not know, from forces that
    # are not measured [m/s^2/sqrt(Hz)]. A larger value makes the estimate of M more robust against
    # friction, and more biased at rest: the controller reacts to the noise that passes the filter
    acceleration_noise: float = 0.01
    # least relative standard deviation of M and l while the motion is excited [1]: it keeps the
    # filter able to follow a change of M or l
    cart_mass_accuracy: float = 0.1
    half_length_accuracy: float = 0.1
    # excitation: an estimate of M or l that has reached that accuracy is frozen while the moving
    # mean of z'' or of l phi'' is smaller than this [m/s^2]: what moves a settled cart-pole is the
    # noise of its own sensors, from which nothing is learned
    least_cart_acceleration: float = 0.05
    least_pole_acceleration: float = 0.03
    excitation_memory: float = 0.3  # time constant of that moving mean [s]
    # M and l assumed before the first measurement [kg, m]. A light cart makes the first force
    # gentle: an estimate that is too light costs milliseconds, one that is too heavy can cost the
    # run
    initial_cart_mass: float = 0.1
    initial_half_length: float = 0.5
    # standard deviation of the logarithms of M and l before the first measurement [1]
    cart_mass_spread: float = 1.5
    half_length_spread: float = 1.0
    # standard deviation of the velocities, which are assumed to be zero then [m/s, rad/s]
    speed_spread: float = 1.0
    rate_spread: float = 1.0
    # least and largest M [kg] and l [m] that are ever assumed, as one knows them of the hardware
    # and its loads. By default the box of the paper, widened by a quarter at either end, and half
    # to twice the M and l at the start of a run: the plant as it is set up is known, what it
    # becomes is not. A plant beyond them is estimated at the bound, which a remark says
    cart_mass_range: tuple[float, float] | None = None
    half_length_range: tuple[float, float] | None = None
    # m [kg] and g [m/s^2], which are known: by default those of the scenario
    pole_mass: float | None = None
    gravity: float | None = None
    # whether the drive reports the force that it exerts, as a drive that measures its current does.
    # Otherwise the estimator gets the command, cut off at the force limit, which ignores a delay, a
    # slew rate or a lag of the drive
    force_sensed: bool = False

    def __post_init__(self) -> None:
        """Validate every field and store its numbers as floats."""
        require_type("force_sensed", self.force_sensed, bool)
        for field in fields(self)[:-1]:
            name, value = field.name, getattr(self, field.name)
            if value is None and field.default is None:
                continue
            checked = _range(name, value) if name in _RANGES else require_positive(name, value)
            object.__setattr__(self, name, checked)
        for name in ("cart_mass", "half_length"):
            least, largest = getattr(self, f"{name}_range") or (0.0, math.inf)
            value = getattr(self, f"initial_{name}")
            if not least <= value <= largest:
                rule = f"must lie in {name}_range, {least:g} to {largest:g}"
                raise InvalidValueError(f"initial_{name}", rule, value)

    def on(self, start: CartPoleParameters) -> tuple[Any, PlantRange]:
        """Return the settings for the compiled estimator, and the plants that it may assume."""
        masses = self.cart_mass_range or _around(
            start.cart_mass, (*CART_MASSES, self.initial_cart_mass)
        )
        lengths = self.half_length_range or _around(
            start.half_length, (*HALF_LENGTHS, self.initial_half_length)
        )
        pole_mass = start.pole_mass if self.pole_mass is None else self.pole_mass
        gravity = start.gravity if self.gravity is None else self.gravity
        assumed = PlantRange(masses, lengths, pole_mass, gravity)
        return self._record(assumed), assumed

    def _record(self, assumed: PlantRange) -> Any:
        """Return the settings as the compiled estimator takes them."""
        found = np.zeros(1, SETTINGS)
        lowest, highest = np.log([assumed.cart_mass, assumed.half_length]).T
        values = {
            "position_variance": self.position_noise**2,
            "angle_variance": self.angle_noise**2,
            "acceleration_intensity": self.acceleration_noise**2,
            "least_variance": (self.cart_mass_accuracy**2, self.half_length_accuracy**2),
            "least_excitation": (self.least_cart_acceleration, self.least_pole_acceleration),
            "ln_start": np.log((self.initial_cart_mass, self.initial_half_length)),
            "ln_variance": (self.cart_mass_spread**2, self.half_length_spread**2),
            "ln_lowest": lowest,
            "ln_highest": highest,
            "speed_variance": self.speed_spread**2,
            "rate_variance": self.rate_spread**2,
            "excitation_memory": self.excitation_memory,
            "pole_mass": assumed.pole_mass,
            "gravity": assumed.gravity,
            "force_sensed": self.force_sensed,
        }
        for name, value in values.items():
            found[name] = value
        return found[0]


MORE = 1.25
"""Factor by which an estimate may go beyond the usual plants at either end."""

CHANGED = 2.0
"""Factor by which an estimate may go beyond the plant at the start of a run: a load as heavy as the
cart, a pole drawn out to twice its length."""


def _around(start: float, usual: tuple[float, ...]) -> tuple[float, float]:
    """Return the range in which an estimate of M or l is kept if none is given."""
    return min(start / CHANGED, min(usual) / MORE), max(start * CHANGED, max(usual) * MORE)


def _range(name: str, value: object) -> tuple[float, float]:
    """Return a range as two floats, or raise unless they are positive and increasing."""
    require_type(name, value, Iterable)
    numbers = tuple(require_positive(name, x) for x in value)  # type: ignore[attr-defined]
    if len(numbers) != 2 or not numbers[0] < numbers[1]:
        raise InvalidValueError(name, "must be two increasing numbers", numbers)
    return numbers[0], numbers[1]
