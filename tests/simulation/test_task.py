import copy
import math
import pickle
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from absl.testing import absltest
from dm_env import test_utils

import afl_mujoco as afl
from afl_mujoco.control.own import PythonController
from afl_mujoco.errors import InvalidValueError, UnknownNameError
from afl_mujoco.plants.cartpole import FALL_ANGLE
from afl_mujoco.simulation.task import Reward, controller_policy, reward
from tests.engine import episode
from tests.plants.plants import known

CALM = replace(afl.SCENARIOS["nominal"], duration=1.0)
TIMESTEP = 1e-3


def _short(name: str, duration: float, **changes) -> afl.Scenario:
    return replace(afl.SCENARIOS[name], **({"disturbances": ()} | changes), duration=duration)


CASES = {
    "jumps": _short("step-step", 1.2), "ramps": _short("trapezoid-trapezoid", 2.2),
    "pulse and impulses": _short("step-step", 1.4, disturbances=(
        afl.ForcePulse(force=-10.0, start=0.5, duration=0.1),
        # at the start, together with a jump of M and l, between two instants
        *(afl.Impulse(momentum=m, time=t) for m, t in ((0.4, 0.0), (-1.0, 1.0), (0.3, 1.2345))),
    )),
    "off-grid breakpoints": _short("nominal", 1.2).with_schedule(
        cart_mass=afl.staircase((0.3337,), (1.0, 2.0)),
        half_length=afl.piecewise_linear((0.1003, 0.9999), (0.5, 0.2)), pole_mass=0.07, gravity=3.7,
    ),
}  # fmt: skip


PLANTS = {
    "quadrotor_load.py:plant": {"initial_state": {"x": 0.2, "pitch": 0.1, "cable": 0.1},
        "schedule": {"load": afl.staircase((0.5,), (0.02, 0.3)), "length": 0.6},
        "disturbances": (afl.ForcePulse(force=0.5, start=0.2, duration=0.1, input="left"),)},
    "cart_double_pendulum.py:plant": {"initial_state": {"lower": 0.02},
        "schedule": {"payload": afl.staircase((0.5,), (0.05, 0.1))},
        "disturbances": (afl.Impulse(momentum=0.01, time=0.3333),)},
}  # fmt: skip


def of_plant(name: str, **changes: object) -> afl.Scenario:
    return afl.Scenario(name="short", plant=known(name), duration=1.0, **PLANTS[name], **changes)


ROUGH = afl.Imperfections(
    delay=0.0035, lag=0.004, slew_rate=2e3, input_limit=60.0, encoder_step={"phi": 1e-3},
    noise={"phi": 1e-3, "z": 5e-4}, differentiated=True, velocity_filter=0.01,
    damping={"z": 1.0, "phi": 1e-3}, dry_friction={"z": 0.5}, tip_mass_share=0.1,
    parameter_delay=0.03, end_stops={"z": 3.0}, seed=5,
)  # fmt: skip
AT_100_HZ = _short("step-step", 0.3, imperfections=afl.Imperfections(control_period=0.01))
LESS = afl.Imperfections(delay=0.0025, lag=0.002, noise=1e-4, encoder_step=1e-4, damping=1e-3)
LEANS = _short("step-step", 1.2, initial_state=(0.0, 0.3, 0.0, 0.0), imperfections=ROUGH)


@pytest.mark.parametrize(("scenario", "name", "hold"), [
    (LEANS, "adaptive", 10), (LEANS, "lqr", 1),
    *((of_plant(plant, imperfections=LESS), "lqr", 5) for plant in PLANTS),
])  # fmt: skip
def test_with_imperfections_it_is_the_sampled_rollout_too(scenario, name, hold):
    settings = {"timestep": TIMESTEP, "control_period": hold * TIMESTEP}
    controller = afl.CONTROLLERS[name]
    reference = afl.simulate_mujoco(scenario, controller, mode="sampled", **settings)
    environment = afl.load(scenario, **settings)
    policy = controller_policy(controller, scenario)
    assert reference.outcome.kind == "completed"
    for _ in range(2):  # nothing is left of the first episode in the second
        states, step = episode(environment, policy)
        np.testing.assert_array_equal(states, reference.state[::hold])
        assert len(states) > 100 and np.nanmax(np.abs(reference.force)) > 1.0
    assert step.observation["position"].tolist() != states[-1][: len(scenario.target)].tolist()


@pytest.mark.parametrize("name", PLANTS)
def test_what_an_episode_shows_is_named_by_the_plant(name):
    scenario = of_plant(name)
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


def test_the_parameters_that_are_observed_are_those_a_controller_is_told():
    scenario = replace(_short("step-step", 1.0), belief={"cart_mass": {"error": 0.5}})
    told = afl.load(scenario).reset().observation["parameters"]
    assert told.tolist() == pytest.approx([0.75, 0.2])


@pytest.mark.parametrize(("name", "hold", "by"), [("fixed", 1, "RK4"), ("adaptive", 10, "Euler")])
@pytest.mark.parametrize("case", CASES)
def test_an_agent_repeats_the_sampled_rollout_bit_for_bit(case, name, hold, by):
    scenario, controller = CASES[case], afl.CONTROLLERS[name]
    settings = {"timestep": TIMESTEP, "control_period": hold * TIMESTEP, "integrator": by}
    reference = afl.simulate_mujoco(scenario, controller, mode="sampled", **settings)
    states, _ = episode(afl.load(scenario, **settings), controller_policy(controller, scenario))
    np.testing.assert_array_equal(states, reference.state[::hold])
    assert reference.outcome.kind == "completed"


def test_a_controller_in_python_gets_the_time():
    controller = PythonController(name="clock", function=lambda t, x, p: 5.0 * np.sin(20.0 * t))
    scenario = _short("step-step", 0.3, initial_state=(0.0, 0.1, 0.0, 0.0))
    settings = {"timestep": TIMESTEP, "control_period": 10 * TIMESTEP}
    reference = afl.simulate_mujoco(scenario, controller, mode="sampled", **settings)
    environment = afl.load(scenario, **settings)
    policy = controller_policy(controller, scenario, control_period=10 * TIMESTEP)
    for _ in range(2):  # the second episode begins at 0 again
        np.testing.assert_array_equal(episode(environment, policy)[0], reference.state[::10])
    with pytest.raises(InvalidValueError, match=r"^control_period must be given for 'clock'$"):
        controller_policy(controller, scenario)


def test_what_would_tear_model_and_scenario_apart_is_refused():
    physics = afl.load(CASES["ramps"]).physics
    for duplicate in (lambda x: x.copy(), copy.deepcopy, pickle.dumps):
        with pytest.raises(InvalidValueError, match=r"^Physics cannot be copied"):
            duplicate(physics)
    with pytest.raises(InvalidValueError, match=r"^model cannot be replaced"):
        physics.reload_from_xml_string("<mujoco/>")


def played(environment, force):
    step, count = environment.reset(), 0
    while not step.last():
        step, count = environment.step([force]), count + 1
    return step, count


def test_an_episode_ends_where_the_pole_falls_or_the_state_diverges_with_discount_zero():
    environment = afl.load(control_period=0.01)
    step, _ = played(environment, 0.0)
    assert abs(step.observation["position"][1]) >= FALL_ANGLE and step.discount == 0.0
    assert environment.physics.time() < 1.0 and environment.step([0.0]).first()
    light = _short("nominal", 1.0).with_schedule(cart_mass=1e-3, pole_mass=1e-5)
    environment = afl.load(light, force_limit=9e5, control_period=0.1)
    step, _ = played(environment, 9e5)
    assert environment.physics.diverged() and (step.reward, step.discount) == (0.0, 0.0)
    before = environment.physics.get_state()
    environment.physics.step()
    np.testing.assert_array_equal(environment.physics.get_state(), before)


@pytest.mark.parametrize("period", [0.001, 0.007, 0.3])
def test_an_episode_ends_at_the_duration_whose_last_period_may_be_shorter(period):
    scenario = _short("nominal", 0.3, initial_state=(0, 0, 0, 0))
    environment = afl.load(scenario, control_period=period)
    step, count = played(environment, 0.0)
    assert count == math.ceil(round(0.3 / period, 9)) and step.discount == 1.0
    assert environment.physics.time() == pytest.approx(0.3, abs=1e-12)


@pytest.mark.parametrize("duration", [0.486, 0.4864])
def test_a_pole_that_falls_past_the_duration_has_not_fallen(duration):
    scenario = _short("nominal", duration, initial_state=(0.0, 0.5, 0.0, 0.0))
    run = afl.simulate_mujoco(scenario, lambda *_: 0.0, mode="sampled", control_period=0.1)
    step, _ = played(environment := afl.load(scenario, control_period=0.1), 0.0)
    np.testing.assert_array_equal(environment.physics.world.state, run.state[-1])
    assert step.discount == 1.0


@pytest.mark.parametrize("disturbances", [
    (afl.ForcePulse(force=100.0, start=0.1, duration=0.005),),
    (afl.Impulse(momentum=0.3, time=0.103),), (),
], ids=["a pulse", "an impulse", "after the end"])  # fmt: skip
def test_the_last_step_is_as_short_as_that_of_the_run(disturbances) -> None:
    knots = ([0.0, 0.1, 0.107, 0.107], [1.0, 1.2, 1.4, 30.0])
    scenario = replace(
        CALM.with_schedule(cart_mass=afl.piecewise_linear(*knots)), duration=0.105,
        disturbances=disturbances, imperfections=afl.Imperfections(differentiated=True),
    )  # fmt: skip
    run = afl.simulate_mujoco(scenario, lambda *_: 2.0, timestep=0.01, control_period=0.02)
    environment = afl.load(scenario, timestep=0.01, control_period=0.02)
    step, _ = played(environment, 2.0)
    world = environment.physics.world
    np.testing.assert_array_equal(world.state, run.state[-1])
    assert world.time(environment.physics.instant) == 0.105
    assert step.observation["parameters"][0] == scenario.cart_mass.at(0.105)
    gone = (run.state[-1, :2] - run.state[10, :2]) / 0.005  # since the last tick, at 0.1 s
    np.testing.assert_allclose(step.observation["velocity"], gone, rtol=1e-9)


def test_actions_are_clipped_to_the_spec_and_the_papers_runs_stay_inside_it():
    environment = afl.load(force_limit=5.0)
    environment.reset()
    environment.step([7.0])
    assert environment.physics.control().tolist() == [5.0]
    spec = afl.load().action_spec()
    assert np.abs(afl.simulate_mujoco("nominal", "adaptive").force).max() < 0.1 * spec.maximum
    assert (spec.shape, spec.dtype) == ((1,), np.float64)
    for action in ([math.nan], [1.0, 2.0]):
        with pytest.raises(InvalidValueError, match=r"^action must"):
            environment.step(action)


def test_the_reward_is_within_0_and_1_and_best_at_rest_upright_where_a_pole_comes_round():
    free = replace(CALM, requirements=afl.Requirements(ends_at={}, target={"z": 1.0}))
    states = np.array([[1.0, 0.01 + turn, 0.0, 0.0] for turn in (0.0, 2 * np.pi, -2 * np.pi)])
    found = Reward(free).of(states, np.zeros((3, 1)))
    np.testing.assert_allclose(found, reward(0.0, 0.01, 0.0), rtol=1e-12)
    values = reward(*np.meshgrid(*(np.linspace(-most, most, 41) for most in (10, 2, 1e3))))
    assert values.min() > 0.0 and values.max() == reward(0.0, 0.0, 0.0) == 1.0
    assert np.unravel_index(values.argmax(), values.shape) == (20, 20, 20)
    found = [reward(*x) for x in ((0.0, math.pi / 3, 0.0), (2.0, 0.0, 0.0), (0.0, 0.0, 100.0))]
    assert found == pytest.approx([0.1, 0.55, 0.82])


@pytest.mark.parametrize(("settings", "message"), [
    ({"scenario": "nowhere"}, "scenario must be one of nominal"),
    ({"timestep": 3e-3, "control_period": 0.01}, "timestep 0.003 s must divide control_period"),
    ({"timestep": 7e-4, "scenario": AT_100_HZ}, "timestep 0.0007 s must divide"),
    ({"timestep": "a"}, "timestep must be a number, got 'a'"),
    ({"force_limit": 1e7}, "force_limit must be below 1e.06 N"),
    ({"random": 1.5}, "random must be a whole number, got 1.5"),
    ({"control_period": 0.002, "scenario": AT_100_HZ}, "control_period must be that of"),
], ids=str)  # fmt: skip
def test_a_setting_that_breaks_its_rule_is_named_in_one_line(settings, message):
    with pytest.raises((InvalidValueError, UnknownNameError), match=rf"^{message}.*\Z"):
        afl.load(**settings)


class TestContract(test_utils.EnvironmentTestMixin, absltest.TestCase):
    def make_object_under_test(self):
        return afl.load("step-step-impulse", control_period=0.02)

    def make_action_sequence(self):
        for _ in range(100):
            yield self.make_action()


def run_without(package, *lines):
    text = "\n".join([f"import sys; sys.modules['{package}'] = None", "import afl_mujoco", *lines])
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.mark.slow
def test_without_dm_control_or_gymnasium_one_line_says_what_installs_it() -> None:
    says = "except afl_mujoco.AflMujocoError as error: print(error)"
    said = run_without("dm_control", "try: afl_mujoco.load", says, "print(afl_mujoco.compare)")
    assert "dm_control" in said[0] and "pip install --no-deps 'dm-control>=1.0.50,<1.1'" in said[0]
    assert len(said) == 2
    package = "afl_mujoco.simulation.gym_env"
    lines = ("try: register()", says, f"try: import {package}.environment", says)
    said = run_without("gymnasium", f"from {package}.registration import register", *lines)
    assert said == ["Gymnasium is not installed: pip install gymnasium"] * 2


def _pole_pixels(picture: np.ndarray) -> np.ndarray:
    red, _, blue = picture.astype(int).transpose(2, 0, 1)
    return np.argwhere(red - blue > 60)  # cart, track and sky are bluish or grey


def test_the_side_camera_shows_the_whole_pole_wherever_the_cart_is(graphics):
    extents = []
    for z in (0.0, 7.0):
        leaning = replace(CALM, initial_state=(z, -math.pi / 3, 0.0, 0.0))
        physics = afl.load(leaning.with_schedule(half_length=1.0)).physics
        seen = _pole_pixels(physics.render(240, 320, camera_id="side"))
        assert seen.min() > 0 and (seen.max(axis=0) < (239, 319)).all()
        extents.append(np.ptp(seen, axis=0))
    assert np.abs(extents[0] - extents[1]).max() <= 1  # the camera follows; edges round to a pixel


def test_pictures_show_the_length_of_their_instant(graphics):
    growing = CALM.with_schedule(half_length=afl.staircase((0.5,), (0.3, 0.9)))
    environment = afl.load(replace(growing, initial_state=(0, 0, 0, 0)), control_period=0.25)
    environment.reset()
    heights = []
    for _ in range(3):
        picture = environment.physics.render(240, 320, camera_id="side")
        heights.append(np.ptp(_pole_pixels(picture)[:, 0]))
        environment.step([0.0])
    assert heights[1] == heights[0] and heights[2] > 2.0 * heights[0]


@pytest.mark.parametrize("name", PLANTS)
def test_a_picture_shows_a_plant_without_a_light_or_a_camera(name, graphics):
    picture = afl.load(of_plant(name)).physics.render(240, 320)
    assert picture.shape == (240, 320, 3) and np.ptp(picture) > 100
