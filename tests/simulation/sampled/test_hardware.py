"""Sensors and actuator against closed forms."""

import math

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.scenario.imperfections import IDEAL, Imperfections
from afl_mujoco.simulation.sampled import hardware

H = 1e-3
T = 4e-3  # control period
ENDS = H * np.arange(1, 101)


@pytest.fixture
def model(odd_parameters):
    return afl.CartPoleModel(odd_parameters)


def measured(model, imperfections, states, period=T):
    scenario = afl.Scenario(name="own", imperfections=imperfections)
    sensors, data = hardware.sensors_of(scenario, period), model.mj_data
    run = hardware.new_run()
    seen = []
    for tick, state in enumerate(states):
        data.qpos[:], data.qvel[:] = state[:2], state[2:]
        hardware.sense(model.addresses, sensors, run, tick)
        seen.append(run.measured.copy())
    return np.array(seen)


def driven(imperfections, commands):
    """The mean force in each step under one command a step, shape (N,), and the drive's sums."""
    scenario = afl.Scenario(name="own", duration=1e3, imperfections=imperfections)
    actuators = hardware.actuators_of(scenario, H, len(commands))
    drive, pending, found = hardware.new_run().drive[0], hardware.no_commands(actuators), []
    for k, command in enumerate(commands):
        command = hardware.within_reach(actuators[0], command)
        found.append(hardware.actuate(actuators[0], drive, pending, 0, command, k, 1.0))
    return np.array(found), drive


def forces(imperfections, commands):
    return driven(imperfections, commands)[0]


@pytest.fixture
def states(random_states):
    return random_states[:50]


def test_sensors_read_the_state_and_noise_is_added_at_the_scale_of_its_channel(model, states):
    assert (measured(model, Imperfections(), states) == states).all()
    scales = np.array([0.01, 0.02, 0.3, 0.4])
    names = ("noise.z", "noise.phi", "noise.z_dot", "noise.phi_dot")
    noisy = IDEAL.changed({**dict(zip(names, scales.tolist(), strict=True)), "seed": 5})
    drawn = np.array([hardware.normals(5, tick) for tick in range(len(states))])
    added = measured(model, noisy, states) - states
    np.testing.assert_allclose(added, scales * drawn, rtol=0, atol=1e-14)


def test_an_encoder_rounds_and_differentiated_velocities_are_its_differences(model, states):
    seen = measured(model, Imperfections(encoder_step={"z": 0.01, "phi": 0.03}), states)
    for column, size in ((0, 0.01), (1, 0.03)):
        counts = seen[:, column] / size
        np.testing.assert_allclose(counts, np.round(counts), rtol=0, atol=1e-9)
        error = np.abs(seen[:, column] - states[:, column])
        assert 0.3 * size < error.max() <= 0.5 * size * (1 + 1e-9)
    assert (seen[:, 2:] == states[:, 2:]).all()
    encoders = {"encoder_step.z": 0.01, "noise.z": 0.002, "encoder_step.phi": 0.03}
    real = IDEAL.changed({**encoders, "noise.z_dot": 9.0, "differentiated": True})
    seen = measured(model, real, states)
    positions = measured(model, IDEAL.changed(encoders), states)[:, :2]
    np.testing.assert_allclose(seen[1:, 2:], np.diff(positions, axis=0) / T, rtol=1e-12)
    assert seen[0, 2:].tolist() == [0.0, 0.0]


@pytest.mark.parametrize("differentiated", [False, True], ids=["measured", "differentiated"])
def test_the_velocity_filter_is_of_first_order(model, differentiated):
    lag, n = 0.013, 40
    velocity = np.array([0.7, -0.5])
    positions = np.array([0.1, 0.2]) + T * np.arange(n)[:, None] * velocity
    states = np.hstack([positions, np.tile(velocity, (n, 1))])
    states[0, 2:] = 0.0  # the step comes at the first tick after the start
    real = Imperfections(velocity_filter=lag, differentiated=differentiated)
    seen = measured(model, real, states)
    rise = 1 - np.exp(-T * np.arange(n) / lag)
    np.testing.assert_allclose(seen[:, 2:], rise[:, None] * velocity, rtol=0, atol=1e-11)
    assert (seen[:, :2] == positions).all()


def delivered(**imperfections):
    return H * np.cumsum(forces(Imperfections(**imperfections), np.full(100, 7.0)))


def test_an_actuator_exerts_the_command_and_a_limit_cuts_off_both_signs():
    commands = np.array([3.0, -700.0, 1e5, -0.1])
    assert (forces(Imperfections(), commands) == commands).all()
    commands, limited = [3.0, -70.0, math.inf, -math.inf, 12.5], Imperfections(input_limit=12.5)
    assert forces(limited, commands).tolist() == [3.0, -12.5, 12.5, -12.5, 12.5]
    assert np.isnan(forces(limited, [math.nan])).all()


@pytest.mark.parametrize("delay", [0.0005, 0.003, 0.0034, 0.1 + 0.2 - 0.29], ids=str)
def test_a_step_arrives_after_the_transport_delay(delay):
    expected = 7.0 * np.maximum(ENDS - delay, 0.0)
    np.testing.assert_allclose(delivered(delay=delay), expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize("lag", [1e-5, 3e-4, 0.004, 0.5], ids=str)
def test_a_step_rises_with_the_lag_of_the_actuator(lag):
    expected = 7.0 * (ENDS + lag * np.expm1(-ENDS / lag))
    np.testing.assert_allclose(delivered(lag=lag), expected, rtol=1e-11)


def test_the_slew_rate_limits_every_change_and_a_limited_force_comes_back_at_once():
    commands = np.array([5.0] * 10 + [-5.0] * 30)
    force = forces(Imperfections(slew_rate=1000.0), commands)
    np.testing.assert_allclose(force[:6], [0.5, 1.5, 2.5, 3.5, 4.5, 5.0])  # means of a ramp
    np.testing.assert_allclose(np.diff(force[10:20]), -1.0)  # 1000 N/s for 1 ms
    assert force[9] == 5.0 and force[-1] == -5.0
    commands = np.array([100.0] * 20 + [-100.0] * 4)
    real = Imperfections(slew_rate=1000.0, input_limit=10.0)
    assert forces(real, commands)[19:].tolist() == [10.0, 9.5, 8.5, 7.5, 6.5]


CHAINS = {
    "fractional delay and lag": Imperfections(delay=0.0035, lag=0.004),
    "slew and lag": Imperfections(slew_rate=5000.0, lag=0.002),
    "everything": Imperfections(delay=0.0035, slew_rate=5000.0, lag=0.004, input_limit=8.0),
}  # fmt: skip


def fine_chain(real, commands, fine):
    """The force in `fine` parts of every step, by a simulation with that many steps."""
    limit = math.inf if real.input_limit is None else real.input_limit
    slew = math.inf if real.slew_rate is None else real.slew_rate * H / fine
    held = np.repeat(np.clip(commands, -limit, limit), fine)
    late = np.concatenate([np.zeros(round(real.delay / H * fine)), held])[: len(held)]
    demand = force = 0.0
    found = np.empty(len(held))
    for i, wanted in enumerate(late):
        demand += min(max(wanted - demand, -slew), slew)
        found[i] = force = force + (demand - force) * -math.expm1(-H / fine / real.lag)
    return found


@pytest.mark.parametrize("name", CHAINS)
def test_mean_peak_square_and_variation_are_those_of_a_fine_simulation_of_the_chain(name, rng):
    commands, real = 6.0 * rng.normal(size=40), CHAINS[name]
    fine, (means, drive) = fine_chain(real, commands, 2000), driven(real, commands)
    np.testing.assert_allclose(means, fine.reshape(40, 2000).mean(axis=1), rtol=0, atol=5e-3)
    assert drive["max_force"] == pytest.approx(np.abs(fine).max(), rel=1e-3)
    assert drive["force_squared"] == pytest.approx((fine**2).mean() * 40, rel=2e-3)
    variation = np.abs(np.diff(fine, prepend=0.0)).sum()
    assert drive["force_variation"] == pytest.approx(variation, rel=3e-3)
