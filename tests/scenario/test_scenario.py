import dataclasses
import math

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco import CartPoleParameters, Scenario, staircase, trapezoid
from afl_mujoco.control.gains import GAIN_NAMES
from afl_mujoco.errors import AflMujocoError
from afl_mujoco.scenario.time_steps import time_grid
from tests.messages import line

BALL = """<mujoco><worldbody><body><joint name="x" type="slide"/><geom size="1"/></body>
</worldbody></mujoco>"""
PULSE = afl.ForcePulse(force=-10.0, start=2.0, duration=0.5)


def test_segments_cover_the_horizon_and_part_at_schedules_and_disturbances(odd_scenario):
    segments = odd_scenario.segments
    assert segments[0].start == 0.0 and segments[-1].end == odd_scenario.duration
    assert [s.end for s in segments[:-1]] == [s.start for s in segments[1:]]
    assert all(s.start < s.end for s in segments)
    assert tuple(s.start for s in segments[1:]) == odd_scenario.breakpoints
    schedule = {
        "cart_mass": staircase((1.0, 30.0), (1.0, 2.0, 3.0)),
        "half_length": trapezoid((0.0, 1.0, 4.0, 5.0), 0.2, 0.4),
    }
    hits = (PULSE, afl.Impulse(momentum=1.0, time=3.0))
    scenario = Scenario(name="x", schedule=schedule, disturbances=hits)
    assert scenario.breakpoints == (1.0, 2.0, 2.5, 3.0, 4.0, 5.0)


def test_its_plants_are_all_that_its_schedules_pass_through():
    """Also the values just before a jump and at the horizon, which no breakpoint has."""
    lengths = {"half_length": afl.Schedule((0.0, 20.0), (0.4, 0.2))}
    beyond = Scenario(name="x", schedule=lengths, duration=10.0)
    assert beyond.plants.half_length == pytest.approx((0.3, 0.4))
    for times, masses, plants in (
        ((0.0, 4.0, 4.0), (1.0, 3.0, 1.5), (1.0, 3.0)),  # a ramp that a jump ends
        ((0.0, 4.0, 4.0), (3.0, 1.0, 2.0), (1.0, 3.0)),
        ((0.0, 10.0, 10.0), (1.0, 2.0, 9.0), (1.0, 2.0)),
    ):
        jumps = beyond.with_schedule(cart_mass=afl.Schedule(times, masses))
        assert jumps.plants.cart_mass == plants


def test_a_segment_gives_parameters_up_to_its_end_and_a_time_those_after_the_jump(odd_scenario):
    for segment in odd_scenario.segments:
        mass, _, length, _ = segment.values_at(segment.end)
        # the limit from inside; one rounding apart at most
        assert mass == pytest.approx(odd_scenario.cart_mass.before(segment.end), rel=1e-15)
        assert length == pytest.approx(odd_scenario.half_length.before(segment.end), rel=1e-15)
    p = odd_scenario.parameters_at(0.1507)
    assert (p.cart_mass, p.pole_mass, p.gravity) == (1.6, 0.083, 9.65)
    # hand-written line from 0.35 m at 0.0503 s to 0.62 m at 0.6009 s
    assert p.half_length == pytest.approx(0.35 + 0.27 * (0.1507 - 0.0503) / 0.5506, rel=1e-14)


def test_a_pulse_acts_to_just_before_its_end_pulses_add_up_and_impulses_come_first():
    scenario = Scenario(name="x", disturbances=(PULSE,))
    assert [(s.start, s.push[0]) for s in scenario.segments] == [(0, 0), (2, -10), (2.5, 0)]
    other = afl.ForcePulse(force=4.0, start=2.25, duration=1.0)
    both = Scenario(name="x", disturbances=(PULSE, other))
    assert [s.push[0] for s in both.segments] == [0.0, -10.0, -6.0, 4.0, 0.0]
    hits = (afl.Impulse(momentum=1.5, time=0.0), afl.Impulse(momentum=-2.0, time=3.0))
    scenario = Scenario(name="x", disturbances=(*hits, afl.Impulse(momentum=0.5, time=3.0)))
    assert [(s.start, s.impulse[0]) for s in scenario.segments] == [(0.0, 1.5), (3.0, -1.5)]


@pytest.mark.parametrize(("fields", "message"), [
    ({"schedule": {"half_length": staircase((1,), (0.5, 0.0))}},
     "schedule.half_length must be positive, got 0.0"),
    ({"schedule": {"gravity": staircase((1,), (9.81, 1.62))}},
     "schedule.gravity must be one number: only cart_mass and half_length change during a "
     "run, got [9.81, 1.62]"),
    ({"initial_state": {"psi": 1}},
     "initial_state name must be one of z, phi, z_dot, phi_dot, got 'psi'; did you mean phi?"),
    ({"plant": afl.Plant(name="ball", coordinates=("x",), model=BALL), "schedule": {"m": 1.0}},
     "schedule name must be left out: there is none, got 'm'"),
], ids=lambda value: "-".join(value) if isinstance(value, dict) else "")  # fmt: skip
def test_a_scenario_that_breaks_a_rule_is_refused_in_one_line(fields, message):
    with pytest.raises(AflMujocoError, match=line(message)):
        Scenario(**{"name": "x", **fields})


@pytest.mark.parametrize(("kind", "values", "message"), [
    (afl.ForcePulse, {"force": math.nan, "start": 0, "duration": 1}, "force must be finite"),
    (afl.ForcePulse, {"force": 1, "start": 0, "duration": 0}, "duration must be positive, got 0.0"),
    (afl.Impulse, {"momentum": 1, "time": -2}, "time must not be negative, got -2.0"),
    (CartPoleParameters, {"cart_mass": np.True_}, "cart_mass must be"),
    (CartPoleParameters, {"cart_mass": 10**400}, "cart_mass must be"),
    *((afl.Gains, {**dict.fromkeys(GAIN_NAMES, 1.0), name: value}, f"{name} must be {message}$")
      for name in GAIN_NAMES for value, message in (
        (0.0, "positive, got 0.0"), (-1.0, "positive, got -1.0"), (math.nan, "finite, got nan"))),
    *((CartPoleParameters, {name: value}, f"{name} must be {message}$")
      for name in ("cart_mass", "pole_mass", "half_length", "gravity") for value, message in (
        (0, "positive, got 0.0"), (float("nan"), "finite, got nan"), (True, "a number, got True"),
        ("1.0", "a number, got '1.0'"))),
])  # fmt: skip
def test_a_value_that_breaks_a_rule_is_refused_by_name_in_one_line(kind, values, message):
    with pytest.raises(AflMujocoError, match=f"^{message}") as caught:
        kind(**values)
    assert caught.value.thing in values


def test_parameters_are_keyword_only_frozen_and_by_default_the_paper_s(odd_parameters):
    p = CartPoleParameters()
    assert (p.cart_mass, p.pole_mass, p.half_length, p.gravity) == (1.0, 0.05, 0.5, 9.81)
    with pytest.raises(TypeError):
        CartPoleParameters(1.0)
    with pytest.raises(dataclasses.FrozenInstanceError):
        odd_parameters.cart_mass = 2.0


@pytest.mark.parametrize("period", [1e-3, 7e-3, 0.8], ids=str)
def test_the_grid_holds_every_breakpoint_exactly_and_no_step_straddles_one(odd_scenario, period):
    grid = time_grid(odd_scenario, period)
    assert set(odd_scenario.breakpoints) <= set(grid.tolist())
    assert (grid[0], grid[-1]) == (0.0, odd_scenario.duration)
    widths = np.diff(grid)
    assert widths.min() > 0.0
    assert widths.max() <= period * (1 + 1e-12)  # rounding of k * period
    # a breakpoint replaces a multiple of the period
    jump = Scenario(name="x", schedule={"cart_mass": staircase((0.3,), (1.0, 2.0))}, duration=0.5)
    assert 3 * 0.1 > 0.3  # but for round-off the same
    grid = time_grid(jump, 0.1)
    assert len(grid) == 6 and 0.3 in grid
    late = jump.with_schedule(cart_mass=staircase((np.nextafter(0.2, 1.0),), (1.0, 2.0)))
    assert np.diff(time_grid(late, 0.1)).min() > 0.09
