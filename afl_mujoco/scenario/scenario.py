"""A scenario: the plant, how its parameters change, what disturbs it, where it starts."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, NamedTuple

import numpy as np

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.plants.cartpole import CART_POLE
from afl_mujoco.plants.plant import Floats, Parameter, Plant, load_plant
from afl_mujoco.scenario.belief import TRUTH, Belief, is_error
from afl_mujoco.scenario.imperfections import BY_INPUT, IDEAL, Imperfections, require_within_stop
from afl_mujoco.scenario.parameters import (
    CONSTANTS,
    LARGEST_STATE,
    SCHEDULES,
    CartPoleParameters,
    PlantRange,
    require_start_angle,
)
from afl_mujoco.scenario.ranges import ranges_of
from afl_mujoco.scenario.requirements import NONE, Requirements, asked_of, bands_of
from afl_mujoco.scenario.schedules import (
    ForcePulse,
    Impulse,
    Schedule,
    channel_of,
    channels_of,
    constant,
)
from afl_mujoco.values import (
    EMPTY,
    ByName,
    Check,
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

SHORTEST = 1e-9
"""Least length of a part of a segment [s]: parameters may pass nodes at one time, but for
round-off."""

ROUNDING = 1e-12  # share of a parameter by which the end of a ramp may miss its value


@dataclass(frozen=True, slots=True)
class Segment:
    """A stretch of time over which everything prescribed is smooth."""

    start: float  # the stretch [s]
    end: float
    lines: tuple[tuple[float, float], ...]  # value at `start` and slope [1/s] of each parameter
    push: tuple[float, ...]  # disturbing forces, by `channels_of` [N, N m]
    impulse: tuple[float, ...]  # jumps of momenta at `start` [N s, N m s]

    def values_at(self, time: float) -> Floats:
        """Return the parameters at a time [s], the limit from inside the segment at both ends."""
        elapsed = time - self.start
        return np.array([value + rate * elapsed for value, rate in self.lines])

    def passes(self, names: Iterable[str], nodes: Mapping[str, Floats]) -> list[float]:
        """Return the increasing times [s] inside at which parameters pass nodes, in their order."""
        passed: list[float] = []
        for name, (value, rate) in zip(names, self.lines, strict=True):
            if rate and (at := nodes.get(name)) is not None:
                passed += (self.start + (at - value) / rate).tolist()
        found = [self.start]
        for time in sorted(passed):
            if found[-1] + SHORTEST < time < self.end - SHORTEST:
                found.append(time)
        return found[1:]

    def cut_at(self, times: Iterable[float]) -> tuple[Segment, ...]:
        """Return the parts between increasing times [s] inside; the first has the impulse."""
        cuts, none = (self.start, *times, self.end), (0.0,) * len(self.impulse)
        parts: list[Segment] = []
        for start, end in itertools.pairwise(cuts):
            values = self.values_at(start).tolist()
            lines = tuple(zip(values, (rate for _, rate in self.lines), strict=True))
            parts.append(Segment(start, end, lines, self.push, none if parts else self.impulse))
        return tuple(parts)


class Event(NamedTuple):
    """An instant at which momenta stay: a mass joins at rest, or a rate that acts jumps."""

    # parameters just before, but for those that jump under velocities that stay: they have, then;
    # and just after
    before: Floats
    after: Floats
    rates: tuple[Floats, Floats]  # of parameters that act on the motion, before and after [1/s]

    @property
    def joins(self) -> bool:
        """Whether a mass joins."""
        return bool((self.before != self.after).any())


def _schedule(thing: str, value: object) -> Schedule:
    if not isinstance(value, Schedule):
        return constant(require_finite(thing, value))
    return value


def _state(thing: str, value: Any, plant: Plant) -> tuple[float, ...]:
    names, count = plant.states, len(plant.states)
    if value is None:
        value = plant.start or (0.0,) * count
    if isinstance(value, Mapping):
        with within(f"{thing} "):
            given = ByName(value).ordered(names)
        value = [given.get(name, 0.0) for name in names]
    if isinstance(value, str) or not isinstance(value, Iterable):
        raise InvalidValueError(thing, "must be a table by name or a list", repr(value))
    if len(value := tuple(value)) != count:
        words = {2: "two", 4: "four", 6: "six"}
        raise InvalidValueError(thing, f"must hold {words.get(count, count)} numbers", len(value))
    pairs = zip(names, value, strict=True)
    state = tuple(require_finite(f"{thing} {name}", x) for name, x in pairs)
    if abs(most := max(state, key=abs)) > LARGEST_STATE:
        rule = f"must lie in -{LARGEST_STATE:g} to {LARGEST_STATE:g}"
        raise InvalidValueError(thing, rule, most)
    for name, x in zip(plant.coordinates, state, strict=False):
        if plant.units[name] == "rad":
            require_start_angle(f"{thing} {name}", x)
    return state


def _columns(given: Iterable[Floats], count: int) -> Floats:
    """Return columns of so many rows side by side; there may be none."""
    columns = list(given)
    return np.stack(columns, axis=-1) if columns else np.empty((count, 0))


def _rule(parameter: Parameter) -> Check:
    """Return the rule for values of a parameter: one that is never 0 is positive."""
    return require_plausible if (parameter.low or 0.0) > 0.0 else require_finite


def _duration(thing: str, value: object) -> float:
    return require_positive(thing, instant(require_positive(thing, value)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """What a simulator simulates: the true plant, not what a controller assumes.

    Attributes
    ----------
    name
        Name for reports and files.
    plant
        What is simulated, by default the paper's cart-pole; also ``"FILE.py:NAME"``.
    schedule
        The parameters by name, those left out as the plant has them: each a `Schedule` or a number;
        of the cart-pole, `cart_mass` M [kg] and `half_length` l [m] may be a schedule, `pole_mass`
        m [kg] and `gravity` g [m/s^2] are numbers.
    disturbances
        Force pulses and ideal impulses.
    initial_state
        The state at t = 0 by name, what is left out 0, or all its numbers: (z, phi, z_dot, phi_dot)
        [m, rad, m/s, rad/s]; an angle is at most a turn.
    duration
        Horizon T [s].
    imperfections
        Departures from the ideal loop, which only sampled mode simulates.
    requirements
        What a run has to achieve.
    ranges
        The least and the largest value by name of what varies where runs are drawn at random; a
        simulator simulates the scenario as it is.
    belief
        What controllers assume of the plant: what `Belief.of` takes.

    Raises
    ------
    UnknownNameError
        If a name is none of the plant's.
    InvalidValueError
        If a number is out of its range, an initial state lies beyond an end stop, a delay is not
        shorter than the duration, or no run could show a requirement.

    Examples
    --------
    >>> import afl_mujoco as afl
    >>> load = afl.staircase([5.0], [1.0, 1.5])
    >>> cart = afl.Scenario(name="cart", schedule={"cart_mass": load}, initial_state={"phi": 0.2})
    >>> cart.parameters_at(6.0).cart_mass
    1.5
    """

    name: str
    plant: Plant = CART_POLE
    schedule: Annotated[Any, table_of(_schedule)] = EMPTY
    disturbances: tuple[ForcePulse | Impulse, ...] = ()
    initial_state: Any = None
    duration: Annotated[float, _duration] = 20.0
    imperfections: Imperfections = IDEAL
    requirements: Requirements = NONE
    ranges: Any = EMPTY
    belief: Any = TRUTH

    def __post_init__(self) -> None:
        require_type("name", self.name, str)
        if not self.name.strip(".") or not self.name.isprintable() or "/" in self.name:
            rule = "must be printable, not empty, not only dots and without '/'"
            raise InvalidValueError("name", rule, repr(self.name))
        if isinstance(self.plant, str):
            known = CART_POLE if self.plant == CART_POLE.name else load_plant(self.plant)
            object.__setattr__(self, "plant", known)
        require_type("plant", self.plant, Plant)
        plant = self.plant
        check_fields(self)
        state = _state("initial_state", self.initial_state, plant)
        object.__setattr__(self, "initial_state", state)
        self._take_schedule()
        require_type("imperfections", self.imperfections, Imperfections)
        object.__setattr__(self, "imperfections", self.imperfections.of_plant(plant))
        if (delay := self.imperfections.longest_delay) >= self.duration:
            rule = f"must be shorter than the duration, {self.duration:g} s"
            raise InvalidValueError("imperfections.delay", rule, f"{delay:g} s")
        for name, x in zip(plant.coordinates, state, strict=False):
            which = f"end_stops.{name}"
            stop = self.imperfections.at(which)
            require_within_stop(f"initial_state {name}", x, stop, which, plant.units[name])
        require_type("disturbances", self.disturbances, Iterable)
        object.__setattr__(self, "disturbances", tuple(self.disturbances))
        for i, disturbance in enumerate(self.disturbances):
            thing = f"disturbances[{i}]"
            require_type(thing, disturbance, ForcePulse | Impulse)
            channel_of(disturbance, plant, thing)
            end = max(disturbance.breakpoints)
            struck_at_end = isinstance(disturbance, Impulse) and end == self.duration
            if end > self.duration or struck_at_end:
                rule = f"must end within the duration {self.duration} s"
                raise InvalidValueError(thing, rule, end)
        require_type("requirements", self.requirements, Requirements)
        object.__setattr__(self, "requirements", self.requirements.of_plant(plant))
        self.requirements.require_decidable(self.duration, self.disturbances)
        object.__setattr__(self, "ranges", ranges_of(plant, self.ranges))
        self._require_ranges()
        belief = Belief.of(self.belief, tuple(plant.parameters))
        for name, one in belief.assumed.items():
            if not isinstance(one.value, str):
                _rule(plant.parameters[name])(f"belief.{name} value", one.value)
        object.__setattr__(self, "belief", belief)

    def _require_ranges(self) -> None:
        """Raise if a start that is drawn could lie where a run ends, or one number be a table."""
        for name in self.ranges:
            if name in BY_INPUT and isinstance(getattr(self.imperfections, name), Mapping):
                rule = f"must be a table by input, as imperfections.{name} is"
                raise InvalidValueError(f"ranges.{name}", rule, list(self.ranges[name]))
        for name, end in self.ends_at.items():
            bounds = self.ranges.get(name)
            if bounds is not None and not self.farthest(name, bounds) < end:
                about, unit = self.about(name), self.plant.units[name]
                ends = f"{about - end:.4g} and {about + end:.4g} {unit}, where a run ends"
                got = f"{bounds[0]:g} to {bounds[1]:g}"
                raise InvalidValueError(f"ranges.{name}", f"must lie between {ends}", got)

    def _take_schedule(self) -> None:
        known = self.plant.parameters
        with within("schedule "):
            given = self.schedule.ordered(tuple(known))
        for name, schedule in given.items():
            for level in schedule.values:
                _rule(known[name])(f"schedule.{name}", level)
        constants = CONSTANTS if self.is_cart_pole else {}
        for name in constants.keys() & given.keys():
            if len({*given[name].values}) > 1:
                rule = f"must be one number: only {' and '.join(SCHEDULES)} change during a run"
                raise InvalidValueError(f"schedule.{name}", rule, list(given[name].values))
            given[name] = constant(given[name].values[0])
        whole = {name: given.get(name) or constant(one.value) for name, one in known.items()}
        object.__setattr__(self, "schedule", ByName(whole))

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
    def is_cart_pole(self) -> bool:
        """Whether it is the plant of the paper."""
        return self.plant is CART_POLE

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
        """How far the first coordinate can go to either side before its end stop [m], if any."""
        found: float | None = self.imperfections.at(f"end_stops.{self.plant.coordinates[0]}")
        return found

    @property
    def limits(self) -> Floats:
        """What each input can exert, by the MJCF and by its drive [N, N m], shape (inputs, 2)."""
        drives = [self.imperfections.of_input("input_limit", name) for name in self.plant.inputs]
        most = np.array([math.inf if limit is None else limit for limit in drives])
        low, high = self.plant.limits.T
        return np.stack([np.maximum(low, -most), np.minimum(high, most)], axis=1)

    @property
    def target(self) -> tuple[float, ...]:
        """Where the coordinates should be: as required, else upright, else 0."""
        targets = self.requirements.targets(self.plant)
        return tuple(targets[name] for name in self.plant.coordinates)

    @property
    def ends_at(self) -> Mapping[str, float]:
        """How far from its target a coordinate ends a run as failed, by name."""
        own = self.requirements.ends_at
        return self.plant.ends_at if own is None else own

    def band(self, name: str) -> float:
        """Return the half-width of the band of a coordinate in which a run is at rest."""
        return float(self.requirements.bands.get(name, bands_of(self.plant)[name]))

    @property
    def required(self) -> dict[str, float]:
        """The limit of each requirement, by name; empty if no run can fail."""
        asked, stops = self.requirements, self.imperfections.end_stops
        limits = {
            "completes": self.duration if asked.completes else None,
            "end_stops": None if asked.end_stops_allowed else min(stops.values(), default=None),
            "settling_time": asked.settling_time,
            "recover_within": asked.recover_within,
            **{f"max.{name}": limit for name, limit in asked.max.items()},
            **{f"min.{name}": limit for name, limit in asked.min.items()},
        }
        ordered = {name: limits.get(name) for name in asked_of(self.plant)}
        return {name: limit for name, limit in ordered.items() if limit is not None}

    @property
    def judged(self) -> bool:
        """Whether more is asked of a run than to complete and to keep off its end stops."""
        asked = self.required.keys()
        return bool(asked - {"completes", "end_stops"} or (asked and "completes" not in asked))

    def about(self, name: str) -> float:
        """Return from where `max` of a state, an input, a command or a signal is measured."""
        return self.requirements.targets(self.plant).get(name, 0.0)

    def away(self, name: str, x: float) -> float:
        """Return how far a coordinate is from its target, the shorter way where it wraps."""
        away = x - self.about(name)
        turns = round(away / (2.0 * math.pi)) if name in self.plant.wraps else 0
        return away - 2.0 * math.pi * turns

    def farthest(self, name: str, bounds: tuple[float, float]) -> float:
        """Return how far a coordinate may be from its target within bounds."""
        low, high = bounds
        found = abs(self.away(name, 0.5 * (low + high))) + 0.5 * (high - low)
        return min(found, math.pi) if name in self.plant.wraps else found

    def required_of(self, name: str) -> list[float]:
        """Return the values that one of these must not pass, by `max` and by `min`."""
        about, least = self.about(name), self.requirements.min.get(name)
        most = self.requirements.max.get(name)
        both = [] if most is None else [about - most, about + most]
        return both if least is None else [*both, float(least)]

    def unit_of(self, requirement: str) -> str:
        """Return the unit of a requirement; "" of end stops in different units."""
        if requirement != "end_stops":
            return asked_of(self.plant)[requirement].unit
        units = {self.plant.units[name] for name in self.imperfections.end_stops}
        return units.pop() if len(units) == 1 else ""

    def values(self, times: Floats) -> Floats:
        """Return the true parameters at some times [s], shape (N, parameters)."""
        return _columns((schedule(times) for schedule in self.schedule.values()), len(times))

    def acting_rates(self, times: Floats) -> Floats:
        """Return the rates [1/s] of parameters that act on the motion, 0 for the others.

        At times [s], after the jump at a breakpoint, shape (N, parameters).
        """
        found = np.zeros((len(times), len(self.schedule)))
        for i, schedule in enumerate(self.schedule.values()):
            if self.plant.entering[i] and schedule.breakpoints:
                edges = (-math.inf, *schedule.breakpoints)
                rates = np.array([0.0, *(schedule.piece(t)[1] for t in edges[1:])])
                found[:, i] = rates[np.searchsorted(edges, times, side="right") - 1]
        return found

    def values_at(self, time: float) -> Floats:
        """Return the true parameters at a time [s], after a jump, shape (parameters,)."""
        return np.array([schedule.at(time) for schedule in self.schedule.values()])

    def told_values(self, times: Floats) -> Floats:
        """Return the parameters that controllers are told at some times, shape (N, parameters)."""
        told = (self.told(name, one(times)) for name, one in self.schedule.items())
        return _columns(told, len(times))

    @property
    def nominal(self) -> dict[str, float]:
        """The parameters at t = 0 by name."""
        return {name: schedule.at(0.0) for name, schedule in self.schedule.items()}

    @property
    def spans(self) -> dict[str, tuple[float, float]]:
        """The least and the largest value of each parameter up to the horizon."""
        return {name: self._range(schedule) for name, schedule in self.schedule.items()}

    @property
    def plants(self) -> PlantRange:
        """The cart-poles that its schedules pass through up to the horizon."""
        masses, lengths = map(self._range, (self.cart_mass, self.half_length))
        return PlantRange(masses, lengths, self.pole_mass, self.gravity)

    @property
    def assumed_plants(self) -> PlantRange:
        """The cart-poles that a controller assumes, in which M and l may be wrong."""
        mass, length, *_ = self.plants
        ends = (self.told("cart_mass", np.array(mass)), self.told("half_length", np.array(length)))
        (m0, m1), (l0, l1) = (tuple(one.tolist()) for one in ends)
        return PlantRange((m0, m1), (l0, l1), *self.told_constants)

    def told(self, name: str, truth: Floats) -> Floats:
        """Return what controllers assume of a parameter, given its true values."""
        found: Floats = self.belief.told(name, truth, self.schedule[name].at(0.0))
        return found

    @property
    def told_constants(self) -> tuple[float, float]:
        """The m [kg] and g [m/s^2] that controllers assume."""
        m, g = (self.belief.told(name, getattr(self, name)) for name in ("pole_mass", "gravity"))
        return float(m), float(g)

    def hardware(self, path: str) -> Any:
        """Return a number of the imperfections, or an error of the belief, by its path."""
        return self.belief.error(path) if is_error(path) else self.imperfections.at(path)

    def changed(self, hardware: Mapping[str, Any]) -> Scenario:
        """Return the scenario with other imperfections and errors of the belief, by path."""
        errors = {path: value for path, value in hardware.items() if is_error(path)}
        others = {path: value for path, value in hardware.items() if not is_error(path)}
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
        sources = (*self.schedule.values(), *self.disturbances)
        times = {t for source in sources for t in source.breakpoints if 0 < t < self.duration}
        return tuple(sorted(times))

    @property
    def events(self) -> dict[float, Event]:
        """The instants at which momenta stay, by their times [s], in order."""
        joining = np.array([one.jump == "momenta" for one in self.plant.parameters.values()])
        if not (joining.any() or self.plant.entering.any()):
            return {}
        times = np.array(self.breakpoints)
        before, after = (self.acting_rates(x) for x in (np.nextafter(times, 0.0), times))
        found: dict[float, Event] = {}
        for i, time in enumerate(times.tolist()):
            new = self.values_at(time)
            old = np.array([schedule.before(time) for schedule in self.schedule.values()])
            rises = joining & (new - old > ROUNDING * np.abs(new))
            if rises.any() or (before[i] != after[i]).any():
                found[time] = Event(np.where(rises, old, new), new, (before[i], after[i]))
        return found

    @property
    def segments(self) -> tuple[Segment, ...]:
        """The horizon cut at every breakpoint, in order."""
        return tuple(
            Segment(
                start=start,
                end=end,
                lines=tuple(schedule.piece(start) for schedule in self.schedule.values()),
                **self._acting(start, end),
            )
            for start, end in itertools.pairwise((0.0, *self.breakpoints, self.duration))
        )

    def parameters_at(self, time: float) -> CartPoleParameters:
        """Return the cart-pole's parameters at `time`, after the jump if there is one.

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

    def _acting(self, start: float, end: float) -> dict[str, tuple[float, ...]]:
        """Return the forces at a start [s], after an edge, and the momenta up to an end."""
        forces: list[list[float]] = [[] for _ in channels_of(self.plant)]
        momenta: list[list[float]] = [[] for _ in forces]
        for one in self.disturbances:
            channel = channel_of(one, self.plant)
            if isinstance(one, ForcePulse) and one.start <= start < one.end:
                forces[channel].append(one.force)
            if isinstance(one, Impulse) and start <= one.time < end:
                momenta[channel].append(one.momentum)
        return {"push": tuple(map(math.fsum, forces)), "impulse": tuple(map(math.fsum, momenta))}

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
                "simulate and compare do), or remove [imperfections] and [belief]"
            )
            raise InvalidValueError(f"scenario {self.name!r}", rule)
