"""What a run has to achieve: the table ``[requirements]`` of a scenario."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.disturbances import ForcePulse, Impulse
from afl_mujoco.scenario.parameters import STATE, SYMBOLS
from afl_mujoco.values import (
    EMPTY,
    ByName,
    Positive,
    Switch,
    check_fields,
    require_positive,
    short_repr,
    table_of,
    within,
)


class Asked(NamedTuple):
    """What is known of a requirement besides its rule."""

    unit: str  # in which it is judged
    words: str  # before its limit
    metric: str = ""  # which the limit is on, if it is on one


REQUIREMENTS = MappingProxyType(
    {
        "completes": Asked("s", "runs to the end"),
        "end_stops": Asked("m", "keeps off the end stops at"),
        **{f"max.{name}": Asked(unit, f"|{SYMBOLS[name]}| at most", f"peak_{name}")
           for name, unit in STATE.items()},
        "max.force_command": Asked("N", "command at most", "max_command"),
        "max.force": Asked("N", "|F| exerted at most", "max_force"),
        "settling_time": Asked("s", "settles within"),
        "recover_within": Asked("s", "recovers within"),
    }
)  # fmt: skip
"""Every requirement by the name under which it is judged, in the order in which it is shown."""

PEAKS = tuple(name for name, one in REQUIREMENTS.items() if one.metric)
"""The requirements on largest values, of what is exerted and of what the controller asks for."""

BANDS = MappingProxyType({"z": 0.05, "phi": 0.02})
"""The bands around 0 within which a run is at rest, by default."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Requirements:
    """What a run has to achieve; None is no requirement.

    Attributes
    ----------
    completes
        Whether it has to reach its horizon.
    max
        Largest absolute values at any time, by name: of the state (`z` [m], `phi` [rad]), of what
        the drive exerts (`force` [N]), of what the controller asks for (`force_command` [N]).
    settling_time
        Time by which every coordinate has to be within its band, and stay there until the first
        disturbance or the end [s].
    recover_within
        How long the coordinates may be outside their bands after each disturbance [s].
    bands
        Half-widths of the bands around 0 in which a run is at rest, by name of the coordinate
        [m, rad].
    end_stops_allowed
        Whether the cart may reach an end stop of its rail; otherwise a run that does fails.

    Raises
    ------
    InvalidValueError
        If a value breaks its rule.
    """

    completes: Switch = True
    max: Annotated[Any, table_of(require_positive)] = EMPTY
    settling_time: Positive | None = None
    recover_within: Positive | None = None
    bands: Annotated[Any, table_of(require_positive)] = EMPTY
    end_stops_allowed: Switch = False

    def __post_init__(self) -> None:
        """Validate every field and store its numbers as floats."""
        check_fields(self)
        for thing, table in (("max.phi", self.max), ("bands.phi", self.bands)):
            if (angle := table.get("phi")) is not None and not angle < 0.5 * math.pi:
                hint = f"{angle:g} degrees is {math.radians(angle):.4f} rad"
                rule = f"must be less than pi/2, where the pole lies ({hint})"
                raise InvalidValueError(thing, rule, f"{angle:g}")

    def of_plant(self) -> Requirements:
        """Return the same in the order of the plant's names, bands as by default left out."""
        with within("requirements.max "):
            most = self.max.ordered([name.removeprefix("max.") for name in PEAKS])
        with within("requirements.bands "):
            bands = self.bands.ordered([*BANDS])
        own = ByName({name: band for name, band in bands.items() if band != BANDS[name]})
        return replace(self, max=most, bands=own)

    def band(self, name: str) -> float:
        """Return the half-width of the band of a coordinate in which a run is at rest."""
        return float(self.bands.get(name, BANDS[name]))

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
