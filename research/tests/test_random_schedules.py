"""Random schedules: their distribution, over the whole box of the paper."""

import itertools

import numpy as np
import pytest
from scipy.stats import kstest, spearmanr

from afl_mujoco.scenario.catalogue import CART_MASS_RANGE, HALF_LENGTH_RANGE
from research.random_schedules import LAST_CHANGE, random_scenario

DRAWN = [random_scenario(0, index) for index in range(1000)]
SCHEDULES = {
    "cart_mass": ([s.cart_mass for s in DRAWN], CART_MASS_RANGE),
    "half_length": ([s.half_length for s in DRAWN], HALF_LENGTH_RANGE),
}
CERTAIN = 1e-3
"""Least p-value of a sound draw; the draws are fixed by their seed."""


@pytest.mark.parametrize("name", SCHEDULES)
def test_levels_and_instants_are_uniform_over_the_whole_box(name: str) -> None:
    schedules, (low, high) = SCHEDULES[name]
    # A step has three levels at three knots or more, a trapezoid two: the first two are independent
    for which in (0, -1):
        levels = [schedule.values[which] for schedule in schedules]
        assert kstest(levels, "uniform", (low, high - low)).pvalue > CERTAIN
    for which in (0, -1):
        levels = [s.values[which] for s in schedules if len(s.breakpoints) == 4]
        assert kstest(levels, "uniform", (low, high - low)).pvalue > CERTAIN
    instants = [time for schedule in schedules for time in schedule.breakpoints]
    assert kstest(instants, "uniform", (0.0, LAST_CHANGE)).pvalue > CERTAIN


def test_steps_and_trapezoids_are_even_and_those_of_m_say_nothing_about_l() -> None:
    steps = np.array([[len(s.breakpoints) == 2 for s in all_] for all_, _ in SCHEDULES.values()])
    shares = [float(np.mean(row)) for row in (*steps, steps[0] == steps[1])]
    assert shares == pytest.approx([0.5, 0.5, 0.5], abs=0.05)
    for which in (0, -1):
        levels = [[s.values[which] for s in all_] for all_, _ in SCHEDULES.values()]
        assert spearmanr(*levels).pvalue > CERTAIN
        times = [[s.breakpoints[which] for s in all_] for all_, _ in SCHEDULES.values()]
        assert spearmanr(*times).pvalue > CERTAIN
    after = [[a.cart_mass.values[0], b.cart_mass.values[0]] for a, b in itertools.pairwise(DRAWN)]
    assert spearmanr(*np.transpose(after)).pvalue > CERTAIN
