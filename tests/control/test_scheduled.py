import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.control.gains import GAIN_NAMES, Gains
from afl_mujoco.control.scheduled import BOX, DAMPING, SLOPES, force, slope_at
from afl_mujoco.errors import InvalidValueError, UnknownNameError
from afl_mujoco.simulation.metrics import metrics
from afl_mujoco.simulation.scoring import with_objective
from afl_mujoco.simulation.task import controller_policy
from research.gain_tuning import GainTable, paper_scales
from research.random_schedules import random_scenario
from tests.engine import episode

HELD = afl.CONTROLLERS["adaptive-held"]
SCENARIO = afl.SCENARIOS["step-trapezoid"]
SHORT = replace(SCENARIO, duration=4.0)


def sampled(scenario: afl.Scenario, controller: afl.Controller) -> afl.Trajectory:
    return afl.simulate_mujoco(scenario, controller, mode="sampled")


def test_the_gains_are_those_of_the_table_damped() -> None:
    table, base = GainTable.shipped(), HELD.fixed
    for mass, length in ((0.1, 0.05), (1.0, 0.5), (2.0, 1.0)):
        found = HELD.gains(mass, length)
        wanted = base.slope * (table.gains(mass, length).slope / base.slope) ** DAMPING
        assert found.slope == pytest.approx(wanted, rel=1e-12)
        assert (found.switching, found.boundary_layer) == (base.switching, base.boundary_layer)
    between = HELD.gains(1.05, 0.525).slope
    ends = [HELD.gains(m, x).slope for m in (1.0, 1.1) for x in (0.5, 0.55)]
    assert min(ends) <= between <= max(ends) and HELD.gains(5.0, 0.01) == HELD.gains(2.0, 0.05)


def test_a_run_keeps_the_gains_of_the_start_that_it_assumes_and_shares_them_with_no_other() -> None:
    wrong = replace(SHORT, belief={"cart_mass": {"error": 0.5}, "half_length": {"error": -0.2}})
    ideal = partial(afl.simulate_ode_held, timestep=1e-3)
    for scenario, more, less, simulate in (
        (SHORT, 1.0, 1.0, sampled),
        (SHORT, 1.0, 1.0, ideal),
        (wrong, 1.5, 0.8, sampled),
    ):
        start = scenario.parameters_at(0.0)
        gains = HELD.gains(more * start.cart_mass, less * start.half_length)
        function = afl.GainFunction.constant(gains)
        same = afl.AFLController(name="constant", gain_function=function)
        simulate(SHORT.with_schedule(cart_mass=0.1, half_length=0.05), HELD)
        held, kept = simulate(scenario, HELD), simulate(scenario, same)
        np.testing.assert_array_equal(held.state, kept.state)
        np.testing.assert_array_equal(held.force, kept.force)


def test_the_task_has_the_same_run_and_a_new_start_in_each_episode() -> None:
    run = sampled(SHORT, HELD)
    env = afl.load(SHORT)
    policy = controller_policy(HELD, SHORT)
    for _ in range(2):
        np.testing.assert_array_equal(episode(env, policy)[0], run.state)


def test_without_a_start_it_is_refused_and_beyond_the_table_remarked_on() -> None:
    with pytest.raises(InvalidValueError, match="chooses its gains when a run starts"):
        HELD.force([0.0, 0.1, 0.0, 0.0], afl.CartPoleParameters())
    to_the_end = (partial(afl.simulate_mujoco, mode=mode) for mode in ("continuous", "exact"))
    for simulate in (*to_the_end, afl.simulate_ode):
        with pytest.raises(InvalidValueError, match="is stateful"):
            simulate(SHORT, HELD)
    with pytest.raises(UnknownNameError):
        afl.find_controller("adaptive-held-estimated")
    heavy = afl.Scenario(name="heavy", schedule={"cart_mass": 3.0})
    (remark,) = HELD.remarks(heavy.plants)
    assert "M reaches 3 kg" in remark and "those of the edge" in remark
    assert HELD.remarks(SCENARIO.plants) == []


ANGLE, FIXED = afl.CONTROLLERS["adaptive-angle"], afl.CONTROLLERS["fixed-retuned"]


def test_the_slope_is_large_near_upright_and_stays_in_the_box():
    angles = np.deg2rad([0.0, 20.0, 40.0, 60.0, 80.0])
    slopes = [slope_at(angle, 0.5) for angle in angles]
    between = math.sqrt(SLOPES[0] * SLOPES[1])
    assert slopes == pytest.approx([SLOPES[0], SLOPES[0], between, SLOPES[1], SLOPES[1]])
    assert [slope_at(-angle, 0.5) for angle in angles] == slopes
    slopes = [slope_at(1.0, length) for length in (1e-6, 0.1, 0.5, 1.0, 1e9)]
    assert slopes == sorted(slopes, reverse=True) and slopes[1] > slopes[2] > slopes[3]
    assert (slopes[0], slopes[-1]) == (BOX[1], BOX[0])


def test_the_force_is_that_of_the_law_with_this_slope():
    plant = afl.CartPoleParameters(cart_mass=1.4, pole_mass=0.07, half_length=0.3, gravity=9.7)
    for state in ([0.1, -1.0, 0.4, 1.5], [-0.2, 0.3, 1.0, -2.0], [0.0, 0.0, 0.0, 0.0]):
        k, _, layer = (getattr(FIXED.gain_function, name)[0] for name in GAIN_NAMES)
        gains = Gains(switching=k, slope=slope_at(state[1], 0.3), boundary_layer=layer)
        expected = afl.control_force(state, plant, gains)
        assert force(3.0, state, plant) == pytest.approx(float(expected), rel=1e-12, abs=1e-12)
    assert math.isnan(force(0.0, [0.0, 1.6, 0.0, 0.0], plant))


@pytest.mark.slow
def test_it_has_a_lower_objective_than_fixed_gains_by_one_per_cent_on_nearly_every_schedule():
    won = []
    for index in range(6):
        scenario = random_scenario(12345, index)
        found = []
        for controller in (FIXED, ANGLE):
            run = afl.simulate_ode_rk4(scenario, controller, timestep=4e-3)
            found.append(with_objective(metrics(scenario, controller, run), paper_scales()))
        fixed, angle = (figures["objective"] for figures in found)
        won.append(angle is not None and angle < 0.99 * fixed)
    assert sum(won) >= 5  # how many of a thousand: benchmarks/bench_equal_effort.py
