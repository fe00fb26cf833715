"""The space of hardware: ranges of a laboratory cart-pole, and the unit cube mapped to them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.random import Generator, Philox, SeedSequence
from numpy.typing import ArrayLike, NDArray

from afl_mujoco.errors import InvalidValueError, UnknownNameError
from afl_mujoco.scenario.imperfections import DECLARATIONS, DRAWS, Imperfections
from afl_mujoco.scenario.parameters import NOMINAL, require_finite, require_positive
from afl_mujoco.scenario.randomised import CART_MASS_RANGE, HALF_LENGTH_RANGE
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.schedules import Schedule, constant, staircase, trapezoid

Range = tuple[float, float]

SHAPES = ("constant", "steps", "trapezoid")
"""Of the schedules, each with a third of its coordinate: one level; two jumps between three levels;
a trapezoid between two levels."""

INSTANT = 1e-3
"""Instants of change are multiples of this [s]."""

RANGES: Mapping[str, Range] = MappingProxyType({name: draw.range for name, draw in DRAWS.items()})
"""The declared ranges of the imperfections."""

_STATE = ("z", "phi", "z_dot", "phi_dot")
_SCHEDULES = ("cart_mass", "half_length")
_LEVELS, _INSTANTS = 3, 4
_POINT, _NOISE, _SEARCH = range(3)  # what a seed is spent on


class Quantity(NamedTuple):
    """A row of the table of the space: what a number is, its unit, its range or value, and why."""

    name: str
    unit: str
    value: Range | float | None
    why: str


@dataclass(frozen=True, slots=True, kw_only=True)
class SampleSpace:
    """What may vary from run to run; a range is (least, largest), drawn uniformly.

    `quantities` gives units and reasons.

    Raises
    ------
    InvalidValueError
        If a range is empty or leaves what the thing may be.
    """

    z: Range = (-0.5, 0.5)
    phi: Range = (-math.radians(75.0), math.radians(75.0))
    z_dot: Range = (-0.5, 0.5)
    phi_dot: Range = (-1.0, 1.0)
    cart_mass: Range = CART_MASS_RANGE
    half_length: Range = HALF_LENGTH_RANGE
    last_change: float = 10.0
    imperfections: Mapping[str, Range] = field(default_factory=lambda: dict(RANGES))
    """Those that vary, of `RANGES`; the rest are ideal."""
    control_period: float = 1e-3
    force_limit: float | None = None
    duration: float = 20.0

    def __post_init__(self) -> None:
        """Check the ranges, and that their corners make scenarios."""
        for name in self.imperfections:
            if name not in RANGES:
                raise UnknownNameError.among("imperfection", name, RANGES)
        for name, bounds in self._ranges.items():
            low, high = (require_finite(name, x) for x in bounds)
            if not low <= high:
                raise InvalidValueError(name, "must not fall", f"{low:g} to {high:g}")
        require_positive("last_change", self.last_change)
        if not _INSTANTS * INSTANT < self.last_change <= self.duration:
            raise InvalidValueError("last_change", "must be within the duration", self.last_change)
        for corner in (0.0, 1.0):
            self.scenario_of(np.full(self.dimension, corner), 0, 0)

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the cube's axes, in their order."""
        parts = ["shape"] + [f"level {i}" for i in range(1, _LEVELS + 1)]
        parts += [f"instant {i}" for i in range(1, _INSTANTS + 1)]
        return (*_STATE, *(f"{s} {p}" for s in _SCHEDULES for p in parts), *self._varied)

    @property
    def dimension(self) -> int:
        """How many axes the cube has."""
        return len(self.coordinates)

    @property
    def _varied(self) -> tuple[str, ...]:
        """Names of the imperfections that vary, in the order of their axes."""
        return tuple(name for name in RANGES if name in self.imperfections)

    @property
    def _ranges(self) -> dict[str, Range]:
        """Every range by name."""
        own = ((one.name, getattr(self, one.name)) for one in fields(self))
        return {n: value for n, value in own if isinstance(value, tuple)} | dict(self.imperfections)

    def quantities(self) -> Iterator[Quantity]:
        """Return every number of the space with its unit and why it is what it is."""
        yield Quantity("z", "m", self.z, "the cart is put down by hand")
        yield Quantity("phi", "rad", self.phi, "75 degrees to either side; the paper starts at 60")
        yield Quantity("z_dot", "m/s", self.z_dot, "the cart is pushed as it is let go")
        yield Quantity("phi_dot", "rad/s", self.phi_dot, "and so is the pole")
        yield Quantity("cart_mass", "kg", self.cart_mass, "the paper's box")
        yield Quantity("half_length", "m", self.half_length, "the paper's box")
        changes = "M and l change in the first half of the run, as in the paper"
        yield Quantity("last_change", "s", self.last_change, changes)
        for name in self._varied:
            unit, why = DECLARATIONS[name].unit, DRAWS[name].why
            yield Quantity(name, unit, self.imperfections[name], why)
        yield Quantity("control_period", "s", self.control_period, "1 kHz, not varied")
        unlimited = "the paper's actuator has no limit; not varied"
        yield Quantity("force_limit", "N", self.force_limit, unlimited)
        yield Quantity("duration", "s", self.duration, "the paper's horizon")

    def scenario_of(self, point: ArrayLike, index: int, seed: int) -> Scenario:
        """Return the scenario at a point of the cube.

        Parameters
        ----------
        point
            One number in 0 to 1 for each coordinate, shape (dimension,).
        index, seed
            Number and seed of the sample; they give its name and the seed of its noise, and
            nothing else.
        """
        at, ranges = self._by_name(point), self._ranges
        scaled = {name: _within(ranges[name], at[name]) for name in (*_STATE, *self._varied)}
        noise = int(_stream(seed, _NOISE, index).generate_state(1, np.uint64)[0] >> np.uint64(1))
        return Scenario(
            name=f"montecarlo-{seed}-{index:04d}",
            cart_mass=self._schedule("cart_mass", at),
            half_length=self._schedule("half_length", at),
            initial_state=tuple(scaled.pop(name) for name in _STATE),  # type: ignore[arg-type]
            duration=self.duration,
            imperfections=Imperfections(
                control_period=self.control_period,
                force_limit=self.force_limit,
                seed=noise,
                **scaled,  # type: ignore[arg-type]
            ),
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
        """Return the schedule of M or l."""
        shape = SHAPES[min(int(len(SHAPES) * at[f"{thing} shape"]), len(SHAPES) - 1)]
        bounds: Range = getattr(self, thing)
        levels = [_within(bounds, at[f"{thing} level {i}"]) for i in range(1, _LEVELS + 1)]
        shares = [at[f"{thing} instant {i}"] for i in range(1, _INSTANTS + 1)]
        if shape == "constant":
            return constant(levels[0])
        if shape == "steps":
            return staircase(self._instants(shares[:2]), levels)
        return trapezoid(self._instants(shares), low=levels[0], high=levels[1])

    def _instants(self, shares: list[float]) -> tuple[float, ...]:
        """Return increasing instants [s] from numbers in 0 to 1, in whatever order."""
        free = round(self.last_change / INSTANT) - len(shares)
        return tuple((round(free * u) + i + 1) * INSTANT for i, u in enumerate(sorted(shares)))

    @property
    def constants(self) -> tuple[float, float]:
        """The pole's mass m [kg] and gravity g [m/s^2], which are the paper's in every sample."""
        return NOMINAL.pole_mass, NOMINAL.gravity

    @property
    def reference(self) -> NDArray[np.float64]:
        """The point of the cube nearest to the paper's nominal run: nothing changes, all ideal."""
        nominal = Scenario(name="nominal")
        ideal = {
            **dict(zip(_STATE, nominal.initial_state, strict=True)),
            **{f"{thing} shape": 0.5 / len(SHAPES) for thing in _SCHEDULES},
            **{
                f"{thing} instant {i}": 0.5 for thing in _SCHEDULES for i in range(1, _INSTANTS + 1)
            },
        }
        ranges = self._ranges
        for name in (*_STATE, *self._varied):
            ideal[name] = _share(ranges[name], ideal.get(name, 0.0))
        for thing in _SCHEDULES:
            share = _share(getattr(self, thing), getattr(nominal, thing).at(0.0))
            ideal |= {f"{thing} level {i}": share for i in range(1, _LEVELS + 1)}
        return np.array([ideal[name] for name in self.coordinates])


def sample_point(space: SampleSpace, index: int, seed: int) -> NDArray[np.float64]:
    """Return the point of a sample, uniform in the cube; it depends on index and seed alone."""
    return Generator(Philox(_stream(seed, _POINT, index))).random(space.dimension)


def sample_scenario(space: SampleSpace, index: int, seed: int) -> Scenario:
    """Return the scenario of a sample."""
    return space.scenario_of(sample_point(space, index, seed), index, seed)


def search_generator(seed: int) -> Generator:
    """Return the random numbers of a search; no sample of the same seed shares them."""
    return Generator(Philox(_stream(seed, _SEARCH, 0)))


def _stream(seed: int, purpose: int, index: int) -> SeedSequence:
    """Return the seed of one purpose, its own for every index."""
    return SeedSequence(seed, spawn_key=(purpose, index))


def _share(bounds: Range, value: float) -> float:
    """Return at what share of a range a number lies, that of its nearer end outside it."""
    low, high = bounds
    return min(max((value - low) / (high - low), 0.0), 1.0) if high > low else 0.0


def _within(bounds: Range, share: float) -> float:
    """Return the number at a share of a range, never outside it."""
    low, high = bounds
    return min(max(low + share * (high - low), low), high)
