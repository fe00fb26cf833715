"""The Gymnasium environment of a scenario, and what wrappers make of it."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from dm_env import TimeStep
from numpy.typing import ArrayLike, NDArray

from afl_mujoco.errors import GraphicsError, InvalidValueError, UnknownNameError
from afl_mujoco.graphics import PACKAGES, choose_backend
from afl_mujoco.scenario.files import as_scenario
from afl_mujoco.scenario.imperfections import require_on_rail
from afl_mujoco.scenario.parameters import SCHEDULES, CartPoleParameters
from afl_mujoco.scenario.sample_space import SampleSpace
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.gym_env.registration import require_gymnasium
from afl_mujoco.simulation.task import OBSERVED, PRIVILEGED, Balance, load
from afl_mujoco.simulation.trajectory import FALL_ANGLE, STATE_LIMIT
from afl_mujoco.values import require_finite

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
        rule = "must be frozen: set update_running_mean = False"
        raise InvalidValueError(_named(layer), rule)
    mean, spread = layer.obs_rms.mean.copy(), np.sqrt(layer.obs_rms.var + layer.epsilon)
    return lambda seen: np.float32((seen - mean) / spread)


def _require_its_own(layer: gymnasium.Wrapper, base: type) -> None:
    """Raise if a wrapper does more at a step or a reset than its kind: it has memory."""
    if type(layer).step is not base.step or type(layer).reset is not base.reset:  # type: ignore[attr-defined]
        rule = "must depend on the present observation or action alone"
        raise InvalidValueError(_named(layer), rule, "a step or reset of its own")


def _named(layer: gymnasium.Wrapper) -> str:
    """Return the name of a wrapper for messages."""
    return f"wrapper {type(layer).__name__} of the environment"


def _in_turn(changes: list[Change]) -> Change:
    """Return the function that applies changes one after the other."""

    def change(value: Any) -> Any:
        for one in changes:
            value = one(value)
        return value

    return change


FORCE_LIMIT = 128.0
"""Force [N] of an action of 1: above the 98 N that the paper's controller needs, and a power of
two, so that a force divided by it and multiplied again is the same to the last bit."""

CONTROL_PERIOD = 0.02
"""How long an action is held [s]; the paper's controller balances every scenario with it."""

STATE_SCALE = np.array([4.0, 2.0, 8.0, 8.0])
"""Scales by which observations of the state are divided [m, rad, m/s, rad/s]."""

RENDER_MODE = "rgb_array"
OPTIONS = ("initial_state",)
STATE_NAMES = ("z", "phi", "z_dot", "phi_dot")


class CartPoleEnv(gymnasium.Env):  # type: ignore[misc]
    """Balance the pole while the plant changes; reward and plant are those of `load`.

    The observation is (z, phi, z_dot, phi_dot, M, l) at the instant, as shares of `scale`, within
    `STATE_LIMIT`: the state as measured, M and l as a controller assumes them. The action is the
    force on the cart as a share of `force_limit`, in -1 to 1, held for a control period. An episode
    is terminated when ``|phi|`` reaches `FALL_ANGLE` or the state diverges, and truncated at the
    scenario's end.

    control_period: How long an action is held [s], a multiple of `timestep` (default: that of the
        scenario's imperfections, else `CONTROL_PERIOD`).
    force_limit: Force of an action of 1 [N].
    width, height, camera: Size of the pictures [pixels], and camera, ``"side"`` or ``"fixed"``.
    scale: Scales by which observations are divided [m, rad, m/s, rad/s, kg, m]: powers of two, so
        that nothing is rounded; those of M and l are not less than the largest M and l that can
        occur.
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
        parameters: str = OBSERVED,
        randomize: bool = False,
        scaled: bool = True,
        timestep: float | None = None,
        integrator: str = "RK4",
        initial_noise: float = 0.0,
        width: int = 480,
        height: int = 360,
        camera: str = "side",
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
            initial_noise=initial_noise,
            parameters=parameters,
            randomize=randomize,
        )
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": round(1.0 / period, 3)}
        space = self.dm_environment.task.space
        self.scale = _scale_of(scenario, space) if scaled else np.ones(6)
        if parameters != OBSERVED:
            self.scale = self.scale[:4]
        high = STATE_LIMIT / self.scale
        low = np.concatenate([-high[:4], np.zeros(len(high) - 4)])
        self.observation_space = gymnasium.spaces.Box(low, high, dtype=np.float64)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), dtype=np.float64)
        self.force_limit = float(force_limit)
        self.parameters, self.randomize = parameters, randomize
        self._picture = {"height": height, "width": width, "camera_id": camera}
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
    ) -> tuple[NDArray[np.float64], dict[str, Any]]:
        """Start an episode.

        Returns tuple: Observation, and information: ``time`` [s] and the ``force`` [N] that acted.
        """
        if self._closed:
            raise gymnasium.error.ClosedEnvironmentError("a closed environment cannot be reset")
        super().reset(seed=seed)
        start = initial_state(options or {})
        task, physics = self.dm_environment.task, self.dm_environment.physics
        reseed(task, self.np_random)
        step = self.dm_environment.reset()
        if start is not None:
            rail = self.scenario.rail
            require_on_rail("z of initial_state", start[0], rail)
            physics.begin(start)
            step = step._replace(observation=task.get_observation(physics))
        self._under_way = True
        return self._flat(step), self._information()

    def step(
        self, action: ArrayLike
    ) -> tuple[NDArray[np.float64], float, bool, bool, dict[str, Any]]:
        """Hold an action over one control period.

        action: Force as a share of the limit, shape (1,), clipped to -1 and 1.
        """
        if not self._under_way:
            raise gymnasium.error.ResetNeeded("reset must be called before step: no episode runs")
        force = np.asarray(action, dtype=np.float64) * self.force_limit
        step = self.dm_environment.step(force)
        ended = self.dm_environment.task.get_termination(self.dm_environment.physics) is not None
        self._under_way = not step.last()
        truncated = bool(step.last()) and not ended
        return self._flat(step), float(step.reward), ended, truncated, self._information()

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
        """Return time, force, and what the settings add."""
        physics = self.dm_environment.physics
        known = {"time": float(physics.time()), "force": float(physics.control()[0])}
        if self.parameters == PRIVILEGED:
            known["parameters"] = physics.parameters()
        if self.randomize:
            known["sample"] = physics.scenario.name
        return known

    def _flat(self, step: TimeStep) -> NDArray[np.float64]:
        """Return an observation as one array."""
        seen = step.observation
        parts = [seen[name] for name in ("position", "velocity", "parameters") if name in seen]
        return observed(np.concatenate(parts), self.scale)


def reseed(task: Balance, random: np.random.Generator) -> None:
    """Seed the random numbers that a task draws for the next episode."""
    task.random.seed(int(random.integers(2**32)))


def observed(values: NDArray[np.float64], scale: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return SI values, shape (..., 4) or (..., 6), as observations, always within the limits."""
    limited = np.clip(np.nan_to_num(values, nan=STATE_LIMIT), -STATE_LIMIT, STATE_LIMIT)
    return np.asarray(limited / scale)


def _scale_of(scenario: Scenario, space: SampleSpace | None) -> NDArray[np.float64]:
    """Return the scales by which observations are divided."""
    mass, length, _, _ = scenario.plants
    if space is not None:
        mass, length = (space.bounds(name) for name in SCHEDULES)
    largest = np.array([mass[1], length[1]])
    return np.concatenate([STATE_SCALE, 2.0 ** np.ceil(np.log2(largest))])


def policy_controller(
    predict: Callable[..., Any], environment: gymnasium.Env
) -> Callable[[float, NDArray[np.float64], CartPoleParameters], float]:
    """Return a policy as a controller ``(time, state, belief) -> force``, for any command.

    It acts as in the environment, through its wrappers: held for the same control period, it
    repeats the episode. It has no memory: the policy is read and not copied.
    """
    env = getattr(environment, "unwrapped", environment)
    if not isinstance(env, CartPoleEnv):
        rule = "must be a CartPoleEnv or wrappers of one, not a vector of them"
        raise InvalidValueError("environment of a policy", rule, type(env).__name__)
    scale, limit = env.scale.copy(), env.force_limit
    see, act = changes_of(environment)
    if _asks_whether_deterministic(predict):
        predict = functools.partial(predict, deterministic=True)

    def policy(time: float, state: NDArray[np.float64], belief: CartPoleParameters) -> float:
        values = np.array([*state, belief.cart_mass, belief.half_length])[: len(scale)]
        action = predict(see(observed(values, scale)))
        if isinstance(action, tuple):
            action, memory = action
            if memory is not None:
                rule = "must not return a state: a recurrent policy has memory"
                raise InvalidValueError("predict of a policy", rule)
        share = np.asarray(act(action), dtype=np.float64).ravel()
        if share.shape != (1,):
            rule = "must give one number, the share of the largest force"
            raise InvalidValueError("action of a policy", rule, f"{len(share)}")
        return limit * min(max(float(share[0]), -1.0), 1.0)

    return policy


def _asks_whether_deterministic(predict: Callable[..., Any]) -> bool:
    """Return whether a function takes ``deterministic``, and it is not given yet."""
    if isinstance(predict, functools.partial) and "deterministic" in predict.keywords:
        return False
    try:
        return "deterministic" in inspect.signature(predict).parameters
    except (TypeError, ValueError):  # of a builtin
        return False


def initial_state(options: dict[str, Any]) -> tuple[float, ...] | None:
    """Return the initial state in the options, None if there is none."""
    for key in options:
        if key not in OPTIONS:
            raise UnknownNameError.among("options of reset", key, OPTIONS)
    if "initial_state" not in options:
        return None
    values = np.asarray(options["initial_state"], dtype=object)
    if values.shape != (4,):
        raise InvalidValueError("initial_state", "must hold four numbers", values.shape)
    names = zip(STATE_NAMES, values.tolist(), strict=True)
    state = tuple(require_finite(f"{name} of initial_state", x) for name, x in names)
    if abs(state[1]) >= FALL_ANGLE:
        rule = f"must be within {FALL_ANGLE:.4f} rad"
        raise InvalidValueError("phi of initial_state", rule, f"{state[1]:g}")
    return state
