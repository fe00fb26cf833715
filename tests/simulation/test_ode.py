from dataclasses import replace

import numpy as np
import pytest

import afl_mujoco as afl


@pytest.mark.parametrize("name", ["fixed", "adaptive", "fixed-nominal"])
def test_upright_at_rest_at_the_origin_stays(name, odd_scenario):
    still = replace(odd_scenario, initial_state=(0, 0, 0, 0), disturbances=())
    run = afl.simulate_ode(still, afl.CONTROLLERS[name])
    assert not run.state.any() and not run.force.any()


def test_the_run_carries_schedules_and_force_on_its_grid(odd_scenario, adaptive):
    run = afl.simulate_ode(odd_scenario, adaptive, sample_period=0.01)
    for name in ("cart_mass", "half_length"):
        expected = getattr(odd_scenario, name)(run.time)
        np.testing.assert_allclose(getattr(run, name), expected, rtol=1e-12)
    for k in (0, 17, len(run.time) - 1):
        truth = odd_scenario.parameters_at(float(run.time[k]))
        assert run.force[k] == pytest.approx(adaptive.force(run.state[k], truth), rel=1e-14)
