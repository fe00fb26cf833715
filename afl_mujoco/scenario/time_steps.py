"""A scenario sampled on a time grid, for the simulators with a fixed step."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.plants.plant import Floats
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.schedules import Impulse, channel_of, channels_of
from afl_mujoco.values import PER_SECOND, require_positive

MOST_STEPS = 10_000_000  # largest number of steps: more would fill the memory before the run ends
SNAP = 1e-6  # share of a step under which a grid point and a breakpoint are one instant
TYPED = 1e-5  # relative difference of periods of which one may be typed: 0.0166667 s
LONGEST_STEP = 1e-3  # MuJoCo's longest step by default [s]


def time_grid(scenario: Scenario, period: float) -> Floats:
    """Return multiples of a period [s] within the horizon and every breakpoint, shape (N + 1,)."""
    period = require_positive("timestep", period)
    if period > scenario.duration:
        raise InvalidValueError("timestep", f"must be within {scenario.duration} s", period)
    special = np.array([*scenario.breakpoints, scenario.duration])
    _require_few(scenario.duration, period)
    regular = period * np.arange(int(np.ceil(scenario.duration / period)) + 1)
    after = np.minimum(np.searchsorted(special, regular), len(special) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.minimum(np.abs(special[after] - regular), np.abs(special[before] - regular))
    inside = (nearest > SNAP * period) & (regular < scenario.duration)
    inside[0] = True
    return np.sort(np.concatenate([regular[inside], special]))


class Disturbances(NamedTuple):
    """What disturbs a plant in each step of a grid, on each of its channels."""

    push: Floats  # mean force over the step [N], shape (N, channels)
    impulse: Floats  # jump of the momentum in the step [N s], shape (N, channels)
    # when it acts, as a share of the step, 0 for its start; -1 for never, shape (N,)
    split: Floats


def held_disturbances(scenario: Scenario, times: Floats) -> Disturbances:
    """Return what disturbs the cart in each step, wherever the edges of the disturbances lie.

    A pulse acts with its exact mean over each step, so that all of its momentum arrives; an impulse
    acts at its instant, and several in one step act with the first of them.

    times: Ends of the steps [s], shape (N + 1,).
    """
    lengths, channels = np.diff(times), len(channels_of(scenario.plant))
    push, impulse = np.zeros((2, len(lengths), channels))
    split = np.full(len(lengths), -1.0)
    for one in scenario.disturbances:
        channel = channel_of(one, scenario.plant)
        if isinstance(one, Impulse):
            at = _place(times, one.time)
            step = min(int(at), len(lengths) - 1)
            split[step] = at - step if split[step] < 0.0 else min(split[step], at - step)
            impulse[step, channel] += one.momentum
        else:
            start, end = _place(times, one.start), _place(times, one.end)
            steps_ = np.arange(int(start), min(math.ceil(end), len(lengths)))
            acts = np.minimum(end, steps_ + 1) - np.maximum(start, steps_)
            push[steps_, channel] += one.force * acts
    return Disturbances(push, impulse, split)


def _place(times: Floats, time: float) -> float:
    """Return where an instant lies on a grid, in steps; whole at the ends of steps."""
    count = len(times) - 1
    k = int(np.clip(np.searchsorted(times, time, side="right") - 1, 0, count - 1))
    place = k + float((time - times[k]) / (times[k + 1] - times[k]))
    nearest = round(place)
    return min(float(nearest) if abs(place - nearest) <= SNAP else place, float(count))


def _require_few(duration: float, step: float) -> None:
    if duration / step > MOST_STEPS:
        rule = f"must be at least {duration / MOST_STEPS:g} s for a duration of {duration:g} s"
        raise InvalidValueError("timestep", f"{rule}: more steps would fill the memory", step)


def instants(times: Floats) -> Floats:
    """Return times [s] to the picosecond, as `instant` does: schedules have no finer ones."""
    return np.where(np.abs(times) < 1e9, np.rint(times * PER_SECOND) / PER_SECOND, times)


class Ticks(NamedTuple):
    """How a control period is cut into physics steps."""

    timestep: float  # physics step [s]
    hold: int  # physics steps of a control period

    @property
    def period(self) -> float:
        """Control period [s]."""
        return self.timestep * self.hold


def cut_period(period: float | None, timestep: float | None) -> Ticks:
    """Return physics steps that divide a control period [s], None for one step, or raise.

    A timestep may differ by `TYPED` from one that does; None is the longest up to `LONGEST_STEP`.
    """
    longest = LONGEST_STEP if timestep is None else require_positive("timestep", timestep)
    if period is None:
        return Ticks(longest, 1)
    require_positive("control_period", period)
    ratio = period / longest
    hold = max(round(ratio), 1)
    if timestep is None and abs(hold - ratio) > SNAP * hold:
        hold = math.ceil(ratio)
    elif abs(hold - ratio) > TYPED * hold:
        rule = f"must divide control_period {period:g} s"
        raise InvalidValueError(f"timestep {longest:g} s", rule)
    exact = abs(hold - ratio) <= SNAP * hold  # as it was given, to the last bit
    return Ticks(longest if exact else period / hold, hold)


def ticks_of(
    scenario: Scenario, timestep: float | None = None, control_period: float | None = None
) -> Ticks:
    """Return how the control period of a scenario is cut into physics steps, or raise.

    The control period [s] is for a scenario that does not set it; None is one step.
    """
    own = scenario.imperfections.control_period
    for thing, given in (("control_period", control_period), ("timestep", timestep)):
        if given is not None:
            require_positive(thing, given)
    period = control_period if own is None else own
    if period is not None and period > scenario.duration:
        rule = f"must be within the duration {scenario.duration:g} s (in seconds, not Hz)"
        raise InvalidValueError("control_period", rule, period)
    if control_period is not None and own is not None:
        if abs(control_period - own) > TYPED * own:
            rule = f"must be that of scenario {scenario.name!r}, {own:g} s"
            raise InvalidValueError("control_period", rule, control_period)
    if timestep is not None and timestep > scenario.duration:
        rule = f"must be within the duration {scenario.duration:g} s"
        raise InvalidValueError("timestep", rule, timestep)
    ticks = cut_period(period, timestep)
    _require_few(scenario.duration, ticks.timestep)
    return ticks


@dataclass(frozen=True, slots=True)
class Deployed:
    """How MuJoCo runs in sampled mode.

    Attributes
    ----------
    integrator
        ``"RK4"``, ``"Euler"``, ``"implicit"`` or ``"implicitfast"``.
    timestep
        Physics step [s], by default the longest up to 1 ms that divides the control period.
    control_period
        How long inputs are held [s], by default one step; that of a scenario cannot be replaced.
    """

    integrator: str = "RK4"
    timestep: float | None = None
    control_period: float | None = None

    def on(self, scenario: Scenario) -> Deployed:
        """Return the same with the step and the control period that apply to a scenario."""
        ticks = ticks_of(scenario, self.timestep, self.control_period)
        return replace(self, timestep=ticks.timestep, control_period=ticks.period)

    def describe(self, held: str = "force") -> str:
        """Describe it in one line; `held` is what a controller commands."""
        step = LONGEST_STEP if self.timestep is None else self.timestep
        period = step if self.control_period is None else self.control_period
        return (
            f"as deployed: {self.integrator} at {1e3 * step:.3g} ms, "
            f"{held} held for {1e3 * period:.3g} ms"
        )


DEFAULT = Deployed()


def step_times(duration: float, timestep: float) -> Floats:
    """Return the ends [s] of equal steps, the last one shortened to the horizon, shape (N + 1,)."""
    _require_few(duration, timestep)
    count = max(math.ceil(duration / timestep - SNAP), 1)
    times: Floats = np.arange(count + 1, dtype=np.float64) * timestep
    if abs(times[-1] - duration) > SNAP * timestep:
        times[-1] = duration
    return times


def last_step(times: Floats, timestep: float) -> float:
    """Return the length of the last of such steps [s], a whole one but for round-off."""
    length = float(times[-1]) - (len(times) - 2) * timestep
    return length if length < (1.0 - SNAP) * timestep else timestep
