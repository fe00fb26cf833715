"""What a run has to achieve: the table ``[requirements]`` of a scenario."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.plants.plant import Plant
from afl_mujoco.scenario.parameters import from_target
from afl_mujoco.scenario.schedules import ForcePulse, Impulse
from afl_mujoco.values import (
    EMPTY,
    ByName,
    Checked,
    Positive,
    Switch,
    require_finite,
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


_WORDS = MappingProxyType(
    {
        "completes": "runs to the end",
        "end_stops": "keeps off the end stops at",
        "max.force_command": "command at most",
        "max.force": "|F| exerted at most",
        "settling_time": "settles within",
        "recover_within": "recovers within",
    }
)


def words_of(name: str, target: float = 0.0) -> str:
    """Return a requirement in words, before its limit; `max` is of what is away from a target."""
    way, _, thing = name.partition(".")
    whole, asked = thing.removesuffix("_command"), " asked" * thing.endswith("_command")
    shown = f"{from_target(whole, target)}{asked}"
    return _WORDS.get(name) or (f"|{shown}| at most" if way == "max" else f"{shown} at least")


@cache
def asked_of(plant: Plant) -> Mapping[str, Asked]:
    """Return every requirement by the name under which it is judged, in the order of tables."""
    units = plant.units
    found = {
        "completes": Asked("s", words_of("completes")),
        "end_stops": Asked("", words_of("end_stops")),  # of a scenario: `Scenario.unit_of`
    }
    for name in plant.states:
        found[f"max.{name}"] = Asked(units[name], words_of(f"max.{name}"), f"peak_{name}")
    for name in plant.inputs:
        single, unit = len(plant.inputs) == 1, units[name]
        command, exerted = words_of(f"max.{name}_command"), words_of(f"max.{name}")
        metric = "max_command" if single else f"max_{name}_command"
        found[f"max.{name}_command"] = Asked(unit, command, metric)
        found[f"max.{name}"] = Asked(unit, exerted, f"max_{name}")
    for name in plant.signals:
        found[f"max.{name}"] = Asked("", words_of(f"max.{name}"), f"peak_{name}")
    for name in (*plant.states, *plant.signals):
        found[f"min.{name}"] = Asked(units.get(name, ""), words_of(f"min.{name}"), f"least_{name}")
    found |= {name: Asked("s", words_of(name)) for name in ("settling_time", "recover_within")}
    return MappingProxyType(found)


_BANDS = {"m": 0.05, "rad": 0.02}


def bands_of(plant: Plant) -> Mapping[str, float]:
    """Return the bands around their targets within which coordinates are at rest, by default."""
    return {name: _BANDS[plant.units[name]] for name in plant.coordinates}


_Tables = Annotated[Any, table_of(require_positive)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Requirements(Checked):
    """What a run has to achieve; None is no requirement.

    Attributes
    ----------
    completes
        Whether it has to reach its horizon.
    target
        Where coordinates and signals should be, by name; `upright` of the plant, else 0, by
        default. `max`, `bands`, `ends_at`, settling and integrals measure the deviation from it.
    max
        Largest absolute values at any time, by name: of the state, of what a drive exerts
        (`force`), of what the controller asks for (`force_command`), of signals.
    min
        Least values of states and signals, by name.
    ends_at
        How far from its target a coordinate ends the run as failed, by name; that of the plant by
        default, none if empty.
    settling_time
        Time by which every coordinate has to be within its band, and stay there until the first
        disturbance or the end [s].
    recover_within
        How long the coordinates may be outside their bands after each disturbance [s].
    bands
        Half-widths of the bands in which a run is at rest, by name of the coordinate [m, rad].
    end_stops_allowed
        Whether a coordinate may reach its end stop; otherwise a run that does fails.

    Raises
    ------
    InvalidValueError
        If a limit, a time or a band is not positive and finite, or a table is none.

    Examples
    --------
    >>> import afl_mujoco as afl
    >>> afl.Requirements(max={"z": 1.0, "force": 250.0}, settling_time=6.0).settling_time
    6.0
    """

    completes: Switch = True
    target: Annotated[Any, table_of(require_finite)] = EMPTY
    max: _Tables = EMPTY
    min: Annotated[Any, table_of(require_finite)] = EMPTY
    ends_at: _Tables | None = None
    settling_time: Positive | None = None
    recover_within: Positive | None = None
    bands: _Tables = EMPTY
    end_stops_allowed: Switch = False

    def of_plant(self, plant: Plant) -> Requirements:
        """Return the same in the order of a plant's names, bands as by default left out."""
        places = tuple(plant.coordinates)
        known = {
            "target": (*places, *plant.signals),
            **{
                way: [key.removeprefix(f"{way}.") for key in asked_of(plant) if key.startswith(way)]
                for way in ("max", "min")
            },
            "bands": places,
            "ends_at": places,
        }
        found: dict[str, Any] = {}
        for thing, names in known.items():
            if (given := getattr(self, thing)) is not None:
                with within(f"requirements.{thing} "):
                    found[thing] = given.ordered(names)
        turns, ends = dict.fromkeys(plant.wraps, math.pi), found.get("ends_at", plant.ends_at)
        for thing, name in itertools.product(("max", "bands", "ends_at"), places):
            value = found.get(thing, {}).get(name)
            end, turn = ends.get(name, math.inf), turns.get(name, math.inf)
            if value is not None and plant.units[name] == "rad" and not value <= min(end, turn):
                why = "where a run ends" if end <= turn else "as it is measured modulo a turn"
                hint = f"{value:g} degrees is {math.radians(value):.4f} rad"
                rule = f"must be at most {min(end, turn):.4g} rad, {why} ({hint})"
                raise InvalidValueError(f"requirements.{thing}.{name}", rule, f"{value:g}")
        about = self.targets(plant)
        for name, least in found["min"].items():
            turn = turns.get(name, math.inf)
            low = about.get(name, 0.0) - turn
            most = about.get(name, 0.0) + found["max"].get(name, turn)
            if not low < least <= most:
                rule = f"must be at most {most:g}, the largest that requirements.max.{name} allows"
                if math.isfinite(turn):
                    rule = f"must lie in {low:.4g} to {most:.4g}, as it is measured modulo a turn"
                raise InvalidValueError(f"requirements.min.{name}", rule, f"{least:g}")
        bands = bands_of(plant)
        own = {name: band for name, band in found["bands"].items() if band != bands[name]}
        return replace(self, **{**found, "bands": ByName(own)})

    __repr__ = short_repr

    def targets(self, plant: Plant) -> dict[str, float]:
        """Return where coordinates, and signals with a target, should be, by name."""
        upright = plant.upright or (0.0,) * len(plant.coordinates)
        found = {**dict(zip(plant.coordinates, upright, strict=True)), **self.target}
        return {name: float(x) for name, x in found.items()}

    def require_decidable(
        self, duration: float, disturbances: Sequence[ForcePulse | Impulse]
    ) -> None:
        """Raise if a run of this length [s] could not show whether a requirement is met."""
        until = calm(duration, disturbances)
        if self.settling_time is not None and not self.settling_time <= until + SNAP:
            what = "the duration" if until == duration else "the start of the first disturbance"
            rule = f"must be at most {until:g} s, {what}"
            raise InvalidValueError("requirements.settling_time", rule, f"{self.settling_time:g} s")
        if self.recover_within is None:
            return
        if not disturbances:
            rule = "needs a disturbance to recover from"
            raise InvalidValueError("requirements.recover_within", rule)
        for end, until in recoveries(duration, disturbances):
            if not self.recover_within <= until - end + SNAP:
                left = f"the time left after the disturbance that ends at {end:g} s"
                rule = f"must be at most {until - end:g} s, {left}"
                value = f"{self.recover_within:g} s"
                raise InvalidValueError("requirements.recover_within", rule, value)


NONE = Requirements()  # to reach the horizon, and nothing else


SNAP = 1e-9  # gap between two disturbances that may be round-off alone [s]


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
