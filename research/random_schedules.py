"""The paper's schedules drawn at random."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from afl_mujoco.scenario.catalogue import CART_MASS_RANGE, HALF_LENGTH_RANGE
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.schedules import Schedule, staircase, trapezoid

LAST_CHANGE = 10.0  # latest time at which the schedules change [s], half the horizon
GRID = 2e-3  # the instants of change are multiples of this [s]


def random_scenario(seed: int, index: int) -> Scenario:
    """Return the scenario of a seed and an index: a random schedule of M and one of l.

    Each is, with even odds, two steps between three levels or a trapezoid between two, as in
    decision D3; levels are uniform in the box, instants uniform over `LAST_CHANGE`.
    """
    rng = np.random.default_rng((seed, index))
    boxes = {"cart_mass": CART_MASS_RANGE, "half_length": HALF_LENGTH_RANGE}
    schedule = {name: _shape(rng, box) for name, box in boxes.items()}
    return Scenario(name=f"random-{seed}-{index:05d}", schedule=schedule)


def _shape(rng: Generator, levels: tuple[float, float]) -> Schedule:
    is_step = rng.random() < 0.5
    instants = 1 + rng.choice(round(LAST_CHANGE / GRID), 2 if is_step else 4, replace=False)
    times = tuple((np.sort(instants) * GRID).tolist())
    drawn = rng.uniform(*levels, 3 if is_step else 2).tolist()
    if is_step:
        return staircase(times, tuple(drawn))
    return trapezoid(times, low=drawn[0], high=drawn[1])
