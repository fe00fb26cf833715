"""The Gymnasium environment of a scenario, and a policy that learned in it as a controller."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from dm_env import TimeStep
from numpy.typing import ArrayLike, NDArray

from afl_mujoco.errors import (
    GraphicsError,
    InvalidValueError,
    UnknownNameError,
    require_count,
    told,
)
from afl_mujoco.graphics import PACKAGES, choose_backend
from afl_mujoco.plants.plant import Floats
from afl_mujoco.scenario.files import as_scenario
from afl_mujoco.scenario.ranges import scheduled
from afl_mujoco.scenario.sample_space import SampleSpace
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.drawing import LARGEST
from afl_mujoco.simulation.gym_env.registration import require_gymnasium
from afl_mujoco.simulation.task import Balance, load, numbers_of
from afl_mujoco.simulation.trajectory import STATE_LIMIT
from afl_mujoco.values import require_switch

require_gymnasium()
import gymnasium  # noqa: E402  (an optional package; its absence raised an error in one line)
from gymnasium import wrappers  # noqa: E402

Change = Callable[[Any], Any]

_OUTSIDE = (
    *(gymnasium.RewardWrapper, wrappers.NormalizeReward, wrappers.RecordEpisodeStatistics),
    *(wrappers.OrderEnforcing, wrappers.PassiveEnvChecker, wrappers.TimeLimit),
    *(wrappers.Autoreset, wrappers.RecordVideo, wrappers.HumanRendering),
    wrappers.RenderCollection,
)
"""Wrappers that change neither what a policy sees nor what it does."""

_OUTSIDE_NAMES = frozenset({"Monitor"})
"""The same, of Stable-Baselines3, which need not be installed."""


def changes_of(environment: gymnasium.Env) -> tuple[Change, Change]:
    """Return what wrappers make of the innermost environment's observation, and of an action."""
    seen: list[Change] = []
    done: list[Change] = []
    layer = environment
    while isinstance(layer, gymnasium.Wrapper):
        if isinstance(layer, gymnasium.ObservationWrapper):
            seen.insert(0, _observation(layer))
        elif isinstance(layer, gymnasium.ActionWrapper):
            _require_its_own(layer, gymnasium.ActionWrapper)
            done.append(layer.action)
        elif not (isinstance(layer, _OUTSIDE) or type(layer).__name__ in _OUTSIDE_NAMES):
            rule = "must change observations or actions one by one (ObservationWrapper, "
            raise InvalidValueError(_named(layer), f"{rule}ActionWrapper), or rewards alone")
        layer = layer.env
    return _in_turn(seen), _in_turn(done)


def _observation(layer: gymnasium.ObservationWrapper) -> Change:
    """Return what a wrapper makes of an observation; statistics as they are now."""
    if isinstance(layer, wrappers.AddRenderObservation):
        raise InvalidValueError(_named(layer), "must not need a picture of the environment")
    _require_its_own(layer, gymnasium.ObservationWrapper)
    if not isinstance(layer, wrappers.NormalizeObservation):
        return layer.observation  # type: ignore[no-any-return]
    if layer.update_running_mean:
        raise InvalidValueError(_named(layer), "must be frozen: set update_running_mean = False")
    mean, spread = layer.obs_rms.mean.copy(), np.sqrt(layer.obs_rms.var + layer.epsilon)
    return lambda seen: np.float32((seen - mean) / spread)


def _require_its_own(layer: gymnasium.Wrapper, base: type) -> None:
    """Raise if a wrapper does more at a step or a reset than its kind: it has memory."""
    if type(layer).step is not base.step or type(layer).reset is not base.reset:  # type: ignore[attr-defined]
        rule = "must depend on the present observation or action alone"
        raise InvalidValueError(_named(layer), rule, "a step or reset of its own")


def _named(layer: gymnasium.Wrapper) -> str:
    return f"wrapper {type(layer).__name__} of the environment"


def _in_turn(changes: list[Change]) -> Change:
    return lambda value: functools.reduce(lambda x, change: change(x), changes, value)


FORCE_LIMIT = 128.0
"""Force [N] of an action of 1: above the 98 N that the paper's controller needs, and a power of
two, so that a force divided by it and multiplied again is the same to the last bit."""

CONTROL_PERIOD = 0.02
"""How long an action is held [s]; the paper's controller balances every scenario with it."""

STATE_SCALE = {"m": 4.0, "rad": 2.0, "m/s": 8.0, "rad/s": 8.0}
"""Scales by which observations of the state are divided, by unit."""

RENDER_MODE = "rgb_array"


class ScenarioEnv(gymnasium.Env):  # type: ignore[misc]
    """Balance a plant while it changes; reward and plant are those of `load`.

    The observation is the state and the parameters at the instant, of the cart-pole (z, phi, z_dot,
    phi_dot, M, l) and of another plant all parameters, as shares of `scale`, within `STATE_LIMIT`:
    the state as measured, the parameters as a controller assumes them. The action has a number in
    -1 to 1 for each input, held for a control period: of the cart-pole the force as a share of
    `force_limit`; of another plant -1 is the lower and 1 the upper limit of the input, in the MJCF
    (``ctrlrange``) or by the ``input_limit`` of the scenario, at most `force_limit`. An episode is
    terminated when a coordinate is as far from its target as ends a run, ``|phi|`` at `FALL_ANGLE`,
    or the state diverges, and truncated at the scenario's end.

    control_period: How long an action is held [s], a multiple of `timestep` (default: that of the
        scenario's imperfections, else `CONTROL_PERIOD`).
    force_limit: Force of an action of 1, where no other limit is closer [N].
    width, height, camera: Size of the pictures [pixels], and camera: of the cart-pole ``"side"`` or
        ``"fixed"``, of another plant by default the first of its MJCF, else a free one.
    scale: Scales by which observations are divided, of the cart-pole [m, rad, m/s, rad/s, kg, m]:
        powers of two, so that nothing is rounded; those of parameters are not less than the largest
        true value that can occur.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (as the base class declares it)
        "render_modes": [RENDER_MODE],
        "render_fps": round(1.0 / CONTROL_PERIOD),
    }

    def __init__(
        self,
        scenario: str | Path | Scenario = "nominal",
        *,
        render_mode: str | None = None,
        control_period: float | None = None,
        force_limit: float = FORCE_LIMIT,
        randomize: bool = False,
        scaled: bool = True,
        timestep: float | None = None,
        integrator: str = "RK4",
        width: int = 480,
        height: int = 360,
        camera: str | int | None = None,
    ) -> None:
        if render_mode not in (None, RENDER_MODE):
            raise UnknownNameError.among("render_mode", render_mode, ("None", RENDER_MODE))
        scenario = as_scenario(scenario)
        own = scenario.imperfections.control_period
        period = control_period if control_period is not None else own or CONTROL_PERIOD
        self.dm_environment = load(
            scenario,
            timestep=timestep,
            control_period=period,
            integrator=integrator,
            force_limit=force_limit,
            randomize=randomize,
        )
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": round(1.0 / period, 3)}
        least, largest = _bounds_of(scenario, self.dm_environment.task.space)
        states = [STATE_SCALE[scenario.plant.units[name]] for name in scenario.plant.states]
        powers = 2.0 ** np.ceil(np.log2(np.where(largest > 0.0, largest, 1.0)))
        self.scale = np.concatenate([states, powers])
        if not require_switch("scaled", scaled):
            self.scale = np.ones(len(self.scale))
        high = STATE_LIMIT / self.scale
        never_negative = np.concatenate([np.zeros(len(states), np.bool_), least >= 0.0])
        low = np.where(never_negative, 0.0, -high)
        self.observation_space = gymnasium.spaces.Box(low, high, dtype=np.float64)
        self.low, self.high = self.dm_environment.task.bounds(scenario)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, self.low.shape, dtype=np.float64)
        self.randomize = randomize
        self._picture = {
            "height": require_count("height", height, 1, LARGEST[1]),
            "width": require_count("width", width, 1, LARGEST[0]),
            "camera_id": _camera(self.dm_environment.physics.model.ptr, camera),
        }
        self._under_way = self._closed = False

    @property
    def most_steps(self) -> float:
        """Number of steps after which an episode is truncated."""
        return float(self.dm_environment._step_limit)

    @property
    def scenario(self) -> Scenario:
        """The scenario of this episode."""
        found: Scenario = self.dm_environment.physics.scenario
        return found

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats, dict[str, Any]]:
        """Start an episode; the information is ``time`` [s] and the ``force`` [N]."""
        if self._closed:
            raise gymnasium.error.ClosedEnvironmentError("a closed environment cannot be reset")
        super().reset(seed=seed)
        require_no_options(options)
        reseed(self.dm_environment.task, self.np_random)
        step = self.dm_environment.reset()
        self._under_way = True
        return self._flat(step), self._information()

    def step(self, action: ArrayLike) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        """Hold an action, shares of the inputs' limits, over one control period."""
        if not self._under_way:
            raise gymnasium.error.ResetNeeded("reset must be called before step: no episode runs")
        shares = numbers_of("action", action, self.low.shape)
        if not np.isfinite(shares).all():
            raise InvalidValueError("action", "must be finite", shares.tolist())
        step = self.dm_environment.step(self.inputs(shares))
        ended = self.dm_environment.task.get_termination(self.dm_environment.physics) is not None
        self._under_way = not step.last()
        truncated = bool(step.last()) and not ended
        return self._flat(step), float(step.reward), ended, truncated, self._information()

    def inputs(self, shares: Floats) -> Floats:
        """Return the inputs of actions, shape (..., k)."""
        middle, half = 0.5 * (self.low + self.high), 0.5 * (self.high - self.low)
        found: Floats = np.clip(middle + half * shares, self.low, self.high)
        return found

    def render(self) -> NDArray[np.uint8] | None:
        """Return a picture of now, shape (height, width, 3), or None without a render mode."""
        if self.render_mode is None:
            return None
        if choose_backend() == "disable":
            raise GraphicsError("headless rendering", f"must be able to draw; {PACKAGES}")
        picture: NDArray[np.uint8] = self.dm_environment.physics.render(**self._picture)
        return picture

    def close(self) -> None:
        """Free the resources of drawing; the environment cannot be used afterwards."""
        self._under_way, self._closed = False, True
        self.dm_environment.physics.free()

    def _information(self) -> dict[str, Any]:
        physics = self.dm_environment.physics
        control = physics.control()
        force = float(control[0]) if len(control) == 1 else control.copy()
        time = float(physics.world.time(physics.instant))
        known: dict[str, Any] = {"time": time, "force": force}
        if self.randomize:
            known["sample"] = physics.scenario.name
        return known

    def _flat(self, step: TimeStep) -> Floats:
        return observed(np.concatenate([*step.observation.values()]), self.scale)


CartPoleEnv = ScenarioEnv  # what it was called when there was no other plant


def _camera(model: mujoco.MjModel, camera: str | int | None) -> str | int:
    """Return a camera of a model, the first or a free one by default, or raise."""
    if camera is None:
        return 0 if model.ncam else -1
    names = [name for k in range(model.ncam) if (name := model.camera(k).name)]
    if not (names if isinstance(camera, str) else model.ncam or camera == -1):
        rule = "must be left out, or -1: the model has no such camera"
        raise InvalidValueError("camera", rule, repr(camera))
    if isinstance(camera, str):
        if camera not in names:
            raise UnknownNameError.among("camera", camera, names)
        return camera
    return require_count("camera", camera, -1, model.ncam - 1)


def require_no_options(options: dict[str, Any] | None) -> None:
    """Raise if a reset has options: a scenario says where an episode starts."""
    if options:
        given = ", ".join(map(str, options)) if isinstance(options, dict) else told(options)
        raise InvalidValueError("options of reset", "must be empty", given)


def reseed(task: Balance, random: np.random.Generator) -> None:
    """Seed the random numbers that a task draws for the next episode."""
    task.random.seed(int(random.integers(2**32)))


def observed(values: Floats, scale: Floats) -> Floats:
    """Return SI values, shape (..., numbers), as observations, always within the limits."""
    limited = np.clip(np.nan_to_num(values, nan=STATE_LIMIT), -STATE_LIMIT, STATE_LIMIT)
    return np.asarray(limited / scale)


def _bounds_of(scenario: Scenario, space: SampleSpace | None) -> tuple[Floats, Floats]:
    """Return the least value of each parameter that is observed, and its largest magnitude."""
    spans = [
        scenario.spans[name] if space is None else space.bounds(name)
        for name in scheduled(scenario.plant)
    ]
    table = np.array(spans).reshape(-1, 2)
    return table[:, 0], np.abs(table).max(axis=1)


def policy_controller(
    predict: Callable[..., Any], environment: gymnasium.Env
) -> Callable[[float, Floats, Any], Any]:
    """Return a policy as a controller ``(time, state, belief) -> force``, for any command.

    Held for the environment's control period, it repeats the episode, through its wrappers. It has
    no memory: the policy is read and not copied.
    """
    env = getattr(environment, "unwrapped", environment)
    if not isinstance(env, ScenarioEnv):
        rule = "must be a ScenarioEnv or wrappers of one, not a vector of them"
        raise InvalidValueError("environment of a policy", rule, type(env).__name__)
    scale, count, names = env.scale.copy(), len(env.low), scheduled(env.scenario.plant)
    inputs = env.inputs
    see, act = changes_of(environment)
    if _asks_whether_deterministic(predict):
        predict = functools.partial(predict, deterministic=True)

    def policy(time: float, state: Floats, belief: Any) -> Any:
        values = np.array([*state, *(getattr(belief, name) for name in names)])
        action = predict(see(observed(values, scale)))
        if isinstance(action, tuple):
            action, memory = action
            if memory is not None:
                rule = "must not return a state: a recurrent policy has memory"
                raise InvalidValueError("predict of a policy", rule)
        shares = numbers_of("action of a policy", act(action)).ravel()
        if shares.shape != (count,):
            one = "one number, the share of the largest force"
            what = one if count == 1 else f"{count} numbers"
            raise InvalidValueError("action of a policy", f"must give {what}", f"{len(shares)}")
        forces = inputs(shares)
        return float(forces[0]) if count == 1 else forces

    return policy


def _asks_whether_deterministic(predict: Callable[..., Any]) -> bool:
    if isinstance(predict, functools.partial) and "deterministic" in predict.keywords:
        return False
    try:
        return "deterministic" in inspect.signature(predict).parameters
    except (TypeError, ValueError):  # of a builtin
        return False
