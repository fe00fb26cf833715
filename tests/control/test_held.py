"""Gains chosen at the start and kept: in every simulator that has a start, refused elsewhere."""

from dataclasses import replace

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.control.scheduled import DAMPING, HeldController
from afl_mujoco.errors import InvalidValueError, UnknownNameError
from afl_mujoco.simulation.task import controller_policy
from research.gain_tuning import GainTable

HELD = afl.CONTROLLERS["adaptive-held"]
SCENARIO = afl.SCENARIOS["step-trapezoid"]
SHORT = replace(SCENARIO, duration=4.0)


def constant_gains(mass: float, length: float) -> afl.AFLController:
    assert isinstance(HELD, HeldController)
    return afl.AFLController(
        name="constant", gain_function=afl.GainFunction.constant(HELD.gains(mass, length))
    )


def sampled(scenario: afl.Scenario, controller: afl.Controller) -> afl.Trajectory:
    return afl.simulate_mujoco(scenario, controller, mode="sampled")


def test_the_gains_are_those_of_the_table_damped() -> None:
    assert isinstance(HELD, HeldController)
    table, base = GainTable.shipped(), HELD.fixed
    for mass, length in ((0.1, 0.05), (1.0, 0.5), (2.0, 1.0)):
        found = HELD.gains(mass, length)
        wanted = base.slope * (table.gains(mass, length).slope / base.slope) ** DAMPING
        assert found.slope == pytest.approx(wanted, rel=1e-12)
        assert (found.switching, found.boundary_layer) == (base.switching, base.boundary_layer)
    between = HELD.gains(1.05, 0.525).slope
    ends = [HELD.gains(m, x).slope for m in (1.0, 1.1) for x in (0.5, 0.55)]
    assert min(ends) <= between <= max(ends)
    assert HELD.gains(5.0, 0.01) == HELD.gains(2.0, 0.05)


def test_a_run_keeps_the_gains_of_its_start() -> None:
    start = SHORT.parameters_at(0.0)
    same = constant_gains(start.cart_mass, start.half_length)
    for simulate in (sampled, lambda s, c: afl.simulate_ode_held(s, c, timestep=1e-3)):
        held, kept = simulate(SHORT, HELD), simulate(SHORT, same)
        np.testing.assert_array_equal(held.state, kept.state)
        np.testing.assert_array_equal(held.force, kept.force)


def test_two_runs_do_not_share_their_start() -> None:
    other = replace(
        SHORT,
        schedule={
            **SHORT.schedule,
            "cart_mass": afl.constant(0.1),
            "half_length": afl.constant(0.05),
        },
    )
    alone = sampled(SHORT, HELD)
    sampled(other, HELD)
    np.testing.assert_array_equal(sampled(SHORT, HELD).state, alone.state)


def test_the_start_is_the_one_assumed() -> None:
    wrong = replace(SHORT, belief={"cart_mass": {"error": 0.5}, "half_length": {"error": -0.2}})
    start = SHORT.parameters_at(0.0)
    same = constant_gains(1.5 * start.cart_mass, 0.8 * start.half_length)
    found = [sampled(wrong, one).state for one in (HELD, same)]
    np.testing.assert_array_equal(*found)


def test_the_task_has_the_same_run_and_a_new_start_in_each_episode() -> None:
    run = sampled(SHORT, HELD)
    env = afl.load(SHORT)
    policy = controller_policy(HELD, SHORT)
    for _ in range(2):
        step, states = env.reset(), []
        while True:
            states.append(
                np.concatenate([step.observation["position"], step.observation["velocity"]])
            )
            if step.last():
                break
            step = env.step(policy(step))
        np.testing.assert_array_equal(np.array(states), run.state)


def test_without_a_start_it_is_refused() -> None:
    with pytest.raises(InvalidValueError, match="chooses its gains when a run starts"):
        HELD.force([0.0, 0.1, 0.0, 0.0], afl.CartPoleParameters())
    for mode in ("continuous", "exact"):
        with pytest.raises(InvalidValueError, match="is stateful"):
            afl.simulate_mujoco(SHORT, HELD, mode=mode)
    with pytest.raises(InvalidValueError, match="is stateful"):
        afl.simulate_ode(SHORT, HELD)
    with pytest.raises(UnknownNameError):
        afl.find_controller("adaptive-held-estimated")


def test_a_command_that_knows_no_start_refuses_it_in_one_line(command_line) -> None:
    code, output, errors = command_line("validate", "nominal", "--controllers", "adaptive-held")
    assert (code, output) == (2, "")
    assert errors.startswith("afl-mujoco: controller 'adaptive-held' ") and errors.count("\n") == 1


def test_a_plant_beyond_the_table_is_remarked_on() -> None:
    heavy = afl.Scenario(name="heavy", schedule={"cart_mass": afl.constant(3.0)})
    (remark,) = HELD.remarks(heavy.plants)
    assert "M reaches 3 kg" in remark and "those of the edge" in remark
    assert HELD.remarks(SCENARIO.plants) == []
