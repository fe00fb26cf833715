"""A scenario: the plant, how its parameters change, what disturbs it, where it starts."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.belief import ERRORS, PARAMETERS, TRUTH, Belief
from afl_mujoco.scenario.disturbances import ForcePulse, Impulse
from afl_mujoco.scenario.imperfections import IDEAL, Imperfections, require_on_rail
from afl_mujoco.scenario.parameters import (
    CONSTANTS,
    LARGEST_STATE,
    NOMINAL,
    SCHEDULES,
    STATE,
    CartPoleParameters,
    PlantRange,
    require_start_angle,
)
from afl_mujoco.scenario.ranges import FIXED, Ranges
from afl_mujoco.scenario.requirements import NONE, PEAKS, Requirements
from afl_mujoco.scenario.schedules import Schedule, constant
from afl_mujoco.values import (
    EMPTY,
    ByName,
    check_fields,
    instant,
    require_finite,
    require_plausible,
    require_positive,
    require_type,
    short_repr,
    table_of,
    within,
)


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


def _schedule(thing: str, value: object) -> Schedule:
    """Return a schedule of positive values from one or from a number, or raise."""
    if not isinstance(value, Schedule):
        return constant(require_plausible(thing, value))
    for level in value.values:
        require_plausible(thing, level)
    return value


def _state(thing: str, value: Any) -> tuple[float, ...]:
    """Return a state from a list of its numbers, or from a table by name, or raise."""
    if isinstance(value, Mapping):
        with within(f"{thing} "):
            given = ByName(value).ordered([*STATE])
        value = [given.get(name, 0.0) for name in STATE]
    if isinstance(value, str) or not isinstance(value, Iterable):
        raise InvalidValueError(thing, "must be a table by name or a list", repr(value))
    state = tuple(require_finite(thing, x) for x in value)
    if len(state) != len(STATE):
        raise InvalidValueError(thing, "must hold four numbers", len(state))
    if abs(most := max(state, key=abs)) > LARGEST_STATE:
        rule = f"must lie in -{LARGEST_STATE:g} to {LARGEST_STATE:g}"
        raise InvalidValueError(thing, rule, most)
    require_start_angle(f"{thing} phi", state[1])
    return state


def _duration(thing: str, value: object) -> float:
    """Return a horizon [s], or raise."""
    return instant(require_positive(thing, value))


_NOMINAL = {name: constant(getattr(NOMINAL, name)) for name in PARAMETERS}


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """What a simulator simulates: the true plant, not what a controller assumes.

    Attributes
    ----------
    name
        Name for reports and files.
    schedule
        The parameters by name, those left out as in the paper's nominal plant: `cart_mass` M [kg]
        and `half_length` l [m] as a `Schedule` or a number, `pole_mass` m [kg] and `gravity` g
        [m/s^2] as numbers.
    disturbances
        Force pulses and ideal impulses on the cart.
    initial_state
        The state at t = 0 by name, what is left out 0, or (z, phi, z_dot, phi_dot) [m, rad, m/s,
        rad/s]; phi is at most a turn.
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
    schedule: Annotated[Any, table_of(_schedule)] = EMPTY
    disturbances: tuple[ForcePulse | Impulse, ...] = ()
    initial_state: Annotated[Any, _state] = (0.0, -math.pi / 3, 0.0, 0.0)
    duration: Annotated[float, _duration] = 20.0
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
        check_fields(self)
        with within("schedule "):
            given = self.schedule.ordered(PARAMETERS)
        for name in CONSTANTS.keys() & given.keys():
            if len({*given[name].values}) > 1:
                rule = f"must be one number: only {' and '.join(SCHEDULES)} change during a run"
                raise InvalidValueError(f"schedule.{name}", rule, list(given[name].values))
            given[name] = constant(given[name].values[0])
        whole = ByName({name: given.get(name) or _NOMINAL[name] for name in PARAMETERS})
        object.__setattr__(self, "schedule", whole)
        require_type("imperfections", self.imperfections, Imperfections)
        object.__setattr__(self, "imperfections", self.imperfections.of_plant())
        if (delay := self.imperfections.delay) >= self.duration:
            rule = f"must be shorter than the duration, {self.duration:g} s"
            raise InvalidValueError("imperfections.delay", rule, f"{delay:g} s")
        require_on_rail("initial_state z", self.initial_state[0], self.rail)
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
        object.__setattr__(self, "requirements", self.requirements.of_plant())
        self.requirements.require_decidable(self.duration, self.disturbances)
        require_type("ranges", self.ranges, Ranges)
        object.__setattr__(self, "belief", Belief.of(self.belief))

    __repr__ = short_repr

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: Any) -> Any:
        """Return how a record keeps a scenario: as the table of its file."""
        from pydantic_core import core_schema

        from afl_mujoco.scenario.files import scenario_from_table, scenario_to_table

        return core_schema.no_info_plain_validator_function(
            lambda value: value if isinstance(value, cls) else scenario_from_table(value),
            serialization=core_schema.plain_serializer_function_ser_schema(scenario_to_table),
        )

    @property
    def cart_mass(self) -> Schedule:
        """The schedule of the cart's mass M [kg]."""
        found: Schedule = self.schedule["cart_mass"]
        return found

    @property
    def half_length(self) -> Schedule:
        """The schedule of the pole's half-length l [m]."""
        found: Schedule = self.schedule["half_length"]
        return found

    @property
    def pole_mass(self) -> float:
        """The pole's mass m [kg]."""
        return float(self.schedule["pole_mass"].values[0])

    @property
    def gravity(self) -> float:
        """Gravity g [m/s^2]."""
        return float(self.schedule["gravity"].values[0])

    def with_schedule(self, **schedule: Schedule | float) -> Scenario:
        """Return the scenario with other parameters, by name."""
        return replace(self, schedule={**self.schedule, **schedule})

    @property
    def rail(self) -> float | None:
        """How far the cart can go to either side before it hits an end stop [m], if any."""
        found: float | None = self.imperfections.at("end_stops.z")
        return found

    @property
    def required(self) -> dict[str, float]:
        """The limit of each requirement, by name; empty if no run can fail."""
        asked = self.requirements
        limits = {
            "completes": self.duration if asked.completes else None,
            "end_stops": None if asked.end_stops_allowed else self.rail,
            **{name: asked.max.get(name.removeprefix("max.")) for name in PEAKS},
            "settling_time": asked.settling_time,
            "recover_within": asked.recover_within,
        }
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
        found: NDArray[np.float64] = self.belief.told(name, truth, self.schedule[name].at(0.0))
        return found

    @property
    def told_constants(self) -> tuple[float, float]:
        """The m [kg] and g [m/s^2] that controllers assume."""
        m, g = (self.belief.told(name, getattr(self, name)) for name in ("pole_mass", "gravity"))
        return float(m), float(g)

    def hardware(self, path: str) -> Any:
        """Return a number of the imperfections, or an error of the belief, by its path."""
        return self.belief.error(path) if path in ERRORS else self.imperfections.at(path)

    def changed(self, hardware: Mapping[str, Any]) -> Scenario:
        """Return the scenario with other imperfections and errors of the belief, by path."""
        errors = {path: value for path, value in hardware.items() if path in ERRORS}
        others = {path: value for path, value in hardware.items() if path not in ERRORS}
        return replace(
            self,
            imperfections=self.imperfections.changed(others),
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
