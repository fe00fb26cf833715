"""What a run has to achieve: the table ``[requirements]`` of a scenario."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from types import MappingProxyType

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.disturbances import ForcePulse, Impulse
from afl_mujoco.scenario.parameters import require_positive, require_type, short_repr

UNITS = MappingProxyType(
    {
        "completes": "s",
        "end_stops": "m",
        "max_position": "m",
        "max_angle": "rad",
        "max_command": "N",
        "max_force": "N",
        "settling_time": "s",
        "recover_within": "s",
    }
)
"""Every requirement, and the unit in which it is judged."""

BANDS = MappingProxyType({"position_band": "m", "angle_band": "rad"})
"""The bands within which a run is at rest, and their units."""

SWITCHES = ("completes", "end_stops_allowed")
"""Requirements that are true or false."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Requirements:
    """What a run has to achieve; None is no requirement.

    Attributes
    ----------
    completes
        Whether it has to reach its horizon.
    max_position
        Largest abs(z) at any time [m].
    max_angle
        Largest abs(phi) at any time [rad].
    max_command
        Largest abs(F) that the controller asks for [N].
    max_force
        Largest abs(F) that the drive exerts [N].
    settling_time
        Time by which z and phi have to be within their bands, and stay there until the first
        disturbance or the end [s].
    recover_within
        How long z and phi may be outside their bands after each disturbance [s].
    position_band
        Half-width of the band around z = 0 in which a run is at rest [m].
    angle_band
        Half-width of the band around phi = 0 in which a run is at rest [rad].
    end_stops_allowed
        Whether the cart may reach an end stop of its rail; otherwise a run that does fails.

    Raises
    ------
    InvalidValueError
        If a value breaks its rule.
    """

    completes: bool = True
    max_position: float | None = None
    max_angle: float | None = None
    max_command: float | None = None
    max_force: float | None = None
    settling_time: float | None = None
    recover_within: float | None = None
    position_band: float = 0.05
    angle_band: float = 0.02
    end_stops_allowed: bool = False

    def __post_init__(self) -> None:
        """Validate every field and store its numbers as floats."""
        for name in SWITCHES:
            require_type(name, getattr(self, name), bool)
        for field in fields(self):
            if field.name in SWITCHES:
                continue
            value = getattr(self, field.name)
            if value is not None or field.default is not None:
                object.__setattr__(self, field.name, require_positive(field.name, value))
        for name in ("max_angle", "angle_band"):
            if (angle := getattr(self, name)) is not None and not angle < 0.5 * math.pi:
                hint = f"{angle:g} degrees is {math.radians(angle):.4f} rad"
                rule = f"must be less than pi/2, where the pole lies ({hint})"
                raise InvalidValueError(name, rule, f"{angle:g}")

    __repr__ = short_repr

    def require_decidable(
        self, duration: float, disturbances: Sequence[ForcePulse | Impulse]
    ) -> None:
        """Raise if a run of this length could not show whether a requirement is met.

        Parameters
        ----------
        duration
            Horizon [s].
        """
        until = calm(duration, disturbances)
        if self.settling_time is not None and not self.settling_time < until:
            what = "the duration" if until == duration else "the start of the first disturbance"
            rule = f"must be less than {until:g} s, {what}"
            raise InvalidValueError("requirements.settling_time", rule, f"{self.settling_time:g} s")
        if self.recover_within is None:
            return
        if not disturbances:
            rule = "needs a disturbance to recover from"
            raise InvalidValueError("requirements.recover_within", rule)
        for end, until in recoveries(duration, disturbances):
            if not self.recover_within < until - end:
                left = f"the time left after the disturbance that ends at {end:g} s"
                rule = f"must be less than {until - end:g} s, {left}"
                raise InvalidValueError(
                    "requirements.recover_within", rule, f"{self.recover_within:g} s"
                )


NONE = Requirements()
"""To reach the horizon, and nothing else."""


SNAP = 1e-9
"""Gap between two disturbances that may be round-off alone [s]."""


def calm(duration: float, disturbances: Sequence[ForcePulse | Impulse]) -> float:
    """Return the time [s] until which nothing disturbs a run."""
    return min((min(d.breakpoints) for d in disturbances), default=duration)


def recoveries(
    duration: float, disturbances: Sequence[ForcePulse | Impulse]
) -> list[tuple[float, float]]:
    """Return the start and end [s] of each interval in which a run may recover.

    Disturbances that overlap count as one.
    """
    spans = sorted((min(d.breakpoints), max(d.breakpoints)) for d in disturbances)
    ends: list[tuple[float, float]] = []
    for start, end in spans:
        if ends and start <= ends[-1][1] + SNAP:
            ends[-1] = (ends[-1][0], max(end, ends[-1][1]))
        else:
            ends.append((start, end))
    after = [start for start, _ in ends[1:]] + [duration]
    return [(end, until) for (_, end), until in zip(ends, after, strict=True)]
