import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.simulation.task import controller_policy
from tests.engine import episode
from tests.plants.plants import known

PLANTS = {
    "quadrotor_load.py:plant": {"initial_state": {"x": 0.2, "pitch": 0.1, "cable": 0.1},
        "schedule": {"load": afl.staircase((0.5,), (0.02, 0.3)), "length": 0.6},
        "disturbances": (afl.ForcePulse(force=0.5, start=0.2, duration=0.1, input="left"),)},
    "cart_double_pendulum.py:plant": {"initial_state": {"lower": 0.02},
        "schedule": {"payload": afl.staircase((0.5,), (0.05, 0.1))},
        "disturbances": (afl.Impulse(momentum=0.01, time=0.3333),)},
}  # fmt: skip


ROUGH = afl.Imperfections(delay=0.0025, lag=0.002, noise=1e-4, encoder_step=1e-4, damping=1e-3)


def scenario_of(name: str, **changes: object) -> afl.Scenario:
    return afl.Scenario(name="short", plant=known(name), duration=1.0, **PLANTS[name], **changes)


@pytest.mark.parametrize("name", PLANTS)
def test_the_lqr_as_an_agent_repeats_the_sampled_rollout_bit_for_bit(name):
    scenario = scenario_of(name, imperfections=ROUGH)
    settings = {"timestep": 1e-3, "control_period": 5e-3}
    controller = afl.CONTROLLERS["lqr"]
    reference = afl.simulate_mujoco(scenario, controller, mode="sampled", **settings)
    environment = afl.load(scenario, **settings)
    policy = controller_policy(controller, scenario)
    for _ in range(2):
        np.testing.assert_array_equal(episode(environment, policy)[0], reference.state[::5])
    assert reference.outcome.kind == "completed"


@pytest.mark.parametrize("name", PLANTS)
def test_what_an_episode_shows_is_named_by_the_plant(name):
    scenario = scenario_of(name)
    environment = afl.load(scenario, control_period=0.01, force_limit=50.0)
    step, n = environment.reset(), len(scenario.plant.coordinates)
    assert step.observation["position"].tolist() == [*scenario.initial_state[:n]]
    assert step.observation["velocity"].tolist() == [0.0] * n
    assert step.observation["parameters"].tolist() == scenario.values_at(0.0).tolist()
    spec = environment.action_spec()
    assert spec.shape == (len(scenario.plant.inputs),) and set(spec.maximum) == {50.0}
    while not step.last():
        step = environment.step(np.zeros(spec.shape))
        assert 0.0 < step.reward <= 1.0
    assert step.observation["parameters"].tolist() == scenario.values_at(1.0).tolist()
    assert step.discount == 1.0  # nothing ends a run of this plant


@pytest.mark.parametrize("name", PLANTS)
def test_a_picture_shows_a_plant_without_a_light_or_a_camera(name, graphics):
    picture = afl.load(scenario_of(name)).physics.render(240, 320)
    assert picture.shape == (240, 320, 3) and np.ptp(picture) > 100
