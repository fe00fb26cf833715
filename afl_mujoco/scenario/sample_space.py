"""The unit cube mapped to the scenarios that the ranges of a scenario allow."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.random import Generator, Philox, SeedSequence
from numpy.typing import ArrayLike, NDArray

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.imperfections import FINEST_STEP, LARGEST_SEED, require_within_stop
from afl_mujoco.scenario.parameters import LARGEST_START_ANGLE
from afl_mujoco.scenario.ranges import Range, hardware_of, scheduled, variable
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.schedules import Schedule, constant, staircase, trapezoid
from afl_mujoco.values import within

PARTS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "constant": ("level 1",),
        "steps": ("level 1", "level 2", "level 3", "instant 1", "instant 2"),
        "trapezoid": ("level 1", "level 2", *(f"instant {i}" for i in range(1, 5))),
    }
)
"""What each shape uses of the axes of a parameter."""

SHAPES = tuple(PARTS)
"""Shapes of the schedules, each a third of the shape's coordinate: one level; two jumps between
three levels; a trapezoid between two levels."""

CONSTANT = 0.5 / len(SHAPES)  # the middle of the first
INSTANT = 1e-3  # instants of change are multiples of this [s]
LEVELS, INSTANTS = 3, 4  # the most that a shape has
_POINT, _NOISE, _SEARCH, _DRAW = range(4)  # what a seed is used for


@dataclass(frozen=True, slots=True)
class SampleSpace:
    """The scenarios that the ranges of a scenario allow, as points of a unit cube."""

    # the scenario with its ranges; what they leave out is the same in every sample
    scenario: Scenario

    def __post_init__(self) -> None:
        if not self.coordinates:
            rule = "must say in [ranges] what varies"
            raise InvalidValueError(f"scenario {self.scenario.name!r}", rule)
        for name in self.varied:
            if self.scenario.imperfections.without_effect(name):
                rule = "must be left out: velocities are differentiated, not measured"
                raise InvalidValueError(f"ranges.{name}", rule)
        if self.varied.keys() & {*scheduled(self.scenario.plant)}:
            least, duration = 2 * INSTANTS * INSTANT, self.scenario.duration
            if not duration > least:
                rule = f"must be more than {least:g} s, for the instants of changes"
                raise InvalidValueError("duration", rule, duration)
        names = self.scenario.plant.coordinates
        with within("at an end of [ranges], "):
            for name, x in zip(names, self.scenario.initial_state, strict=False):
                self._require_within_stop(name, x)
            _ = self.corners  # raises where a sample would

    def _require_within_stop(self, name: str, x: float) -> None:
        key, unit = f"end_stops.{name}", self.scenario.plant.units[name]
        stop = self.varied[key][0] if key in self.varied else self.scenario.hardware(key)
        farthest = max(map(abs, self.varied.get(name, (x, x))))
        require_within_stop(f"initial_state {name}", farthest, stop, f"the shortest {key}", unit)

    @property
    def corners(self) -> list[Scenario]:
        """Return the scenarios with everything at its least, and at its largest."""
        return [self.scenario_of(np.full(self.dimension, x), 0, 0) for x in (0.0, 1.0)]

    @property
    def varied(self) -> Mapping[str, Range]:
        """Least and largest value of what varies, by name."""
        found: Mapping[str, Range] = self.scenario.ranges
        return found

    def bounds(self, name: str) -> Range:
        """Return the least and the largest value of a parameter that a sample can have."""
        return self.varied.get(name, self.scenario.spans[name])

    @property
    def last_change(self) -> float:
        """Latest time at which parameters begin to change [s]."""
        return 0.5 * self.scenario.duration

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the cube's axes, in their order."""
        parts = ["shape", *(f"level {i}" for i in range(1, LEVELS + 1))]
        parts += [f"instant {i}" for i in range(1, INSTANTS + 1)]
        found: list[str] = []
        changing = scheduled(self.scenario.plant)
        for name in variable(self.scenario.plant):
            low, high = self.varied.get(name, (0.0, 0.0))
            if low < high:  # a single number has no axis
                found += [f"{name} {part}" for part in parts] if name in changing else [name]
        return tuple(found)

    @property
    def dimension(self) -> int:
        """How many axes the cube has."""
        return len(self.coordinates)

    def scenario_of(self, point: ArrayLike, index: int, seed: int) -> Scenario:
        """Return the scenario at a point of the cube, shape (dimension,)."""
        at, base = self._by_name(point), self.scenario
        plant = base.plant
        changing = scheduled(plant)
        scaled = {
            name: _within(self.varied[name], at[name]) if name in at else self.varied[name][0]
            for name in self.varied
            if name not in changing
        }
        for name, value in scaled.items():
            if name.startswith("encoder_step.") and value < FINEST_STEP:  # which means exact
                scaled[name] = 0.0
        noise = int(_stream(seed, _NOISE, index).generate_state(1, np.uint64)[0] >> np.uint64(1))
        start = zip(plant.states, base.initial_state, strict=True)
        state = tuple(scaled.pop(name, value) for name, value in start)
        drawn: dict[str, Schedule | float] = {
            **{name: scaled.pop(name) for name in plant.parameters if name in scaled},
            **{name: self._schedule(name, at) for name in changing if name in self.varied},
        }
        known = replace(base, belief=base.belief.known(base.nominal))
        return replace(
            known.changed({"seed": noise, **scaled}),
            name=f"{base.name}-{seed}-{index:04d}",
            ranges={},
            initial_state=state,
            schedule={**base.schedule, **drawn},
        )

    def _by_name(self, point: ArrayLike) -> dict[str, float]:
        """Return the coordinates of a point by name, or raise if it is not in the cube."""
        x = np.asarray(point, dtype=np.float64)
        names = self.coordinates
        if x.shape != (len(names),):
            raise InvalidValueError("point", f"must have shape ({len(names)},)", x.shape)
        if not ((x >= 0.0) & (x <= 1.0)).all():
            raise InvalidValueError("point", "must lie in the unit cube", x.tolist())
        return dict(zip(names, x.tolist(), strict=True))

    def _schedule(self, thing: str, at: dict[str, float]) -> Schedule:
        bounds = self.varied[thing]
        if bounds[0] == bounds[1]:
            return constant(bounds[0])
        levels = [_within(bounds, at[f"{thing} level {i}"]) for i in range(1, LEVELS + 1)]
        shares = [at[f"{thing} instant {i}"] for i in range(1, INSTANTS + 1)]
        shape = _shape_at(at[f"{thing} shape"])
        if shape == "constant":
            return constant(levels[0])
        if shape == "trapezoid":
            return trapezoid(self._times(shares), low=levels[0], high=levels[1])
        return staircase(self._times(shares[: len(levels) - 1]), levels)

    def _times(self, shares: list[float]) -> tuple[float, ...]:
        """Return increasing instants [s] from numbers in 0 to 1 in any order."""
        free = round(self.last_change / INSTANT) - len(shares)
        return tuple((round(free * u) + i + 1) * INSTANT for i, u in enumerate(sorted(shares)))

    @property
    def reference(self) -> NDArray[np.float64]:
        """The point of the cube nearest to the scenario itself, with M and l as at its start.

        An imperfection that is None in the scenario lies at the most benign end of its range, the
        largest value.
        """
        base = self.scenario
        own = dict(zip(base.plant.states, base.initial_state, strict=True))
        own |= {name: base.hardware(name) for name in hardware_of(base.plant)}
        own |= base.nominal
        found = []
        for name in self.coordinates:
            thing, _, part = name.partition(" ")
            if part == "shape":
                found.append(CONSTANT)
            elif part.startswith("instant"):
                found.append(0.5)
            else:
                value = own[thing]
                low, high = self.varied[thing]
                share = 1.0 if value is None else (value - low) / (high - low)
                found.append(min(max(share, 0.0), 1.0))
        return np.array(found)


def acting(changes: Mapping[str, float]) -> dict[str, float]:
    """Return the coordinates that act on a scenario, without those that its shapes do not use."""
    found = {}
    for name, change in changes.items():
        thing, _, part = name.partition(" ")
        if (shift := changes.get(f"{thing} shape")) is not None and part != "shape":
            if part not in PARTS[_shape_at(CONSTANT + shift)]:
                continue
        found[name] = change
    return found


def sample_point(space: SampleSpace, index: int, seed: int) -> NDArray[np.float64]:
    """Return the point of a sample, uniform in the cube; it depends on index and seed alone."""
    return Generator(Philox(_stream(seed, _POINT, index))).random(space.dimension)


def sample_scenario(space: SampleSpace, index: int, seed: int) -> Scenario:
    """Return the scenario of a sample."""
    return space.scenario_of(sample_point(space, index, seed), index, seed)


NOISE_DRAWS = 10  # draws of noise and start by which a run with noise or encoders is judged


def draw_of(scenario: Scenario, index: int) -> Scenario:
    """Return a scenario with other noise, and another start within a step of its encoders.

    What happens to the last digit of a reading is as random as its noise: the same run with half
    the timestep settles at another time, and neither is the right one.
    """
    if index == 0:
        return scenario
    r, names = scenario.imperfections, scenario.plant.coordinates
    seed = (r.seed + index) % (LARGEST_SEED + 1)
    away = Generator(Philox(_stream(seed, _DRAW, index))).uniform(-0.5, 0.5, len(names))
    start = list(scenario.initial_state)
    for i, name in enumerate(names):
        shift = float(away[i]) * r.at(f"encoder_step.{name}")
        most = LARGEST_START_ANGLE if scenario.plant.units[name] == "rad" else math.inf
        most = min(most, r.at(f"end_stops.{name}") or math.inf)
        inside = (x for x in (start[i] + shift, start[i] - shift) if abs(x) < most)
        start[i] = next(inside, start[i])
    return replace(scenario, initial_state=tuple(start), imperfections=replace(r, seed=seed))


def draws_of(
    scenario: Scenario, count: int | None = None, *, random: int = NOISE_DRAWS
) -> list[Scenario]:
    """Return draws: `count`, by default one where nothing is random, else `random`."""
    wanted = (random if scenario.imperfections.drawn else 1) if count is None else count
    return [draw_of(scenario, index) for index in range(wanted)]


def search_generator(seed: int) -> Generator:
    """Return the random generator of a search; no sample of the same seed shares its numbers."""
    return Generator(Philox(_stream(seed, _SEARCH, 0)))


def _stream(seed: int, purpose: int, index: int) -> SeedSequence:
    return SeedSequence(seed, spawn_key=(purpose, index))


def _shape_at(share: float) -> str:
    return SHAPES[min(int(len(SHAPES) * share), len(SHAPES) - 1)]


def _within(bounds: Range, share: float) -> float:
    """Return the number at a share of a range, never outside the range."""
    low, high = bounds
    return min(max(low + share * (high - low), low), high)
