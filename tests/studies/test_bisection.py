"""Bisection against properties whose threshold is known beforehand."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy import geomspace as scan_levels

from afl_mujoco.studies.shared.search import find_threshold


@given(st.floats(0.011, 99.0), st.floats(1e-3, 0.5), st.booleans())
def test_the_bracket_holds_the_threshold_and_is_as_narrow_as_asked(edge, tolerance, less_is_worse):
    ends = (100.0, 0.01) if less_is_worse else (0.01, 100.0)
    holds = edge.__lt__ if less_is_worse else edge.__gt__  # the edge lies below, or above
    found = find_threshold(holds, scan_levels(*ends, 7), tolerance)
    assert found.holds_at is not None and found.fails_at is not None
    assert holds(found.holds_at) and not holds(found.fails_at)
    assert abs(math.log(found.fails_at / found.holds_at)) <= math.log1p(tolerance) * (1 + 1e-9)


def test_the_first_loss_counts_and_that_every_level_holds_or_none_is_said():
    scan = scan_levels(1.0, 10.0, 4)
    all_hold = find_threshold(lambda level: True, scan, 0.1)
    assert (all_hold.holds_at, all_hold.fails_at) == (pytest.approx(10), None)
    none = find_threshold(lambda level: False, scan, 0.1)
    assert (none.holds_at, none.fails_at) == (None, 1.0)
    found = find_threshold(lambda x: x < 2.0 or 5.0 < x < 20.0, scan_levels(1.0, 100.0, 13), 0.01)
    assert found.fails_at == pytest.approx(2.0, rel=0.01)


def test_levels_that_come_in_steps_are_narrowed_to_one_step():
    tried = []

    def holds(level: float) -> bool:
        tried.append(level)
        return level < 6.6

    found = find_threshold(holds, scan_levels(0.5, 50.0, 5), 1e-6, lambda x: round(2 * x) / 2)
    assert (found.holds_at, found.fails_at) == (6.5, 7.0)
    assert all(2.0 * level == round(2.0 * level) for level in tried)


def test_each_narrow_loss_found_starts_the_count_of_levels_that_hold_anew():
    """Sixteen levels lie between two of the losses: fewer than must hold, more than half of it."""
    losses = ((40.0, 40.8), (34.0, 34.7))

    def holds(level: float) -> bool:
        return level < 47.0 and not any(low < level < high for low, high in losses)

    found = find_threshold(holds, scan_levels(1.0, 500.0, 13), 0.02, closer=20)
    assert found.fails_at == pytest.approx(34.0, rel=0.011)
    assert found.holds_at is not None and holds(found.holds_at)
