"""Schedules drawn at random over the paper's box of parameters, in the shapes of its four cases."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.schedules import Schedule, staircase, trapezoid

CART_MASS_RANGE, HALF_LENGTH_RANGE = (0.1, 2.0), (0.05, 1.0)
"""The paper's box of M [kg] and l [m]."""

LAST_CHANGE = 10.0
"""Latest time at which the schedules change [s], half the horizon."""

GRID = 2e-3
"""The instants of change are multiples of this [s]."""


def random_scenario(seed: int, index: int) -> Scenario:
    """Return the scenario of a seed and an index: a random schedule of M and one of l.

    Each is, with even odds, two steps between three levels or a trapezoid between two, as in
    decision D3; levels are uniform in the box, instants uniform over `LAST_CHANGE`.
    """
    rng = np.random.default_rng((seed, index))
    mass, length = _shape(rng, CART_MASS_RANGE), _shape(rng, HALF_LENGTH_RANGE)
    return Scenario(name=f"random-{seed}-{index:05d}", cart_mass=mass, half_length=length)


def _shape(rng: Generator, levels: tuple[float, float]) -> Schedule:
    """Return a random step or trapezoid between levels of a range."""
    is_step = rng.random() < 0.5
    instants = 1 + rng.choice(round(LAST_CHANGE / GRID), 2 if is_step else 4, replace=False)
    times = tuple((np.sort(instants) * GRID).tolist())
    drawn = rng.uniform(*levels, 3 if is_step else 2).tolist()
    if is_step:
        return staircase(times, tuple(drawn))
    return trapezoid(times, low=drawn[0], high=drawn[1])
