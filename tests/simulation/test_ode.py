"""The analytic reference: two methods agree, equilibria stay, falls are recorded."""

from dataclasses import replace

import numpy as np
import pytest

from afl_mujoco import CONTROLLERS, Scenario, constant, simulate_ode
from afl_mujoco.errors import AflMujocoError, InvalidValueError, UnknownNameError
from afl_mujoco.plant.energy import linear_momentum

TIPPING = Scenario(
    name="tipping",
    schedule={"cart_mass": constant(20.0), "half_length": constant(0.05), "pole_mass": 3.0},
    duration=2.0,
)
"""So far from nominal that a controller that assumes the nominal plant lets the pole fall."""


def test_two_methods_agree(odd_scenario, controller):
    explicit = simulate_ode(odd_scenario, controller, sample_period=0.02)
    implicit = simulate_ode(
        odd_scenario, controller, sample_period=0.02, method="Radau", rtol=1e-11, atol=1e-13
    )
    np.testing.assert_array_equal(explicit.time, implicit.time)
    np.testing.assert_allclose(implicit.state, explicit.state, rtol=0, atol=1e-9)  # Radau's rtol


@pytest.mark.parametrize("name", ["fixed", "adaptive", "fixed-nominal"])
def test_upright_at_rest_at_the_origin_stays(name, odd_scenario):
    still = replace(odd_scenario, initial_state=(0, 0, 0, 0), disturbances=())
    run = simulate_ode(still, CONTROLLERS[name])
    assert not run.state.any()
    assert not run.force.any()


def test_the_run_carries_schedules_and_force_on_its_grid(odd_scenario, adaptive):
    run = simulate_ode(odd_scenario, adaptive, sample_period=0.01)
    for name in ("cart_mass", "half_length"):
        expected = getattr(odd_scenario, name)(run.time)
        np.testing.assert_allclose(getattr(run, name), expected, rtol=1e-12)
    for k in (0, 17, len(run.time) - 1):
        truth = odd_scenario.parameters_at(float(run.time[k]))
        assert run.force[k] == pytest.approx(adaptive.force(run.state[k], truth), rel=1e-14)


def test_momentum_gained_is_the_impulse_of_the_force(smooth_scenario, adaptive):
    run = simulate_ode(smooth_scenario, adaptive, sample_period=1e-3)
    # Simpson's rule over 800 intervals of 1 ms: (rate * h)^4 is below 1e-6
    h, f = 1e-3, run.force
    gained = h / 3 * (f[0] + f[-1] + 4 * f[1:-1:2].sum() + 2 * f[2:-1:2].sum())
    momentum = linear_momentum(run.state, smooth_scenario.parameters_at(0.0))
    assert momentum[-1] - momentum[0] == pytest.approx(gained, abs=1e-6)


def test_a_fall_is_recorded_and_no_nan_travels():
    run = simulate_ode(TIPPING, CONTROLLERS["fixed-nominal"])
    assert str(run.outcome).startswith("fell at t = 0.126")
    assert run.time[-1] <= run.outcome.time < run.time[-1] + 1e-3
    assert np.isfinite(run.state).all()
    assert np.isfinite(run.force).all()


def test_a_run_that_starts_fallen_holds_its_first_instant(smooth_scenario, adaptive):
    run = simulate_ode(replace(smooth_scenario, initial_state=(0, 1.6, 0, 0)), adaptive)
    assert str(run.outcome) == "fell at t = 0 s"
    assert run.time.tolist() == [0.0]


def test_bad_settings_are_refused(smooth_scenario, adaptive):
    with pytest.raises(
        UnknownNameError, match=r"^method must be one of DOP853, Radau, RK45, LSODA"
    ):
        simulate_ode(smooth_scenario, adaptive, method="Euler")
    with pytest.raises(InvalidValueError, match=r"^timestep must be within 0.8 s, got 1.0$"):
        simulate_ode(smooth_scenario, adaptive, sample_period=1.0)
    with pytest.raises(AflMujocoError, match=r"^rtol must be"):
        simulate_ode(smooth_scenario, adaptive, rtol=-1.0)
