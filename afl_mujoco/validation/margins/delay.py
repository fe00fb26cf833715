"""The delay margin of the linearised loop against the delay that MuJoCo's loop bears."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from typing import Any

import numpy as np

from afl_mujoco.control.law import Law
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.execution.executors import compute_all, open_executor
from afl_mujoco.scenario.parameters import CartPoleParameters
from afl_mujoco.scenario.realism import Realism
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.schedules import constant
from afl_mujoco.simulation.sampled.runs import simulate_sampled
from afl_mujoco.simulation.trajectory import COMPLETED
from afl_mujoco.validation.ladder.thresholds import BETWEEN, find_threshold, scan_levels
from afl_mujoco.validation.margins.linearization import linearize
from afl_mujoco.validation.margins.loop_margins import loop_margins

START = 1e-3
"""Pole angle at the start of a measurement [rad]: within the reach of the linearisation."""

DURATION, PARTS = 20.0, 5
"""Length of a run [s], and into how many parts it is cut: one that decays is smaller in the last
than in the first and in the one before."""

SMALL = 10.0 * START
"""Pole angle that it must not exceed then [rad]: it may have grown into a limit cycle by then,
which grows no more."""

TIMESTEP = 1e-3
"""MuJoCo's longest step; unless told otherwise, the force is held over it [s]."""

TOLERANCE = 1e-3
"""To which the measured delay is found [1]."""

DELAY = 0.05
"""About which a threshold is looked for where there is no margin [s]."""

EVERY = 0.1
"""How often a schedule is looked at [s]."""

REACH = 0.05
"""Relative difference up to which margin and measurement agree [1]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DelayComparison:
    """One law on one plant.

    Attributes
    ----------
    controller
        Its name.
    cart_mass, half_length
        M [kg] and l [m].
    margin
        Delay margin of the linearised loop, its force held over a control period [s]; None if it
        is not stable without delay.
    measured
        Delay at which a small motion in MuJoCo no longer decays [s]; None if none was found.
    """

    controller: str
    cart_mass: float
    half_length: float
    margin: float | None
    measured: float | None

    @property
    def difference(self) -> float | None:
        """Relative difference of the measurement from the margin [1]; None without both."""
        if self.margin is None or self.measured is None:
            return None
        return self.measured / self.margin - 1.0

    @property
    def agrees(self) -> bool:
        """Whether they differ by no more than `REACH`, or are both missing."""
        if self.margin is None or self.measured is None:
            return self.margin is self.measured
        return abs(self.measured / self.margin - 1.0) <= REACH

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data."""
        return {**asdict(self), "difference": self.difference, "agrees": self.agrees}


def measured_plants(
    masses: Sequence[float], lengths: Sequence[float], *, few: bool = False
) -> list[tuple[float, float]]:
    """Return the plants of a grid on which margin and measurement are compared, M [kg] and l [m].

    Parameters
    ----------
    masses, lengths
        Of the grid.
    few
        Only its two ends; otherwise the lightest and the heaviest cart, each with the shortest, the
        longest, and the pole nearest to their geometric mean.
    """
    ends = (min(masses), max(masses)), (min(lengths), max(lengths))
    if few:
        return list(dict.fromkeys(zip(*ends, strict=True)))
    mean = math.sqrt(ends[1][0] * ends[1][1])
    middle = min(lengths, key=lambda length: abs(math.log(length / mean)))
    return list(dict.fromkeys(product(ends[0], (ends[1][0], middle, ends[1][1]))))


def compare_delays(
    controllers: Sequence[Law],
    plants: Sequence[tuple[float, float]],
    *,
    control_period: float = TIMESTEP,
    workers: int = 1,
    progress: Callable[[int], None] = lambda done: None,
) -> list[DelayComparison]:
    """Compare margin and measurement for laws on some plants.

    Parameters
    ----------
    controllers
        The laws.
    plants
        M [kg] and l [m] of each.
    control_period
        How long the force is held [s].
    workers
        Processes to share the work among; the result does not depend on it.
    progress
        Called with how many are done.
    """
    units = [(law, *plant, control_period) for law in controllers for plant in plants]
    done = itertools.count(1)
    with open_executor(workers) as executor:
        return compute_all(compare_delay, units, executor, lambda i: progress(next(done)))


def compare_delay(unit: tuple[Law, float, float, float]) -> DelayComparison:
    """Compare margin and measurement for one law on one plant.

    Parameters
    ----------
    unit
        The law, M [kg], l [m] and how long the force is held [s].
    """
    law, mass, length, period = unit
    margin = delay_margin(law, mass, length, period)
    return DelayComparison(
        controller=law.name,
        cart_mass=mass,
        half_length=length,
        margin=margin,
        measured=measured_delay(law, mass, length, DELAY if margin is None else margin, period),
    )


def delay_margin(law: Law, mass: float, length: float, period: float = TIMESTEP) -> float | None:
    """Return the delay margin [s] of a linearised loop that holds its force; None without one.

    Parameters
    ----------
    law
        The law.
    mass, length
        M [kg] and l [m].
    period
        How long the force is held [s].
    """
    loop = linearize(law, CartPoleParameters(cart_mass=mass, half_length=length))
    margins = loop_margins(loop, period)
    return None if margins is None or not math.isfinite(margins.delay) else margins.delay


@dataclass(frozen=True, slots=True, kw_only=True)
class LeastMargin:
    """The least delay margin of one law over the plants that some scenarios go through.

    Attributes
    ----------
    controller
        Its name.
    margin
        The margin [s]; 0 where the loop is not even stable without delay.
    cart_mass, half_length
        The plant, M [kg] and l [m].
    """

    controller: str
    margin: float
    cart_mass: float
    half_length: float


def least_margin(unit: tuple[Law, tuple[Scenario, ...]]) -> LeastMargin | None:
    """Return the least delay margin over the plants of some scenarios, if there is one.

    Parameters
    ----------
    unit
        The law, and the scenarios, whose M(t) and l(t) are looked at every `EVERY`.
    """
    law, scenarios = unit
    plants = sorted({plant for scenario in scenarios for plant in _plants_of(scenario)})
    try:
        margins = [(delay_margin(law, *plant) or 0.0, *plant) for plant in plants]
    except InvalidValueError:  # the law has no linearisation at upright
        return None
    margin, mass, length = min(margins)
    return LeastMargin(controller=law.name, margin=margin, cart_mass=mass, half_length=length)


def _plants_of(scenario: Scenario) -> set[tuple[float, float]]:
    """Return the plants that a scenario goes through."""
    times = np.arange(0.0, scenario.duration, EVERY)
    pairs = zip(scenario.cart_mass(times), scenario.half_length(times), strict=True)
    return {(float(mass), float(length)) for mass, length in pairs}


def measured_delay(
    law: Law, mass: float, length: float, about: float, period: float = TIMESTEP
) -> float | None:
    """Return the delay [s] from which a small motion in MuJoCo grows; None if there is none.

    Parameters
    ----------
    law
        The law.
    mass, length
        M [kg] and l [m].
    about
        A delay near which to look, from a fifth of it to five times it [s].
    period
        How long the force is held [s].
    """
    scan = scan_levels(about / 5.0, about * 5.0, 7)
    found = find_threshold(lambda x: motion_decays(law, mass, length, x, period), scan, TOLERANCE)
    if found.place != BETWEEN or found.holds_at is None or found.fails_at is None:
        return None
    return math.sqrt(found.holds_at * found.fails_at)


def motion_decays(
    law: Law, mass: float, length: float, delay: float, period: float = TIMESTEP
) -> bool:
    """Return whether a small motion about upright decays in MuJoCo.

    Parameters
    ----------
    law
        The law.
    mass, length
        M [kg] and l [m].
    delay
        Transport delay [s].
    period
        How long the force is held [s].
    """
    steps = math.ceil(period / TIMESTEP - 1e-9)  # of a period
    scenario = Scenario(
        name="small motion",
        duration=max(1, round(DURATION / period)) * period,
        cart_mass=constant(mass),
        half_length=constant(length),
        initial_state=(0.0, START, 0.0, 0.0),
        realism=Realism(delay=delay),
    )
    run = simulate_sampled(scenario, law, timestep=period / steps, control_period=period)
    if run.outcome.kind != COMPLETED:
        return False
    peaks = np.array([part.max(axis=0) for part in np.array_split(np.abs(run.state), PARTS)])
    decayed = (peaks[-1] <= np.minimum(peaks[0], peaks[-2])).all()
    return bool(decayed and peaks[-1, 1] <= SMALL)
