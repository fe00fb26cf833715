"""The analytic reference: two methods agree, equilibria stay, falls are recorded."""

from dataclasses import replace

import numpy as np
import pytest

import afl_mujoco as afl


@pytest.mark.parametrize("name", ["fixed", "adaptive", "fixed-nominal"])
def test_upright_at_rest_at_the_origin_stays(name, odd_scenario):
    still = replace(odd_scenario, initial_state=(0, 0, 0, 0), disturbances=())
    run = afl.simulate_ode(still, afl.CONTROLLERS[name])
    assert not run.state.any()
    assert not run.force.any()


def test_the_run_carries_schedules_and_force_on_its_grid(odd_scenario, adaptive):
    run = afl.simulate_ode(odd_scenario, adaptive, sample_period=0.01)
    for name in ("cart_mass", "half_length"):
        expected = getattr(odd_scenario, name)(run.time)
        np.testing.assert_allclose(getattr(run, name), expected, rtol=1e-12)
    for k in (0, 17, len(run.time) - 1):
        truth = odd_scenario.parameters_at(float(run.time[k]))
        assert run.force[k] == pytest.approx(adaptive.force(run.state[k], truth), rel=1e-14)


def test_momentum_gained_is_the_impulse_of_the_force(smooth_scenario, adaptive):
    run = afl.simulate_ode(smooth_scenario, adaptive, sample_period=1e-3)
    # Simpson's rule over 800 intervals of 1 ms: (rate * h)^4 is below 1e-6
    h, f = 1e-3, run.force
    gained = h / 3 * (f[0] + f[-1] + 4 * f[1:-1:2].sum() + 2 * f[2:-1:2].sum())
    momentum = afl.linear_momentum(run.state, smooth_scenario.parameters_at(0.0))
    assert momentum[-1] - momentum[0] == pytest.approx(gained, abs=1e-6)
