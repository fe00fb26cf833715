"""A scenario: the plant, how its parameters change, what disturbs it, where it starts."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.belief import ERRORS, TRUTH, Belief
from afl_mujoco.scenario.disturbances import ForcePulse, Impulse
from afl_mujoco.scenario.imperfections import IDEAL, Imperfections, require_on_rail
from afl_mujoco.scenario.parameters import (
    LARGEST_STATE,
    NOMINAL,
    CartPoleParameters,
    PlantRange,
    instant,
    require_finite,
    require_plausible,
    require_positive,
    require_start_angle,
    require_type,
    short_repr,
)
from afl_mujoco.scenario.ranges import FIXED, Ranges
from afl_mujoco.scenario.requirements import NONE, UNITS, Requirements
from afl_mujoco.scenario.schedules import Schedule, constant


@dataclass(frozen=True, slots=True)
class Segment:
    """A stretch of time over which everything prescribed is smooth."""

    start: float  # the stretch [s]
    end: float
    cart_mass: tuple[float, float]  # value at `start` and slope of M [kg, kg/s] and l [m, m/s]
    half_length: tuple[float, float]
    push: float  # disturbing force on the cart [N]
    impulse: float  # jump of the momentum along z at `start` [N s]

    def parameters_at(self, time: float) -> tuple[float, float]:
        """Return (M, l) at `time`, the limit from inside the segment at both ends.

        time: Time [s].
        """
        elapsed = time - self.start
        (mass, mass_rate), (length, length_rate) = self.cart_mass, self.half_length
        return mass + mass_rate * elapsed, length + length_rate * elapsed

    def cut_at(self, times: Iterable[float]) -> tuple[Segment, ...]:
        """Return the parts between some times inside the segment; the first has the impulse.

        times: Times [s], increasing.
        """
        cuts = (self.start, *times, self.end)
        parts: list[Segment] = []
        for start, end in itertools.pairwise(cuts):
            mass, length = self.parameters_at(start)
            part = Segment(
                start=start,
                end=end,
                cart_mass=(mass, self.cart_mass[1]),
                half_length=(length, self.half_length[1]),
                push=self.push,
                impulse=0.0 if parts else self.impulse,
            )
            parts.append(part)
        return tuple(parts)


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """What a simulator simulates: the true plant, not what a controller assumes.

    Attributes
    ----------
    name
        Name for reports and files.
    cart_mass, half_length
        Schedules of M [kg] and l [m].
    pole_mass, gravity
        m [kg] and g [m/s^2], constant.
    disturbances
        Force pulses and ideal impulses on the cart.
    initial_state
        (z, phi, z_dot, phi_dot) at t = 0 [m, rad, m/s, rad/s]; phi is at most a turn.
    duration
        Horizon T [s].
    imperfections
        Departures from the ideal loop, which only sampled mode simulates.
    requirements
        What a run has to achieve.
    ranges
        What varies from run to run where runs are drawn at random; a simulator simulates the
        scenario as it is.
    belief
        What controllers assume of the plant: what `Belief.of` takes.

    Raises
    ------
    InvalidValueError
        If a value breaks its rule.
    """

    name: str
    cart_mass: Schedule = field(default_factory=lambda: constant(NOMINAL.cart_mass))
    half_length: Schedule = field(default_factory=lambda: constant(NOMINAL.half_length))
    pole_mass: float = NOMINAL.pole_mass
    gravity: float = NOMINAL.gravity
    disturbances: tuple[ForcePulse | Impulse, ...] = ()
    initial_state: tuple[float, float, float, float] = (0.0, -math.pi / 3, 0.0, 0.0)
    duration: float = 20.0
    imperfections: Imperfections = IDEAL
    requirements: Requirements = NONE
    ranges: Ranges = FIXED
    belief: Belief = TRUTH

    def __post_init__(self) -> None:
        """Validate every field and normalise its type."""
        require_type("name", self.name, str)
        if not self.name or not self.name.isprintable() or "/" in self.name:
            raise InvalidValueError(
                "name", "must be printable, not empty and without '/'", repr(self.name)
            )
        for thing in ("cart_mass", "half_length"):
            require_type(f"schedule.{thing}", getattr(self, thing), Schedule)
            for value in getattr(self, thing).values:
                require_plausible(f"schedule.{thing}", value)
        for thing in ("pole_mass", "gravity"):
            object.__setattr__(self, thing, require_plausible(thing, getattr(self, thing)))
        object.__setattr__(self, "duration", instant(require_positive("duration", self.duration)))
        require_type("initial_state", self.initial_state, Iterable)
        state = tuple(require_finite("initial_state", x) for x in self.initial_state)
        if len(state) != 4:
            raise InvalidValueError("initial_state", "must hold four numbers", len(state))
        if abs(most := max(state, key=abs)) > LARGEST_STATE:
            rule = f"must lie in -{LARGEST_STATE:g} to {LARGEST_STATE:g}"
            raise InvalidValueError("initial_state", rule, most)
        require_start_angle("initial_state phi", state[1])
        object.__setattr__(self, "initial_state", state)
        require_type("imperfections", self.imperfections, Imperfections)
        if (delay := self.imperfections.delay) >= self.duration:
            rule = f"must be shorter than the duration, {self.duration:g} s"
            raise InvalidValueError("imperfections.delay", rule, f"{delay:g} s")
        require_on_rail("initial_state z", state[0], self.imperfections.rail_half_length)
        require_type("disturbances", self.disturbances, Iterable)
        object.__setattr__(self, "disturbances", tuple(self.disturbances))
        for disturbance in self.disturbances:
            require_type("disturbance", disturbance, ForcePulse | Impulse)
            end = max(disturbance.breakpoints)
            struck_at_end = isinstance(disturbance, Impulse) and end == self.duration
            if end > self.duration or struck_at_end:
                rule = f"must end within the duration {self.duration} s"
                raise InvalidValueError("disturbance", rule, end)
        require_type("requirements", self.requirements, Requirements)
        self.requirements.require_decidable(self.duration, self.disturbances)
        require_type("ranges", self.ranges, Ranges)
        object.__setattr__(self, "belief", Belief.of(self.belief))

    __repr__ = short_repr

    @property
    def required(self) -> dict[str, float]:
        """The limit of each requirement, by name; empty if no run can fail."""
        asked, rail = self.requirements, self.imperfections.rail_half_length
        limits = {name: getattr(asked, name, None) for name in UNITS}
        limits["completes"] = self.duration if asked.completes else None
        limits["end_stops"] = None if asked.end_stops_allowed else rail
        return {name: limit for name, limit in limits.items() if limit is not None}

    @property
    def plants(self) -> PlantRange:
        """The plants that its schedules pass through up to the horizon."""
        masses, lengths = map(self._range, (self.cart_mass, self.half_length))
        return PlantRange(masses, lengths, self.pole_mass, self.gravity)

    @property
    def assumed_plants(self) -> PlantRange:
        """The plants that a controller assumes, in which M and l may be wrong."""
        mass, length, *_ = self.plants
        ends = (self.told("cart_mass", np.array(mass)), self.told("half_length", np.array(length)))
        (m0, m1), (l0, l1) = (tuple(one.tolist()) for one in ends)
        return PlantRange((m0, m1), (l0, l1), *self.told_constants)

    def told(self, name: str, truth: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return what controllers assume of M or l, given its true values."""
        found: NDArray[np.float64] = self.belief.told(name, truth, getattr(self, name).at(0.0))
        return found

    @property
    def told_constants(self) -> tuple[float, float]:
        """The m [kg] and g [m/s^2] that controllers assume."""
        m, g = (self.belief.told(name, getattr(self, name)) for name in ("pole_mass", "gravity"))
        return float(m), float(g)

    def hardware(self, name: str) -> Any:
        """Return an imperfection, or an error of the belief, by its name."""
        return self.belief.error(name) if name in ERRORS else getattr(self.imperfections, name)

    def changed(self, **hardware: Any) -> Scenario:
        """Return the scenario with other imperfections and errors of the belief, by name."""
        errors = {name: value for name, value in hardware.items() if name in ERRORS}
        others = {name: value for name, value in hardware.items() if name not in ERRORS}
        return replace(
            self,
            imperfections=replace(self.imperfections, **others),
            belief=self.belief.changed(**errors),
        )

    def _range(self, schedule: Schedule) -> tuple[float, float]:
        """Return the least and the largest value of a schedule up to the horizon."""
        turns = (*self.breakpoints, self.duration)
        values = [schedule.at(0.0), *map(schedule.at, self.breakpoints)]
        values += [schedule.before(time) for time in turns]
        return min(values), max(values)

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times [s] inside the horizon at which anything prescribed is not smooth."""
        sources = (self.cart_mass, self.half_length, *self.disturbances)
        return tuple(
            sorted({t for source in sources for t in source.breakpoints if 0 < t < self.duration})
        )

    @property
    def segments(self) -> tuple[Segment, ...]:
        """The horizon cut at every breakpoint, in order."""
        cuts = (0.0, *self.breakpoints, self.duration)
        return tuple(
            Segment(
                start=start,
                end=end,
                cart_mass=self.cart_mass.piece(start),
                half_length=self.half_length.piece(start),
                push=self.push_at(start),
                impulse=self.impulse_within(start, end),
            )
            for start, end in itertools.pairwise(cuts)
        )

    def parameters_at(self, time: float) -> CartPoleParameters:
        """Return the plant's parameters at `time`, after the jump if there is one.

        Parameters
        ----------
        time
            Time [s].
        """
        return CartPoleParameters(
            cart_mass=self.cart_mass.at(time),
            pole_mass=self.pole_mass,
            half_length=self.half_length.at(time),
            gravity=self.gravity,
        )

    def push_at(self, time: float) -> float:
        """Return the disturbing force [N] at `time`, after the edge if there is one.

        Parameters
        ----------
        time
            Time [s].
        """
        return math.fsum(d.force_at(time) for d in self.disturbances if isinstance(d, ForcePulse))

    def impulse_within(self, start: float, end: float) -> float:
        """Return the momentum [N s] of the ideal impulses over ``start <= t < end``.

        Parameters
        ----------
        start, end
            The stretch of time [s].
        """
        return math.fsum(
            d.momentum
            for d in self.disturbances
            if isinstance(d, Impulse) and start <= d.time < end
        )

    def pushes(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the disturbing force [N] at many times, shape (N,).

        Parameters
        ----------
        times
            Times [s], shape (N,).
        """
        pulses = [d for d in self.disturbances if isinstance(d, ForcePulse)]
        edges = sorted({edge for pulse in pulses for edge in pulse.breakpoints})
        levels = np.array([0.0, *(self.push_at(edge) for edge in edges)])
        return levels[np.searchsorted(edges, times, side="right")]

    @property
    def ideal(self) -> Scenario:
        """The same without imperfections, and controllers told the truth."""
        return replace(self, imperfections=IDEAL, belief=TRUTH)

    def require_ideal(self) -> None:
        """Raise if anything departs from the ideal loop.

        Raises
        ------
        InvalidValueError
            If the scenario has imperfections.
        """
        if self.imperfections != IDEAL or self.belief != TRUTH:
            rule = (
                'has imperfections, which only mode "sampled" simulates: use that (the commands '
                "simulate, without --compare, and compare do), or remove [imperfections] and "
                "[belief]"
            )
            raise InvalidValueError(f"scenario {self.name!r}", rule)
