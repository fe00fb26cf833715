"""A schedule is piecewise linear, has the value after a jump, and knows its breakpoints."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from afl_mujoco import SCENARIOS, constant, joined, piecewise_linear, staircase, trapezoid
from afl_mujoco.errors import InvalidValueError
from tests.messages import line

EIGHTHS = st.integers(0, 80).map(lambda n: n / 8)  # sums and differences are exact
LEVELS = st.integers(1, 64).map(lambda n: n / 4)


@st.composite
def schedules(draw):
    times = sorted(draw(st.lists(EIGHTHS, min_size=1, max_size=6, unique=True)))
    knots = [t for t in times for _ in range(draw(st.integers(1, 2)))]
    return piecewise_linear(knots, draw(st.tuples(*[LEVELS] * len(knots))))


@pytest.mark.parametrize(("schedule", "expected", "breakpoints"), [
    pytest.param(constant(3.0), {-1: 3, 0: 3, 7: 3}, (), id="constant"),
    (staircase((1.0, 3.0), (0.5, 1.0, 2.0)), {0: 0.5, 0.999: 0.5, 1: 1, 2.999: 1, 3: 2, 99: 2},
     (1, 3)),
    (trapezoid((0.0, 2.0, 6.0, 8.0), 0.5, 2.0),
     {-1: 0.5, 0: 0.5, 1: 1.25, 2: 2, 4: 2, 6: 2, 7: 1.25, 8: 0.5, 9: 0.5}, (0, 2, 6, 8)),
    (piecewise_linear((1.0, 2.0, 2.0, 4.0), (0.0, 4.0, 1.0, 2.0)),
     {0: 0, 1: 0, 1.5: 2, 2: 1, 3: 1.5, 4: 2, 5: 2}, (1, 2, 4)),
    (joined((1.0, 3.0), (trapezoid((0.0, 1.0, 4.0, 5.0), 1.0, 2.0), constant(7.0))),
     {0: 1, 1: 1, 1.5: 1.5, 2: 2, 2.999: 2, 3: 7, 9: 7}, (1, 2, 3)),
])  # fmt: skip
def test_a_schedule_has_its_hand_written_values_and_breakpoints(schedule, expected, breakpoints):
    assert {t: schedule.at(t) for t in expected} == expected
    np.testing.assert_array_equal(schedule(list(expected)), list(expected.values()))
    assert schedule.breakpoints == breakpoints


def test_a_ramp_ends_at_its_knot_to_the_last_bit_before_it_too() -> None:
    ramp = trapezoid((0.0, 2.0, 6.0, 8.0), low=0.2, high=1.0)
    assert ramp.before(8.0) == ramp.at(8.0) == 0.2  # its slope would lead 4e-17 below
    assert SCENARIOS["step-trapezoid"].spans["half_length"] == (0.2, 1.0)


def test_a_piece_ends_where_the_next_starts_even_when_clocks_do_not_add_up_exactly():
    # 0.4 - 0.1 > 0.3 in floats, so the first piece's jump falls on the second piece's start
    schedule = joined((0.1, 0.4), (staircase((0.3,), (1.0, 2.0)), constant(3.0)))
    assert (schedule.at(0.2), schedule.at(0.4)) == (1.0, 3.0)


@settings(derandomize=True, max_examples=40, deadline=None)
@given(schedule=schedules(), times=st.lists(st.floats(-2, 12), min_size=1, max_size=8))
def test_piece_call_and_at_agree_everywhere(schedule, times):
    times = [*times, *schedule.times]
    at = [schedule.at(t) for t in times]
    np.testing.assert_array_equal(schedule(times), at)
    assert [schedule.piece(t)[0] for t in times] == at


@settings(derandomize=True, max_examples=40, deadline=None)
@given(first=schedules(), second=schedules(), start=EIGHTHS, gap=st.integers(1, 40))
def test_joined_follows_each_piece_on_its_own_clock(first, second, start, gap):
    change = start + gap / 8
    whole = joined((start, change), (first, second))
    for t in np.arange(-8, 200) / 16:
        expected = first.at(max(t - start, 0.0)) if t < change else second.at(t - change)
        assert whole.at(t) == pytest.approx(expected, rel=1e-13)  # rounding of one slope


@pytest.mark.parametrize(("build", "message"), [
    (lambda: piecewise_linear((1, 5, 3), (1, 1, 1)), "times must increase, got 3.0 after 5.0"),
    (lambda: trapezoid((0, 2, 8), 1, 2), "times must be four for a trapezoid, got 3"),
    (lambda: piecewise_linear((1, 1, 1), (1, 2, 3)),
     "times may repeat a time once, for a jump, got 1.0"),
    (lambda: piecewise_linear((1, 2), (1,)), "values must be as many as times (2), got 1"),
    (lambda: joined((), ()), "starts must be as many as the pieces (0), at least one, got 0"),
])  # fmt: skip
def test_a_schedule_that_breaks_a_rule_is_refused_in_one_line(build, message):
    with pytest.raises(InvalidValueError, match=line(message)):
        build()
