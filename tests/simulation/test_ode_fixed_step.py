"""The fixed-step runs: order of accuracy, and the held loop against a second integrator."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.control.own import PythonController
from afl_mujoco.plants.cartpole_equations import plant as cart_pole
from afl_mujoco.simulation.ode_fixed_step import Holds
from tests.feedback import feedback

STEP_SIZES = (4e-3, 2e-3, 1e-3, 5e-4)


def order(simulate, scenario, controller):
    exact = afl.simulate_ode(scenario, controller, sample_period=scenario.duration).state[-1]
    runs = (simulate(scenario, controller, timestep=h).state[-1] for h in STEP_SIZES)
    return np.polyfit(np.log(STEP_SIZES), np.log([np.abs(end - exact).max() for end in runs]), 1)[0]


@pytest.mark.parametrize("kind", ["smooth_scenario", "odd_scenario"])
def test_rk4_and_substeps_are_of_order_four_and_the_held_loop_is_of_the_first(
    kind, request, controller
):
    """Jumps and pulses included; substeps with the force held and M and l followed within each."""
    scenario, holds = request.getfixturevalue(kind), Holds(control_period=1e-3)
    assert 3.7 <= order(afl.simulate_ode_rk4, scenario, controller) <= 4.3
    if kind == "smooth_scenario":
        assert 0.9 <= order(afl.simulate_ode_held, scenario, controller) <= 1.1  # B4
    run = partial(afl.simulate_ode_held, scenario, controller, holds=holds)
    one, two, many = (run(substeps=n).state for n in (1, 2, 8))
    assert 8.0 < np.abs(one - many).max() / np.abs(two - many).max() < 32.0


def test_a_breakpoint_just_before_an_instant_is_not_that_instant(smooth_scenario, adaptive):
    jump = smooth_scenario.with_schedule(cart_mass=afl.staircase((0.5 - 5e-7,), (1.37, 1.6)))
    scenario = replace(jump, initial_state=(0.0, 0.1, 2.0, 0.0))
    run = afl.simulate_ode_held(scenario, adaptive, timestep=2e-3, holds=Holds(), substeps=8)
    reference = afl.simulate_ode(scenario, adaptive, sample_period=2e-3)
    at = np.searchsorted(reference.time, run.time - 1e-9)
    np.testing.assert_allclose(run.time, reference.time[at], atol=1e-9)
    np.testing.assert_allclose(run.state, reference.state[at], rtol=0, atol=1e-8)


def test_a_run_that_ends_within_a_step_has_the_force_of_every_instant():
    """M falls to a milligram under a force that is followed: the second step ends beyond limits."""
    lighter = afl.staircase((0.02,), (1.0, 1e-6))
    scenario = afl.Scenario(
        name="lost", schedule={"cart_mass": lighter}, initial_state=(1.0, 0.1, 0.0, 0.0),
        duration=0.1,
    )  # fmt: skip
    own = PythonController(name="own", function=lambda time, state, belief: -1e3 * state[0])
    for controller in (feedback(1e3, 0.0, 0.0, 0.0), own):
        run = afl.simulate_ode_held(scenario, controller, timestep=0.02, holds=Holds(), substeps=1)
        assert str(run.outcome) == "diverged at t = 0.02 s"
        np.testing.assert_allclose(run.force, -1e3 * run.state[:, 0], rtol=1e-12)
        assert len(run.force) == 2


@pytest.mark.parametrize("held", [{"control_period": 0.01}, {"holds": Holds()}])
def test_any_plant_has_the_twin_that_the_cart_pole_has(odd_scenario, held) -> None:
    scenario = replace(odd_scenario, disturbances=odd_scenario.disturbances[:1])
    settings, gains = {"timestep": 5e-3, "substeps": 2, **held}, (1.0, -30.0, 2.0, -8.0)
    expected = afl.simulate_ode_held(scenario, feedback(*np.negative(gains)), **settings)
    own = PythonController(name="own", function=lambda t, x, b: np.dot(gains, x), plant=cart_pole)
    found = afl.simulate_ode_held(replace(scenario, plant=cart_pole), own, **settings)
    np.testing.assert_allclose(found.state, expected.state, rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(found.force, expected.force, rtol=0.0, atol=1e-9)
