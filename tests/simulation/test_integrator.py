"""The reference integrator restarts at every breakpoint and records how a run ends."""

import math
from dataclasses import replace

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.scenario.sampling import time_grid
from afl_mujoco.simulation.integrator import integrate, scipy_solver
from afl_mujoco.simulation.trajectory import FALL_ANGLE, criterion_of

TIGHT = 1e-11  # ten times the integrator's rtol, accumulated over a run of order 1


def _particle(state, mass, length, push):
    return state[2], state[3], push / mass, 0.0


def _kick(state, mass, length, impulse):
    return np.array([impulse / mass, 0.0])


def _run(scenario, derivative=_particle, jump_at=_kick, period=0.25):
    times = time_grid(scenario, period)

    def rate(time, state, segment):
        mass, _, length, _ = segment.values_at(time)
        return derivative(state, mass, length, segment.push[0])

    def arrive(state, before, after):
        mass, _, length, _ = after.values_at(after.start)
        jump = jump_at(state, mass, length, after.impulse[0])
        return state + np.array([0.0, 0.0, *jump])

    solver = scipy_solver(rate, criterion_of(scenario))
    states, outcome = integrate(scenario, solver, arrive, times)
    return times, states, outcome


REST = afl.Scenario(name="rest", initial_state=(0, 0, 0, 0), duration=20.0)


def test_a_pulse_of_10_ms_on_a_system_at_rest_is_not_missed():
    pulse = afl.ForcePulse(force=100.0, start=10.0003, duration=0.01)
    times, states, outcome = _run(replace(REST, disturbances=(pulse,)))
    assert str(outcome) == "completed"
    assert len(states) == len(times)
    # M = 1 kg: 1 m/s after the pulse, and 5 mm gained within it
    assert states[-1, 2] == pytest.approx(1.0, rel=TIGHT)
    assert states[-1, 0] == pytest.approx(0.005 + 20.0 - 10.0103, rel=TIGHT)
    assert (states[times <= 10.0003] == 0.0).all()


def test_an_impulse_jumps_the_velocity_at_its_instant_with_the_mass_after_the_jump():
    hit = afl.Impulse(momentum=3.0, time=5.0)
    scenario = replace(
        REST,
        schedule={**REST.schedule, "cart_mass": afl.staircase((5.0,), (1.0, 2.0))},
        disturbances=(hit,),
    )
    times, states, _ = _run(scenario)
    assert (states[times < 5.0] == 0.0).all()
    assert states[-1, 2] == pytest.approx(1.5, rel=TIGHT)
    assert states[-1, 0] == pytest.approx(1.5 * 15.0, rel=TIGHT)


def test_parameters_follow_the_schedule_within_a_segment():
    # z'' = M(t) = 1 + t: z = t^2/2 + t^3/6
    scenario = replace(
        REST,
        schedule={**REST.schedule, "cart_mass": afl.piecewise_linear((0.0, 2.0), (1.0, 3.0))},
        duration=2.0,
    )
    _, states, _ = _run(scenario, lambda s, mass, length, push: (s[2], s[3], mass, 0.0))
    assert states[-1, 0] == pytest.approx(2.0 + 8.0 / 6.0, rel=TIGHT)


def test_a_fall_ends_the_run_when_it_happens():
    scenario = replace(REST, initial_state=(0, 0, 0, 2.0))
    times, states, outcome = _run(scenario)
    assert outcome.kind == "fell"
    assert outcome.time == pytest.approx(FALL_ANGLE / 2.0, rel=TIGHT)
    assert len(states) == (times <= outcome.time).sum()
    assert np.isfinite(states).all()


def test_a_divergence_ends_the_run_without_a_nan():
    scenario = replace(REST, initial_state=(1.0, 0, 0, 0))
    times, states, outcome = _run(scenario, lambda s, *_: (3.0 * s[0], 0.0, 0.0, 0.0))
    assert outcome.kind == "diverged"
    assert outcome.time == pytest.approx(math.log(1e6) / 3.0, rel=1e-9)  # STATE_LIMIT
    assert len(states) == (times <= outcome.time).sum()
    assert np.isfinite(states).all()


def test_a_right_hand_side_without_a_value_at_the_start_ends_the_run():
    calls = 0

    def nothing(state, *_):
        nonlocal calls
        calls += 1
        if calls > 10_000:  # else the integrator would go on forever
            pytest.fail("the integrator does not end")
        return (math.nan,) * 4

    _, _, outcome = _run(REST, nothing)
    assert outcome.kind != "completed"
    assert outcome.time == 0.0
