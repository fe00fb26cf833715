"""The scenarios as Gymnasium environments: the dm_control environment, by another contract."""

import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.utils.seeding import np_random
from gymnasium.vector import SyncVectorEnv

import afl_mujoco as afl
from afl_mujoco.errors import InvalidValueError, UnknownNameError
from afl_mujoco.scenario.catalogue import LABORATORY
from afl_mujoco.scenario.imperfections import Imperfections
from afl_mujoco.scenario.sample_space import SampleSpace, sample_scenario
from afl_mujoco.simulation.gym_env import environment as module
from afl_mujoco.simulation.gym_env import registration
from afl_mujoco.simulation.gym_env.environment import CartPoleEnv, ScenarioEnv, policy_controller
from afl_mujoco.simulation.gym_env.vector import CartPoleVectorEnv, ScenarioVectorEnv
from afl_mujoco.simulation.task import controller_policy
from tests.plants.plants import EXAMPLES, cart, known

CONTROL_PERIOD, FORCE_LIMIT = module.CONTROL_PERIOD, module.FORCE_LIMIT
IDS = [f"afl_mujoco/CartPole-{x}{y}-v0" for x in afl.SCENARIOS for y in ("", "-Random")]
IDS.append("afl_mujoco/CartPole-Random-v0")
SI, VECTORISED = {"scaled": False}, {"vectorization_mode": "vector_entry_point"}
PUSH = afl.ForcePulse(force=-10.0, start=1.5, duration=0.1)
LIGHT = afl.SCENARIOS["nominal"].with_schedule(cart_mass=1e-3, pole_mass=1e-5)
DIVERGES = {"scenario": replace(LIGHT, duration=1.0), "force_limit": 9e5, "control_period": 0.1}
COUNT = "print(sum(name.startswith('afl_mujoco/') for name in gymnasium.registry))"


def program(*lines: str) -> tuple[str, str]:
    command = [sys.executable, "-W", "error", "-c", "\n".join(lines)]
    run = subprocess.run(command, cwd=EXAMPLES.parent, capture_output=True, text=True)
    return run.stdout, run.stderr


def drawn(name: str, **varied: tuple[float, float]) -> afl.Scenario:
    rough = Imperfections(delay=0.0045, lag=0.002, noise=1e-3, dry_friction=1e-3, input_limit=30.0)
    asked = afl.Requirements(ends_at={known(name).coordinates[1]: 0.4})
    what = {"imperfections": rough, "requirements": asked, "ranges": varied}
    return afl.Scenario(name="drawn", plant=known(name), duration=1.0, **what)


QUADROTOR = drawn("quadrotor_load.py:plant", x=(-0.2, 0.2), load=(0.02, 0.5))
PENDULUM = drawn("cart_double_pendulum.py:plant", payload=(0.02, 0.2))
PLANTS = {"quadrotor": {"scenario": QUADROTOR, "randomize": True},
          "pendulum": {"scenario": PENDULUM, "randomize": True}}  # fmt: skip


@pytest.mark.parametrize(("name", "settings"), [
    (IDS[0], {}), (IDS[-1], {}), *(("afl_mujoco/Scenario-v0", one) for one in PLANTS.values()),
])  # fmt: skip
def test_gymnasium_s_checker_finds_nothing_to_warn_of(name: str, settings) -> None:
    check_env(gymnasium.make(name, **settings).unwrapped, skip_render_check=True)


def test_gymnasium_s_checker_accepts_the_pictures(graphics: None) -> None:
    environment = gymnasium.make(IDS[0], render_mode="rgb_array", width=120, height=80)
    check_env(environment.unwrapped)
    environment.reset()
    assert environment.render().shape == (80, 120, 3)
    assert environment.unwrapped.metadata["render_fps"] == pytest.approx(1.0 / CONTROL_PERIOD)
    environment.close()


def test_the_scenarios_of_the_paper_are_registered_as_they_are_and_at_random() -> None:
    registration.register()  # once more does nothing
    names = sorted(name for name in gymnasium.registry if name.startswith("afl_mujoco/"))
    assert names == sorted([*IDS, "afl_mujoco/Scenario-v0"]) and len(names) == 20
    for name in IDS:
        scenario = gymnasium.spec(name).kwargs["scenario"]
        environment = gymnasium.make(name).unwrapped
        assert environment.scenario.name == scenario
        environment.reset(seed=1)
        assert environment.scenario.name.startswith(f"{scenario}-0-") == name.endswith("-Random-v0")


@pytest.mark.slow
def test_importing_the_package_registers_whatever_is_imported_first() -> None:
    """And that loads neither MuJoCo nor Numba."""
    loaded = program("import afl_mujoco, gymnasium, sys", "print(*sys.modules)")[0].split()
    assert "afl_mujoco.scenario.catalogue" in loaded
    assert {"mujoco", "numba", "dm_control"}.isdisjoint(loaded)
    assert program("import gymnasium, afl_mujoco", COUNT) == ("20\n", "")
    asked = "import afl_mujoco, importlib.util; importlib.util.find_spec('gymnasium')"
    assert program(asked, "import gymnasium", COUNT) == ("20\n", "")


def test_an_episode_has_the_bits_of_the_dm_control_environment(rng) -> None:
    scenario = replace(afl.SCENARIOS["trapezoid-trapezoid"], disturbances=(PUSH,))
    environment = CartPoleEnv(scenario, control_period=0.01, **SI)
    twin = afl.load(scenario, control_period=0.01, force_limit=FORCE_LIMIT)
    (seen, _), step = environment.reset(), twin.reset()
    rewards = []
    policy = controller_policy(afl.CONTROLLERS["lqr"], scenario)
    for _ in range(400):
        np.testing.assert_array_equal(seen, np.concatenate(list(step.observation.values())))
        action = policy(step) / FORCE_LIMIT + rng.uniform(-0.05, 0.05, 1)
        seen, reward, terminated, truncated, info = environment.step(action)
        step = twin.step(np.clip(action, -1.0, 1.0) * FORCE_LIMIT)
        assert (reward, terminated, truncated) == (step.reward, False, False)
        assert info == {"time": twin.physics.time(), "force": twin.physics.control()[0]}
        rewards.append(reward)
    assert max(rewards) > 0.9  # the pole came up: there was something to compare


def test_a_fall_terminates_also_at_the_horizon_which_else_truncates() -> None:
    def ends(**changes):
        environment, found = CartPoleEnv(replace(afl.SCENARIOS["nominal"], **changes)), []
        environment.reset()
        while not found or not any(found[-1]):
            _, _, *ended, info = environment.step(np.zeros(1))
            found.append(tuple(ended))
        return found, round(info["time"], 3)

    fell, until = ends()
    assert fell[-1] == (True, False) and until < 1.0
    assert ends(duration=until)[0][-2:] == [(False, False), (True, False)]
    calm, _ = ends(initial_state=(0, 0, 0, 0), duration=0.5)
    assert calm == [(False, False)] * 24 + [(False, True)]


def test_no_step_is_taken_before_a_reset_after_the_end_or_by_what_is_no_number() -> None:
    environment = CartPoleEnv()
    for _ in range(2):
        with pytest.raises(gymnasium.error.ResetNeeded):
            environment.step([0.0])
        environment.reset()
        assert environment.render() is None  # without a mode there is no picture
        assert environment.step([7.0])[4]["force"] == FORCE_LIMIT  # as an action of 1
        for strange in (math.nan, math.inf):
            with pytest.raises(InvalidValueError, match=r"^action must be finite, got \["):
                environment.step([strange])
        while not environment.step([0.0])[2]:
            pass
    environment.close()
    with pytest.raises(gymnasium.error.ClosedEnvironmentError, match=r"^a closed environment"):
        environment.reset()


@pytest.mark.parametrize(("settings", "options", "message"), [
    ({"control_period": 0.0}, None, "control_period must be positive"),
    ({"camera": "sid"}, None, "camera must be one of side, fixed, got 'sid'; did you mean side"),
    ({"camera": 9}, None, "camera must be at most 1, got 9"),
    ({"width": 5000}, None, "width must be at most 1920, got 5000"),
    ({}, {"initial_state": (0, 0, 0, 0)}, "options of reset must be empty, got initial_state"),
], ids=str)  # fmt: skip
def test_a_setting_that_breaks_its_rule_is_named_in_one_line(settings, options, message) -> None:
    with pytest.raises((InvalidValueError, UnknownNameError), match=rf"^{message}.*\Z"):
        CartPoleEnv(**settings).reset(options=options)


def test_scaled_observations_are_shares_of_powers_of_two() -> None:
    plain, scaled = CartPoleEnv(**SI), CartPoleEnv()
    assert scaled.scale.tolist() == [4.0, 2.0, 8.0, 8.0, 1.0, 0.5]
    (one, _), (other, _) = plain.reset(), scaled.reset()
    for _ in range(10):
        np.testing.assert_array_equal(one, other * scaled.scale)
        assert other in scaled.observation_space
        (one, *_), (other, *_) = plain.step([0.05]), scaled.step([0.05])
    heavy = afl.SCENARIOS["nominal"].with_schedule(cart_mass=9.0)
    assert CartPoleEnv(heavy).scale.tolist() == [4.0, 2.0, 8.0, 8.0, 16.0, 0.5]


def test_every_episode_of_a_random_environment_is_another_one_and_a_seed_repeats_them() -> None:
    environment = gymnasium.make("afl_mujoco/CartPole-Random-v0")
    first, again = ([environment.reset(seed=seed) for seed in (9, None, None)] for _ in range(2))
    assert repr(first) == repr(again)
    assert len({info["sample"] for _, info in first}) == 3
    scenario = environment.unwrapped.scenario
    assert scenario.name == first[-1][1]["sample"]
    index = int(scenario.name.split("-")[-1])
    assert scenario == sample_scenario(SampleSpace(LABORATORY), index, 0)
    assert scenario.imperfections.at("dry_friction.z") > 0.0
    seen, _ = gymnasium.make("afl_mujoco/CartPole-step-step-Random-v0", scaled=False).reset(seed=1)
    task_seed = int(np_random(1)[0].integers(2**32))
    twin = afl.load("step-step", randomize=True, random=task_seed, control_period=CONTROL_PERIOD)
    np.testing.assert_array_equal(seen[:2], twin.reset().observation["position"])


SHORT = replace(
    afl.SCENARIOS["trapezoid-step"], duration=0.3,
    disturbances=(afl.Impulse(momentum=0.2, time=0.0),),
    imperfections=Imperfections(delay=0.0345, differentiated=True, end_stops={"z": 0.2}),
)  # fmt: skip
VECTORS = {"random": {"scenario": "laboratory", "randomize": True}, "diverges": DIVERGES,
           "short": {"scenario": SHORT, "integrator": "Euler"}, **PLANTS}  # fmt: skip


def same_step(one, other) -> None:
    mine, their = ({**dict(enumerate(x[:-1])), **x[-1]} for x in (one, other))
    assert mine.keys() == their.keys()
    for name, values in their.items():
        np.testing.assert_array_equal(mine[name], values)
        assert mine[name].dtype == values.dtype


def stepped(ours, theirs, count: int, actions) -> int:
    other, ends = theirs.reset(seed=2), 0
    every = [one.reset(seed=2) for one in ours]
    for _ in range(count):
        for one in every:
            same_step(one, other)
        ends += int(np.sum(other[2:4])) if len(other) > 2 else 0
        chosen = actions()
        other = theirs.step(chosen)
        assert other[0] in theirs.observation_space
        every = [one.step(chosen) for one in ours]
    for one in ours:
        one.close()
    return ends


@pytest.mark.parametrize("settings", VECTORS.values(), ids=VECTORS)
def test_the_vector_environment_has_the_bits_of_gymnasium_s(settings, rng) -> None:
    ours = [ScenarioVectorEnv(5, threads=threads, **settings) for threads in (1, 3)]
    theirs = SyncVectorEnv([lambda: ScenarioEnv(**settings)] * 5)
    assert ours[0].observation_space == theirs.observation_space
    assert ours[0].action_space == theirs.action_space
    shape = theirs.action_space.shape
    assert stepped(ours, theirs, 80, lambda: rng.uniform(-1.2, 1.2, shape)) > 3


def test_the_vector_environment_is_what_gymnasium_makes_and_refuses_what_makes_no_sense() -> None:
    made = gymnasium.make_vec("afl_mujoco/CartPole-Random-v0", num_envs=3, **VECTORISED)
    assert isinstance(made.unwrapped, CartPoleVectorEnv)
    other = gymnasium.make_vec("afl_mujoco/Scenario-v0", **VECTORISED, **PLANTS["pendulum"])
    assert isinstance(other.unwrapped, ScenarioVectorEnv)
    with pytest.raises(gymnasium.error.ResetNeeded):
        made.step(np.zeros((3, 1)))
    seen, _ = made.reset(seed=[1, 2, 1])
    np.testing.assert_array_equal(seen[0], seen[2])
    for refused, message in (
        (lambda: made.step(np.full((3, 1), math.nan)), "actions must be finite"),
        (lambda: made.step(np.zeros(3)), r"actions must have shape \(3, 1\), got \(3,\)"),
        (lambda: made.reset(seed=[1, 2]), "seed must be one number or 3 of them, got 2"),
        (lambda: CartPoleEnv(scaled="no"), "scaled must be true or false, got 'no'"),
        (lambda: CartPoleEnv(randomize=0), "randomize must be true or false, got 0"),
        (lambda: made.reset(options={"phi": 0}), "options of reset must be empty"),
        (lambda: CartPoleVectorEnv(0), "num_envs must be at least 1, got 0"),
        (lambda: CartPoleVectorEnv(2, threads=0), "threads must be at least 1, got 0"),
        (lambda: CartPoleVectorEnv(1, render_mode="rgb_array"), "render_mode must be None"),
    ):
        with pytest.raises(InvalidValueError, match=message):
            refused()
    made.close()
    with pytest.raises(gymnasium.error.ResetNeeded):
        made.step(np.zeros((3, 1)))
    with pytest.raises(gymnasium.error.ClosedEnvironmentError):
        made.reset()


SLOPES = np.array([-0.3, 2.0, -0.5, 1.0, 0.01, 0.01])


def share_of(seen):
    return np.array([np.tanh(-SLOPES[: len(seen)] @ np.asarray(seen, dtype=float))])


def wrapped(name):
    w, env = gymnasium.wrappers, CartPoleEnv("trapezoid-step")
    scaled = gymnasium.spaces.Box(-np.inf, np.inf, (6,))
    if name == "action":
        return w.RescaleAction(env, np.array([-64.0]), np.array([64.0])), lambda o: 64 * share_of(o)
    if name == "statistics":
        env = w.NormalizeObservation(env)
        env.reset(), env.step(np.zeros(1))
        env.update_running_mean = False
        return env, lambda o: share_of(o * np.sqrt(env.obs_rms.var) + env.obs_rms.mean)
    if name == "order":  # of observations from the inside out, of actions from the outside in
        env = w.TransformObservation(env, lambda o: o + 0.01, scaled)
        env = w.TransformObservation(env, lambda o: 2 * o, scaled)
        env = w.TransformAction(env, lambda a: a**3, env.action_space)
        env = w.TransformAction(env, lambda a: a + 0.01, env.action_space)
        return w.RecordEpisodeStatistics(w.TimeLimit(w.ClipAction(env), 1000)), share_of
    return env, lambda o, deterministic=False: (share_of(o) if deterministic else None, None)


@pytest.mark.parametrize("name", ["action", "statistics", "order", "predict"])
def test_a_policy_is_a_controller_and_acts_through_the_wrappers_it_was_trained_with(name) -> None:
    environment, predict = wrapped(name)
    policy = policy_controller(predict, environment)
    assert acts_alike(policy, environment, share_of if name == "predict" else predict) > 20


def acts_alike(policy, environment, predict) -> int:
    scenario = environment.unwrapped.scenario
    run = afl.simulate_mujoco(scenario, policy, "sampled", control_period=CONTROL_PERIOD)
    seen, _ = environment.reset()
    forces, ended = [], False
    while not ended:
        seen, _, terminated, truncated, told = environment.step(predict(seen))
        forces.append(told["force"])
        ended = terminated or truncated
    np.testing.assert_array_equal(run.input[:-1:20][: len(forces)], forces)
    return len(forces)


@pytest.mark.parametrize(("wrap", "message"), [
    (lambda w, e: w.FrameStackObservation(e, 2), "wrapper FrameStackObservation of the "
     "environment must change observations or actions one by one"),
    (lambda w, e: w.TimeAwareObservation(w.TimeLimit(e, 10)), "wrapper TimeAwareObservation of "
     "the environment must depend on the present observation or action alone"),
    (lambda w, e: w.NormalizeObservation(e), "wrapper NormalizeObservation of the environment "
     "must be frozen: set update_running_mean = False"),
    (lambda w, e: CartPoleVectorEnv(2), "environment of a policy must be a ScenarioEnv or "),
], ids=["frames", "time", "learning", "vector"])  # fmt: skip
def test_what_cannot_be_repeated_outside_the_environment_is_refused(wrap, message: str) -> None:
    environment = wrap(gymnasium.wrappers, CartPoleEnv("nominal"))
    with pytest.raises(InvalidValueError, match=message):
        policy_controller(share_of, environment)
    policy = policy_controller(lambda seen: (np.zeros(1), (1.0,)), CartPoleEnv("nominal"))
    with pytest.raises(InvalidValueError, match="must not return a state: a recurrent policy"):
        policy(0.0, np.zeros(4), afl.CartPoleParameters())


def test_actions_go_from_the_lower_to_the_upper_limit_of_an_input(tmp_path: Path) -> None:
    text = (EXAMPLES / "quadrotor_load.xml").read_text()
    limited = text.replace('site="left" gear', 'site="left" ctrlrange="0 12" gear')
    assert limited != text
    (tmp_path / "quadrotor_load.xml").write_text(limited)
    (tmp_path / "limited_load.py").write_text((EXAMPLES / "quadrotor_load.py").read_text())
    lines = ('plant = "limited_load.py:plant"', "[imperfections]", "input_limit = 20.0")
    (tmp_path / "mine.toml").write_text("\n".join(lines))
    environment = ScenarioEnv(tmp_path / "mine.toml", **SI)
    assert environment.observation_space.shape == (8 + 5,)
    environment.reset()
    for action, forces in (([-1.0, -1.0], [0.0, -20.0]), ([0.5, 3.0], [9.0, 20.0])):
        assert environment.step(action)[4]["force"].tolist() == forces
    with pytest.raises(InvalidValueError, match=r"^action must have shape \(2,\), got \(1,\)"):
        environment.step([1.0])
    seen, _ = environment.reset()
    assert seen[8:].tolist() == environment.scenario.values_at(0.0).tolist()
    drawn = replace(afl.SCENARIOS["nominal"], ranges={"input_limit": (20.0, 60.0)})
    many = ScenarioEnv(drawn, randomize=True)
    assert (many.low, many.high) == (-60.0, 60.0)  # in every episode
    assert afl.load(drawn, randomize=True).action_spec().maximum == 60.0
    far = afl.Scenario(name="far", plant=cart(motor=' ctrlrange="5 40"'))
    for make in (ScenarioEnv, lambda *one, **how: afl.load(*one, **how).action_spec()):
        with pytest.raises(InvalidValueError, match=r"^force_limit must leave each input a range"):
            make(far, force_limit=3.0)
    scaled = ScenarioEnv(tmp_path / "mine.toml")
    assert scaled.scale.tolist() == [4, 4, 2, 2, 8, 8, 8, 8, 1.0, 2**-5, 2**-5, 0.5, 16.0]


def test_what_is_told_is_what_drives_exert_and_when_the_episode_ended() -> None:
    push = afl.ForcePulse(input="left", force=5.0, start=0.0, duration=0.053)
    pushed = replace(QUADROTOR, imperfections=Imperfections(), ranges={}, duration=0.0535)
    settings = {"scenario": replace(pushed, disturbances=(push,)), "control_period": 0.02}
    environment, vector = ScenarioEnv(**settings), ScenarioVectorEnv(2, **settings)
    environment.reset(), vector.reset()
    for time in (0.02, 0.04, 0.0535):
        *_, told = environment.step([0.05, 0.05])
        *_, several = vector.step([[0.05, 0.05]] * 2)
        assert told["force"] == pytest.approx(0.05 * environment.high, rel=1e-12)
        np.testing.assert_array_equal(several["force"], [told["force"]] * 2)
        assert told["time"] == pytest.approx(time) and (several["time"] == told["time"]).all()
    with pytest.raises(InvalidValueError, match="num_envs must be a whole number"):
        ScenarioVectorEnv(1.5)
    vector.reset(seed=np.int64(4))
    with pytest.raises(InvalidValueError, match=r"actions must be numbers, got \['1'\]"):
        vector.step(["1"])


def test_a_policy_of_any_plant_is_a_controller() -> None:
    scenario = replace(QUADROTOR, imperfections=Imperfections(), ranges={})
    environment = ScenarioEnv(replace(scenario, initial_state={"x": 0.1}, duration=0.5))

    def predict(seen: np.ndarray) -> np.ndarray:
        return (5.0 + seen[:2]) / FORCE_LIMIT

    assert acts_alike(policy_controller(predict, environment), environment, predict) > 10
    with pytest.raises(InvalidValueError, match="action of a policy must give 2 numbers, got 1"):
        belief = scenario.plant.named(scenario.plant.nominal)
        policy_controller(lambda seen: np.zeros(1), environment)(0.0, np.zeros(8), belief)
