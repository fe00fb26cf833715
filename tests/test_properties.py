"""What holds for any state, plant, schedule and scenario, as Hypothesis makes them up.

That any scenario survives its file is in `scenario/test_files.py`.
"""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import Phase, assume, example, given, note, settings
from hypothesis import strategies as st

import afl_mujoco as afl
from afl_mujoco.control.law import afl_force
from afl_mujoco.studies.verify.cases import Settings, closed_loop_runs
from afl_mujoco.studies.verify.checks import CRITERIA, state_difference

CART_MASS = st.floats(0.1, 2.0)
HALF_LENGTH = st.floats(0.05, 1.0)
POLE_MASS = st.floats(0.01, 0.5)
STATES = st.tuples(st.floats(-3, 3), st.floats(-1.4, 1.4), st.floats(-5, 5), st.floats(-6, 6))
CONTROLLERS = ("fixed", "adaptive", "fixed-nominal")
KNOWN = {"cart_mass": CART_MASS, "pole_mass": POLE_MASS, "half_length": HALF_LENGTH}
PLANTS = st.builds(afl.CartPoleParameters, **KNOWN, gravity=st.floats(1.0, 25.0))


def inputs_for(controller: str, p: afl.CartPoleParameters) -> np.ndarray:
    told = np.array([[p.cart_mass, p.pole_mass, p.half_length, p.gravity]])
    return afl.CONTROLLERS[controller].inputs_for(told)[0]


@pytest.mark.parametrize("controller", CONTROLLERS)
@settings(derandomize=True, max_examples=300, deadline=None)
@given(state=STATES, plant=PLANTS)
@example(state=(0.0, 0.0, 0.0, 0.0), plant=afl.CartPoleParameters())
def test_the_controller_is_finite_and_odd_to_the_last_bit(controller, state, plant) -> None:
    inputs = inputs_for(controller, plant)
    force = afl_force(np.array(state), inputs)
    assert math.isfinite(force) and afl_force(-np.array(state), inputs) == -force


@pytest.mark.parametrize("controller", CONTROLLERS)
@settings(derandomize=True, max_examples=200, deadline=None)
@given(one=STATES, other=STATES, plant=PLANTS)
def test_the_controller_has_no_jump_between_any_two_states(controller, one, other, plant) -> None:
    inputs = inputs_for(controller, plant)
    a, b = np.array(one), np.array(other)
    forces = afl_force(a, inputs), afl_force(b, inputs)
    largest = max(1.0, *map(abs, forces))
    for _ in range(50):  # into the half over which the force changes more: a jump would stay
        middle = 0.5 * (a + b)
        force = afl_force(middle, inputs)
        largest = max(largest, abs(force))
        if abs(force - forces[0]) > abs(force - forces[1]):
            b, forces = middle, (forces[0], force)
        else:
            a, forces = middle, (force, forces[1])
    assert abs(forces[1] - forces[0]) <= 1e-10 * largest  # 1e-15 apart, and round-off


@st.composite
def schedules(draw: st.DrawFn, values: st.SearchStrategy[float], end: float) -> afl.Schedule:
    drawn = draw(st.lists(st.floats(0.0, end), max_size=4, unique=True))
    times = [t for t in sorted(drawn) for _ in range(draw(st.integers(1, 2)))]
    assume(all(b - a > 1e-6 or a == b for a, b in pairwise(times)))
    if not times:
        return afl.constant(draw(values))
    return afl.piecewise_linear(times, [draw(values) for _ in times])


@st.composite
def scenarios(draw: st.DrawFn) -> afl.Scenario:
    """About a second of anything, its times on no grid, its horizon a whole number of ms."""
    end = draw(st.integers(800, 1200)) / 1000
    edge = st.floats(0.0, end - 1e-6)
    edges = st.tuples(edge, edge).map(sorted).filter(lambda x: x[1] - x[0] > 1e-6)
    pulses = st.builds(
        lambda force, x: afl.ForcePulse(force=force, start=x[0], duration=x[1] - x[0]),
        *(st.floats(-20.0, 20.0), edges),
    )
    hits = st.builds(afl.Impulse, momentum=st.floats(-1.0, 1.0), time=edge)
    course = {name: draw(schedules(KNOWN[name], end)) for name in ("cart_mass", "half_length")}
    course["pole_mass"] = draw(POLE_MASS)
    found = draw(st.lists(st.one_of(pulses, hits), max_size=2))
    start = draw(st.tuples(*(st.floats(-x, x) for x in (1.0, math.radians(75), 1.0, 1.0))))
    what = {"disturbances": found, "initial_state": start, "schedule": course}
    return afl.Scenario(name="any", duration=end, **what)


# At 1 ms RK4 itself is not stable under a controller that takes a 0.1 kg cart for 1 kg, and off by
# 1e-5 with a pole of 5 cm; at 0.25 ms it is off by 3e-9 at most, and what is left is the model.
FINE = Settings(timestep=2.5e-4, control_period=2.5e-4)


@pytest.mark.parametrize("controller", CONTROLLERS)
# shrinking a failure takes minutes: add Phase.shrink to get the smallest
@settings(derandomize=True, max_examples=8, deadline=None, phases=[Phase.generate])
@given(scenario=scenarios())
def test_any_scenario_goes_the_same_way_in_both_simulators(controller, scenario) -> None:
    runs = closed_loop_runs(scenario, afl.CONTROLLERS[controller], FINE)
    twins = ("B1", "exact", "ode"), ("B2b", "continuous", "ode RK4"), ("B3", "sampled", "ode held")
    for check, mode, name in twins:
        one, other = runs[f"mujoco {mode}"], runs[name]
        note(f"{check}: {one.outcome}, {other.outcome}")
        assert state_difference(one, other) <= CRITERIA[check].limit, check


@pytest.mark.parametrize("controller", CONTROLLERS)
@pytest.mark.parametrize("angle", [1.45, -1.55], ids=str)
def test_a_scenario_that_ends_early_ends_alike_in_both_simulators(controller, angle) -> None:
    way = math.copysign(1.0, angle)
    hit = {"disturbances": (afl.Impulse(momentum=-60.0 * way, time=0.0107),)}
    what = {"schedule": {"half_length": 0.15}, "initial_state": (0.0, angle, 0.0, way)}
    scenario = afl.Scenario(name="falling", duration=1.0, **what, **hit)
    runs = closed_loop_runs(scenario, afl.CONTROLLERS[controller], FINE)
    assert {run.outcome.kind for run in runs.values()} in ({"fell"}, {"diverged"})
    times = [runs[name].outcome.time for name in ("mujoco exact", "ode")]
    assert times[0] == pytest.approx(times[1], abs=1e-9)  # RK4 misses it by some steps
    before = runs["ode"].time < 0.0107  # the controller amplifies round-off on the way down
    one, other = (runs[name].state[: before.sum()] for name in ("mujoco exact", "ode"))
    assert before.sum() > 10 and abs(one - other).max() <= CRITERIA["B1"].limit


def test_a_pulse_may_end_a_rounding_early_and_a_ramp_too_steep_for_a_float_is_a_jump() -> None:
    pulse = afl.ForcePulse(force=-0.55, start=0.16800636893160892, duration=0.7749936310683909)
    assert pulse.end == 0.943 > 0.16800636893160892 + pulse.duration  # one instant
    late = afl.ForcePulse(force=1.0, start=0.1, duration=0.2)  # 0.1 + 0.2 > 0.3
    for one, end in ((pulse, 0.943), (late, 0.3)):
        scenario = afl.Scenario(name="hair", disturbances=(one,), duration=end)
        runs = closed_loop_runs(scenario, afl.CONTROLLERS["fixed"], Settings())
        assert {run.outcome.kind for run in runs.values()} == {"completed"}
    assert afl.piecewise_linear((0.3, 0.3 + 1e-16), (1.0, 2.0)) == afl.staircase([0.3], [1.0, 2.0])
