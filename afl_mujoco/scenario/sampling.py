"""A scenario sampled on a time grid, for the simulators with a fixed step."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.disturbances import Impulse
from afl_mujoco.scenario.parameters import require_positive
from afl_mujoco.scenario.scenario import Scenario, Segment

MOST_STEPS = 10_000_000
"""Largest number of steps: more would fill the memory before the run ends."""

SNAP = 1e-9  # share of a step under which a grid point and a breakpoint are the same instant


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """Time grid whose steps never cross a breakpoint.

    Attributes
    ----------
    times
        The steps' ends [s], shape (N + 1,).
    cart_mass, half_length
        M [kg] and l [m] at the start, the middle and the end of each step, the limits from inside
        the step, shape (N, 3).
    push
        Disturbing force during each step [N], shape (N,).
    impulse
        Jump of the momentum along z at the start of each step [N s], shape (N,).
    """

    times: NDArray[np.float64]
    cart_mass: NDArray[np.float64]
    half_length: NDArray[np.float64]
    push: NDArray[np.float64]
    impulse: NDArray[np.float64]


def time_grid(scenario: Scenario, period: float) -> NDArray[np.float64]:
    """Return the multiples of `period` within the horizon together with every breakpoint.

    Parameters
    ----------
    period
        Spacing of the grid [s].

    Returns
    -------
    ndarray
        Increasing times from 0 to the horizon [s], shape (N + 1,).
    """
    period = require_positive("timestep", period)
    if period > scenario.duration:
        raise InvalidValueError("timestep", f"must be within {scenario.duration} s", period)
    special = np.array([*scenario.breakpoints, scenario.duration])
    _require_few("timestep", scenario.duration, period)
    regular = period * np.arange(int(np.ceil(scenario.duration / period)) + 1)
    after = np.minimum(np.searchsorted(special, regular), len(special) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.minimum(np.abs(special[after] - regular), np.abs(special[before] - regular))
    inside = (nearest > SNAP * period) & (regular < scenario.duration)
    inside[0] = True
    return np.sort(np.concatenate([regular[inside], special]))


@functools.lru_cache(maxsize=4)
def steps(scenario: Scenario, period: float) -> Steps:
    """Cut the horizon into steps of at most `period` that end on every breakpoint.

    Parameters
    ----------
    period
        The longest step [s].
    """
    times = time_grid(scenario, period)
    segments = scenario.segments
    starts = np.array([segment.start for segment in segments])
    index = np.searchsorted(starts, times[:-1], side="right") - 1
    middles = 0.5 * (times[:-1] + times[1:])
    mass, length = parameters_in(
        segments, index[:, None], np.stack([times[:-1], middles, times[1:]], axis=1)
    )
    impulse = np.zeros(len(index))
    impulse[np.searchsorted(times, starts)] = [segment.impulse for segment in segments]
    found = Steps(
        times=times,
        cart_mass=mass,
        half_length=length,
        push=np.array([segment.push for segment in segments])[index],
        impulse=impulse,
    )
    for array in (times, mass, length, found.push, impulse):
        array.flags.writeable = False  # several simulators share them
    return found


def parameters_in(
    segments: Sequence[Segment], index: NDArray[np.intp], times: NDArray[np.floating[Any]]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return M [kg] and l [m] at many times, each in the segment of its index."""
    elapsed = times - np.array([segment.start for segment in segments])[index]
    mass, length = (
        np.array([getattr(segment, name) for segment in segments])[index]
        for name in ("cart_mass", "half_length")
    )
    return mass[..., 0] + mass[..., 1] * elapsed, length[..., 0] + length[..., 1] * elapsed


def impulses_by_step(scenario: Scenario, starts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the ideal impulse [N s] at the start of each step, shape (N,).

    An impulse acts at the first step that starts at its time or after it.

    Parameters
    ----------
    starts
        Starts of the steps and the horizon [s], shape (N + 1,).
    """
    edges = np.concatenate([[-np.inf], starts[:-1]]) + SNAP * (starts[1] - starts[0])
    edges[-1] = np.inf  # an impulse after the last start acts at the last start
    hits = np.zeros(len(starts) - 1)
    for disturbance in scenario.disturbances:
        if isinstance(disturbance, Impulse):
            k = int(np.searchsorted(edges, disturbance.time, side="right")) - 1
            hits[k] = scenario.impulse_within(float(edges[k]), float(edges[k + 1]))
    return hits


def _require_few(unit: str, length: float, step: float) -> None:
    """Raise if `length` is more than `MOST_STEPS` steps."""
    if length / step > MOST_STEPS:
        raise InvalidValueError(
            unit,
            f"must be at least {length / MOST_STEPS:g} s here: more steps would fill the memory",
            step,
        )


def whole_steps(thing: str, length: float, unit: str, step: float) -> int:
    """Return how many steps make up `length`, or raise unless it is a whole number.

    Parameters
    ----------
    length
        Length to be divided [s].
    step
        Length of a step [s].
    """
    step, length = require_positive(unit, step), require_positive(thing, length)
    _require_few(unit, length, step)
    count = round(length / step)
    if count < 1 or abs(count * step - length) > SNAP * step * max(count, 1):
        raise InvalidValueError(f"{unit} {step:g} s", f"must divide {thing} {length:g} s")
    return count
