"""A scenario as a `gymnasium.Env`: the dm_control environment of `load`, step for step."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from dm_env import TimeStep
from numpy.typing import ArrayLike, NDArray

from afl_mujoco.errors import GraphicsError, InvalidValueError, UnknownNameError
from afl_mujoco.graphics import PACKAGES, choose_backend
from afl_mujoco.scenario.parameters import require_finite
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.gym_env.registration import require_gymnasium
from afl_mujoco.simulation.task import load
from afl_mujoco.simulation.trajectory import FALL_ANGLE, STATE_LIMIT

require_gymnasium()
import gymnasium  # noqa: E402  (an optional package; its absence has been said in one line)

FORCE_LIMIT = 128.0
"""Force [N] of an action of 1: above the 98 N that the paper's controller needs, and a power of
two, so that a force divided by it and multiplied again is the same to the last bit."""

CONTROL_PERIOD = 0.02
"""How long an action is held [s]; the paper's controller balances every scenario with it."""

RENDER_MODE = "rgb_array"
OPTIONS = ("initial_state",)
STATE_NAMES = ("z", "phi", "z_dot", "phi_dot")


class CartPoleEnv(gymnasium.Env):  # type: ignore[misc]
    """Balance the pole while the plant changes; reward and plant are those of `load`.

    The observation is (z, phi, z_dot, phi_dot, M, l) [m, rad, m/s, rad/s, kg, m] at the instant,
    within `STATE_LIMIT`. The action is the force on the cart as a share of `force_limit`, in -1 to
    1, held for `control_period`. An episode is terminated where ``|phi|`` reaches `FALL_ANGLE` or
    the state diverges, truncated at the scenario's end.

    Parameters
    ----------
    scenario
        A name of the catalogue, a TOML file or a `Scenario`.
    render_mode
        None, or ``"rgb_array"``, which needs EGL or OSMesa when the first picture is asked for.
    control_period
        How long an action is held [s], a multiple of `timestep`.
    force_limit
        Force of an action of 1 [N].
    timestep, integrator, initial_noise
        As of `load`.
    width, height, camera
        Of the pictures [pixels], and ``"side"`` or ``"fixed"``.

    Raises
    ------
    AflMujocoError
        If a setting breaks its rule.
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
        control_period: float = CONTROL_PERIOD,
        force_limit: float = FORCE_LIMIT,
        timestep: float = 1e-3,
        integrator: str = "RK4",
        initial_noise: float = 0.0,
        width: int = 480,
        height: int = 360,
        camera: str = "side",
    ) -> None:
        if render_mode not in (None, RENDER_MODE):
            raise UnknownNameError.among("render_mode", render_mode, ("None", RENDER_MODE))
        self.dm_environment = load(
            scenario,
            timestep=timestep,
            control_period=control_period,
            integrator=integrator,
            force_limit=force_limit,
            initial_noise=initial_noise,
        )
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": round(1.0 / control_period, 3)}
        high = np.full(6, STATE_LIMIT)
        self.observation_space = gymnasium.spaces.Box(
            np.concatenate([-high[:4], np.zeros(2)]), high, dtype=np.float64
        )
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), dtype=np.float64)
        self._force_limit, self._noisy = float(force_limit), initial_noise > 0.0
        self._picture = {"height": height, "width": width, "camera_id": camera}
        self._under_way = self._closed = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float64], dict[str, Any]]:
        """Start an episode.

        Parameters
        ----------
        seed
            Of the random perturbation of phi(0), of this and the episodes after it.

        Returns
        -------
        tuple
            Observation, and information: ``time`` [s] and the ``force`` [N] that acted.
        """
        if self._closed:
            raise gymnasium.error.ClosedEnvironmentError("a closed environment cannot be reset")
        super().reset(seed=seed)
        start = _initial_state(options or {})
        task, physics = self.dm_environment.task, self.dm_environment.physics
        if self._noisy:
            task.random.seed(int(self.np_random.integers(2**32)))
        step = self.dm_environment.reset()
        if start is not None:
            physics.begin(start)
            step = step._replace(observation=task.get_observation(physics))
        self._under_way = True
        return _flat(step), self._information()

    def step(
        self, action: ArrayLike
    ) -> tuple[NDArray[np.float64], float, bool, bool, dict[str, Any]]:
        """Hold an action over one control period.

        Parameters
        ----------
        action
            Force as a share of the limit, shape (1,), clipped to -1 and 1.
        """
        if not self._under_way:
            raise gymnasium.error.ResetNeeded("reset must be called before step: no episode runs")
        force = np.asarray(action, dtype=np.float64) * self._force_limit
        step = self.dm_environment.step(force)
        ended = self.dm_environment.task.get_termination(self.dm_environment.physics) is not None
        self._under_way = not step.last()
        truncated = bool(step.last()) and not ended
        return _flat(step), float(step.reward), ended, truncated, self._information()

    def render(self) -> NDArray[np.uint8] | None:
        """Return a picture of now, shape (height, width, 3), or None without a render mode."""
        if self.render_mode is None:
            return None
        if choose_backend() == "disable":
            raise GraphicsError("headless rendering", f"must be able to draw; {PACKAGES}")
        picture: NDArray[np.uint8] = self.dm_environment.physics.render(**self._picture)
        return picture

    def close(self) -> None:
        """Free what drawing has taken; the environment is of no use afterwards."""
        self._under_way, self._closed = False, True
        self.dm_environment.physics.free()

    def _information(self) -> dict[str, Any]:
        """Return time and force."""
        physics = self.dm_environment.physics
        return {"time": float(physics.time()), "force": float(physics.control()[0])}


def _flat(step: TimeStep) -> NDArray[np.float64]:
    """Return an observation as one array, within the limits even where the state has diverged."""
    parts = [step.observation[name] for name in ("position", "velocity", "parameters")]
    found = np.nan_to_num(np.concatenate(parts), nan=STATE_LIMIT)
    return np.asarray(np.clip(found, -STATE_LIMIT, STATE_LIMIT))


def _initial_state(options: dict[str, Any]) -> tuple[float, ...] | None:
    """Return the initial state that is asked for, if any."""
    for key in options:
        if key not in OPTIONS:
            raise UnknownNameError.among("options of reset", key, OPTIONS)
    if "initial_state" not in options:
        return None
    values = np.asarray(options["initial_state"], dtype=np.float64)
    if values.shape != (4,):
        raise InvalidValueError("initial_state", "must hold four numbers", values.shape)
    names = zip(STATE_NAMES, values.tolist(), strict=True)
    state = tuple(require_finite(f"{name} of initial_state", x) for name, x in names)
    if abs(state[1]) >= FALL_ANGLE:
        rule = f"must be within {FALL_ANGLE:.4f} rad"
        raise InvalidValueError("phi of initial_state", rule, f"{state[1]:g}")
    return state
