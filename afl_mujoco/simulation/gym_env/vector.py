"""Many episodes at once: the steps of all environments in one compiled call on several threads."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from afl_mujoco.compiled import borrowing_kernel, kernel, load, store
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.pool import require_threads
from afl_mujoco.scenario.imperfections import require_on_rail
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.gym_env.environment import (
    CartPoleEnv,
    initial_state,
    observed,
    reseed,
)
from afl_mujoco.simulation.gym_env.registration import require_gymnasium
from afl_mujoco.simulation.mujoco_model import (
    CartPoleModel,
    mj_forward,
    mj_reset_data,
    read_state,
    write_parameters,
    write_state,
)
from afl_mujoco.simulation.mujoco_physics import (
    Episode,
    Physics,
    advance_held,
    begin_held,
    episode_of,
)
from afl_mujoco.simulation.sampled.hardware import (
    RUN,
    Actuator,
    Sensors,
    new_run,
    no_commands,
    sense,
)
from afl_mujoco.simulation.sampled.loop import PROFILE
from afl_mujoco.simulation.task import OBSERVED, PRIVILEGED, reward
from afl_mujoco.simulation.trajectory import FALL_ANGLE, STATE_LIMIT

require_gymnasium()
import gymnasium  # noqa: E402  (an optional package; its absence raised an error in one line)
from gymnasium.utils.seeding import np_random  # noqa: E402
from gymnasium.vector import AutoresetMode  # noqa: E402
from gymnasium.vector.utils import batch_space  # noqa: E402

SHARES = 8
"""Parts for each thread in which environments step: who is done with one takes the next."""


def _records(kind: type, **others: type) -> np.dtype[Any]:
    """Return a named tuple of floats and others as a record."""
    return np.dtype([(name, others.get(name, np.float64)) for name in kind._fields])  # type: ignore[attr-defined]


SENSORS = _records(Sensors, noisy=np.bool_, differentiated=np.bool_, seed=np.int64)
ACTUATORS = _records(Actuator, late=np.int64)


@borrowing_kernel
def _look(i, at, shown, sensors, tick, instant, runs, truth, seen, told):
    """Write the state of an environment, its measurement, and (M, l) as they are shown."""
    state = read_state(at[i])
    measured = sense(at[i], sensors[i], runs[i], tick)
    for k in range(4):
        truth[i, k], seen[i, k] = state[k], measured[k]
    last = shown[min(instant, len(shown) - 1)]
    told[i, 0], told[i, 1] = last[0], last[1]


@kernel
def _start(i, at, state, constants, profile, now, shown, sensors, runs, truth, seen, told):
    """Put an environment at the start of its episode; arguments as in `_step`."""
    mj_reset_data(at[i].model, at[i].data)
    write_state(at[i], state[0], state[1], state[2], state[3])
    begin_held(at[i], constants, profile, runs[i])
    write_parameters(at[i], now[0, 0], constants[1], now[0, 1], constants[2])
    mj_forward(at[i].model, at[i].data)
    _look(i, at, shown, sensors, 0, 0, runs, truth, seen, told)


@kernel
def _step(
    part, hold, at, constants, profiles, now, shown, sizes, sensors, actuators, runs, pendings,
    instants, commands, truth, seen, told, forces,
):  # fmt: skip
    """Take a control period in each environment of a part.

    shown: The (M, l) at each instant that `told` gets, shape (N, K, 2).
    sizes: Number of rows of `profiles`, `now` and `pendings` in use, shape (N, 3).
    truth, seen, told, forces: Take the state, its measurement, (M, l), and the force that acted,
        shape (N, 4), (N, 4), (N, 2) and (N,).
    """
    for i in part:
        store(at[i].control, commands[i])
        three = (constants[i, 0], constants[i, 1], constants[i, 2])
        profile, count = profiles[i, : sizes[i, 0]], sizes[i, 1]
        instants[i] = advance_held(
            at[i], three, profile, now[i, :count], actuators[i], runs[i],
            pendings[i, : sizes[i, 2]], instants[i], hold,
        )  # fmt: skip
        tick = instants[i] // hold
        _look(i, at, shown[i, :count], sensors, tick, instants[i], runs, truth, seen, told)
        forces[i] = load(at[i].control)


class CartPoleVectorEnv(gymnasium.vector.VectorEnv):  # type: ignore[misc]
    """Many `CartPoleEnv`, step for step and bit for bit as in a `SyncVectorEnv` of them.

    When an episode has ended, the next step starts a new one and ignores its action.
    """

    metadata = {  # noqa: RUF012 (as the base class declares it)
        "render_modes": [],
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(self, num_envs: int = 1, *, threads: int | None = None, **settings: Any) -> None:
        if num_envs < 1:
            raise InvalidValueError("num_envs", "must be at least 1", num_envs)
        if settings.pop("render_mode", None) is not None:
            raise InvalidValueError("render_mode", "must be None: a CartPoleEnv draws pictures")
        self._first = first = CartPoleEnv(**settings)  # its settings are those of all
        self.num_envs = num_envs
        self.single_observation_space = first.observation_space
        self.single_action_space = first.action_space
        self.observation_space = batch_space(first.observation_space, num_envs)
        self.action_space = batch_space(first.action_space, num_envs)
        self.scale = first.scale
        self._workers = min(
            require_threads((os.cpu_count() or 1) if threads is None else threads), num_envs
        )
        self._pool = ThreadPoolExecutor(self._workers - 1) if self._workers > 1 else None
        physics: Physics = first.dm_environment.physics
        self._hold, self._timestep = physics.hold, physics.episode.constants[0]
        self._randoms = [np.random.default_rng() for _ in range(num_envs)]
        self._models = [
            CartPoleModel(
                physics.scenario.parameters_at(0.0),
                timestep=self._timestep,
                integrator=settings.get("integrator", "RK4"),
            )
            for _ in range(num_envs)
        ]
        self._at = np.array([model.addresses for model in self._models])
        self._constants = np.zeros((num_envs, 3))
        self._sizes = np.zeros((num_envs, 3), dtype=np.int64)
        self._profiles = np.zeros((num_envs, 0), PROFILE)
        self._now, self._shown = np.zeros((2, num_envs, 0, 2))
        self._pendings = np.zeros((num_envs, 0))
        self._sensors, self._actuators = np.zeros(num_envs, SENSORS), np.zeros(num_envs, ACTUATORS)
        self._runs = np.zeros(num_envs, RUN)
        self._instants = np.zeros(num_envs, dtype=np.int64)
        self._steps = np.zeros(num_envs, dtype=np.int64)
        self._truth, self._seen = np.zeros((2, num_envs, 4))
        self._told, self._forces = np.zeros((num_envs, 2)), np.zeros(num_envs)
        self._drawn: list[Episode | None] = [None] * num_envs
        self._samples = np.full(num_envs, None, dtype=object)
        self._ended: NDArray[np.bool_] | None = None

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: Any = None
    ) -> tuple[NDArray[np.float64], dict[str, Any]]:
        """Start an episode in every environment."""
        count = range(self.num_envs)
        if seed is None or isinstance(seed, int):
            seeds: list[int | None] = [None if seed is None else seed + i for i in count]
        else:
            seeds = list(seed)
        if len(seeds) != self.num_envs:
            raise InvalidValueError("seed", f"must be {self.num_envs}", len(seeds))
        if self.closed:
            raise gymnasium.error.ClosedEnvironmentError("closed environments cannot be reset")
        asked = initial_state(options or {})
        for i in count:
            if seeds[i] is not None:
                self._randoms[i], _ = np_random(seeds[i])
            scenario, start, episode = self._draw(i)
            if asked is not None:
                rail = scenario.rail
                require_on_rail("z of initial_state", asked[0], rail)
            self._make_room(episode)
            self._begin(i, scenario, start if asked is None else asked, episode)
        self._ended = np.zeros(self.num_envs, dtype=np.bool_)
        return self._observations(), self._information()

    def step(
        self, actions: ArrayLike
    ) -> tuple[
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.bool_],
        NDArray[np.bool_],
        dict[str, Any],
    ]:
        """Hold an action in every environment over one control period.

        actions: Forces as shares of the limit, shape (N, 1), clipped to -1 and 1.
        """
        if self._ended is None:
            raise gymnasium.error.ResetNeeded("reset must be called before step: no episode runs")
        values = np.asarray(actions, dtype=np.float64)
        if values.shape != (self.num_envs, 1):
            rule = f"must have shape ({self.num_envs}, 1)"
            raise InvalidValueError("actions", rule, values.shape)
        values = values[:, 0]
        fresh = self._ended
        if not np.isfinite(values[~fresh]).all():
            raise InvalidValueError("actions", "must be finite", values.tolist())
        limit = self._first.force_limit
        commands = np.clip(values * limit, -limit, limit)

        begin = np.flatnonzero(fresh).tolist()
        active = np.flatnonzero(~fresh)
        count = min(len(active), SHARES * self._workers) if self._pool else 1
        parts = iter(np.array_split(active, max(count, 1)))

        def work() -> None:
            for part in parts:  # taking the next is one instruction, which no thread interrupts
                _step(
                    part, self._hold, self._at, self._constants, self._profiles, self._now,
                    self._shown, self._sizes, self._sensors, self._actuators, self._runs,
                    self._pendings, self._instants, commands, self._truth, self._seen, self._told,
                    self._forces,
                )  # fmt: skip

        def finish() -> None:
            work()
            for one in others:
                one.result()

        self._steps += 1
        others = [self._pool.submit(work) for _ in range(self._workers - 1)] if self._pool else []
        for i in begin:  # in Python, while the others compute
            scenario, start, episode = self._draw(i)
            if not self._has_room(episode):
                finish()  # of the arrays that are now replaced
                self._make_room(episode)
            self._begin(i, scenario, start, episode)
        finish()
        known = (np.abs(self._truth) < STATE_LIMIT).all(axis=1)
        diverged = np.logical_not(known)
        terminated = (np.abs(self._truth[:, 1]) >= FALL_ANGLE) | diverged
        terminated &= ~fresh
        last = self._steps >= self._first.most_steps
        truncated = last & ~terminated & ~fresh
        z, phi = np.where(diverged[:, None], 0.0, self._truth[:, :2]).T
        rewards = np.where(diverged | fresh, 0.0, reward(z, phi, self._forces))
        self._ended = terminated | truncated
        return self._observations(), rewards, terminated, truncated, self._information()

    def close_extras(self, **kwargs: Any) -> None:
        """Free the threads and the models."""
        if self._pool is not None:
            self._pool.shutdown()
        self._first.close()

    def _draw(self, i: int) -> tuple[Scenario, Sequence[float], Episode]:
        """Return the scenario of an environment's next episode, its start and its inputs."""
        task, physics = self._first.dm_environment.task, self._first.dm_environment.physics
        reseed(task, self._randoms[i])
        scenario, start = task.draw(physics.scenario)
        if scenario is physics.scenario:
            return scenario, start, physics.episode
        return scenario, start, episode_of(scenario, self._timestep, self._hold)

    def _has_room(self, e: Episode) -> bool:
        """Return whether the arrays have as many rows as an episode needs."""
        there = (self._profiles, self._now, self._pendings)
        return all(rows <= one.shape[1] for rows, one in zip(_rows(e), there, strict=True))

    def _make_room(self, e: Episode) -> None:
        """Replace arrays that have fewer rows than an episode needs."""
        steps, instants, late = _rows(e)
        self._profiles = _with_room(self._profiles, steps)
        self._now, self._shown = (_with_room(one, instants) for one in (self._now, self._shown))
        self._pendings = _with_room(self._pendings, late)

    def _begin(self, i: int, scenario: Scenario, start: Sequence[float], e: Episode) -> None:
        """Start an episode in one environment, as `CartPoleEnv.reset` does."""
        steps, instants, late = _rows(e)
        if self._drawn[i] is not e:
            self._profiles[i, :steps] = e.profile
            self._now[i, :instants] = e.now
            self._shown[i, :instants] = e.now if self._first.parameters == PRIVILEGED else e.told
            self._drawn[i] = e
        self._pendings[i] = 0.0
        self._sizes[i] = steps, instants, late
        self._constants[i] = e.constants
        self._sensors[i], self._actuators[i] = tuple(e.sensors), tuple(e.actuator)
        self._runs[i] = new_run()
        self._instants[i] = self._steps[i] = 0
        self._forces[i], self._samples[i] = 0.0, scenario.name
        model = self._models[i]
        model.set_imperfections(scenario.imperfections, scenario.parameters_at(0.0))
        model.compute_only(scenario.imperfections)
        _start(
            i, self._at, np.array(start), e.constants, e.profile, e.now,
            self._shown[i, :instants], self._sensors, self._runs, self._truth, self._seen,
            self._told,
        )  # fmt: skip

    def _observations(self) -> NDArray[np.float64]:
        """Return the observations of each environment, shape (N, 4) or (N, 6)."""
        told = [self._told] if self._first.parameters == OBSERVED else []
        return observed(np.concatenate([self._seen, *told], axis=1), self.scale)

    def _information(self) -> dict[str, Any]:
        """Return time, force, and what the settings add, as `SyncVectorEnv` does."""
        known = {"time": self._instants * self._timestep, "force": self._forces.copy()}
        if self._first.parameters == PRIVILEGED:
            known["parameters"] = self._told.copy()
        if self._first.randomize:
            known["sample"] = self._samples.copy()
        there = np.ones(self.num_envs, dtype=np.bool_)
        return {**known, **{f"_{name}": there.copy() for name in known}}


def _rows(e: Episode) -> tuple[int, int, int]:
    """Return how many rows of profile, parameters and delayed commands an episode needs."""
    return len(e.profile), len(e.now), len(no_commands(e.actuator))


def _with_room(stacked: NDArray[Any], length: int) -> NDArray[Any]:
    """Return an array whose rows have at least a length."""
    more = length - stacked.shape[1]
    if more <= 0:
        return stacked
    added = np.zeros((len(stacked), more, *stacked.shape[2:]), stacked.dtype)
    return np.concatenate([stacked, added], axis=1)
