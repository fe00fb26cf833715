"""Many episodes at once, on several threads: compiled code steps without the interpreter's lock."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from afl_mujoco.errors import InvalidValueError, require_count
from afl_mujoco.plants.plant import Floats
from afl_mujoco.pool import MOST_WORKERS
from afl_mujoco.simulation.gym_env.environment import (
    ScenarioEnv,
    observed,
    require_no_options,
    reseed,
)
from afl_mujoco.simulation.gym_env.registration import require_gymnasium
from afl_mujoco.simulation.mujoco_model import SimulatedModel
from afl_mujoco.simulation.sampled.episode import World
from afl_mujoco.simulation.task import Physics, Reward, numbers_of
from afl_mujoco.simulation.trajectory import STATE_LIMIT

require_gymnasium()
import gymnasium  # noqa: E402  (an optional package; its absence raised an error in one line)
from gymnasium.utils.seeding import np_random  # noqa: E402
from gymnasium.vector import AutoresetMode  # noqa: E402
from gymnasium.vector.utils import batch_space  # noqa: E402

MOST_ENVIRONMENTS = 100_000  # each has a model of its own


class ScenarioVectorEnv(gymnasium.vector.VectorEnv):  # type: ignore[misc]
    """Many `ScenarioEnv`, step for step and bit for bit as in a `SyncVectorEnv` of them.

    When an episode has ended, the next step starts a new one and ignores its action.
    """

    metadata = {  # noqa: RUF012 (as the base class declares it)
        "render_modes": [],
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(self, num_envs: int = 1, *, threads: int | None = None, **settings: Any) -> None:
        require_count("num_envs", num_envs, 1, MOST_ENVIRONMENTS)
        if settings.pop("render_mode", None) is not None:
            raise InvalidValueError("render_mode", "must be None: a ScenarioEnv draws pictures")
        self._first = first = ScenarioEnv(**settings)  # its settings are those of all
        self.num_envs = num_envs
        self.single_observation_space = first.observation_space
        self.single_action_space = first.action_space
        self.observation_space = batch_space(first.observation_space, num_envs)
        self.action_space = batch_space(first.action_space, num_envs)
        self.scale = first.scale
        asked = (os.cpu_count() or 1) if threads is None else threads
        self._workers = min(require_count("threads", asked, 1, MOST_WORKERS), num_envs)
        self._pool = ThreadPoolExecutor(self._workers - 1) if self._workers > 1 else None
        physics: Physics = first.dm_environment.physics
        self._physics, plant = physics, physics.scenario.plant
        step = {"timestep": physics.world.timestep, "integrator": settings.get("integrator", "RK4")}
        self._randoms = [np.random.default_rng() for _ in range(num_envs)]
        self._worlds = [
            World(SimulatedModel(plant, **step), step["timestep"], physics.world.hold)
            for _ in range(num_envs)
        ]
        n, k, parameters = len(plant.coordinates), len(plant.inputs), len(first.scale)
        self._truth, self._forces = np.zeros((num_envs, 2 * n)), np.zeros((num_envs, k))
        self._peaks, self._seen = np.zeros((num_envs, n)), np.zeros((num_envs, parameters))
        self._instants = np.zeros(num_envs, dtype=np.int64)
        self._steps = np.zeros(num_envs, dtype=np.int64)
        self._reward = Reward(physics.scenario)
        self._ended: NDArray[np.bool_] | None = None

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: Any = None
    ) -> tuple[Floats, dict[str, Any]]:
        """Start an episode in every environment."""
        count = range(self.num_envs)
        if seed is None or isinstance(seed, int | np.integer):
            seeds: list[int | None] = [None if seed is None else int(seed) + i for i in count]
        else:
            seeds = list(seed)
        if len(seeds) != self.num_envs:
            rule = f"must be one number or {self.num_envs} of them"
            raise InvalidValueError("seed", rule, f"{len(seeds)}")
        if self.closed:
            raise gymnasium.error.ClosedEnvironmentError("closed environments cannot be reset")
        require_no_options(options)
        for i in count:
            if seeds[i] is not None:
                self._randoms[i], _ = np_random(seeds[i])
            self._begin(i)
        self._ended = np.zeros(self.num_envs, dtype=np.bool_)
        return self._observations(), self._information()

    def step(
        self, actions: ArrayLike
    ) -> tuple[Floats, Floats, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Hold an action, shares of the inputs' limits, in every environment."""
        if self._ended is None:
            raise gymnasium.error.ResetNeeded("reset must be called before step: no episode runs")
        values = numbers_of("actions", actions, self._forces.shape)
        fresh = self._ended
        if not np.isfinite(values[~fresh]).all():
            raise InvalidValueError("actions", "must be finite", values.tolist())
        commands = self._first.inputs(values)
        active = iter(np.flatnonzero(~fresh).tolist())

        def work() -> None:
            for i in active:  # taking the next is one instruction, which no thread interrupts
                world, inputs = self._worlds[i], self._worlds[i].model.mj_data.ctrl
                inputs[:] = commands[i]
                self._instants[i] = world.advance(int(self._instants[i]), world.hold)
                self._forces[i] = inputs
                self._look(i)

        self._steps += 1
        others = [self._pool.submit(work) for _ in range(self._workers - 1)] if self._pool else []
        for i in np.flatnonzero(fresh).tolist():  # in Python, while the others compute
            self._begin(i)
        work()
        for one in others:
            one.result()
        diverged = np.logical_not((np.abs(self._truth) < STATE_LIMIT).all(axis=1))
        terminated = (self._reward.ended(self._truth, self._peaks) | diverged) & ~fresh
        last = self._steps >= self._first.most_steps
        truncated = last & ~terminated & ~fresh
        finite = np.where(diverged[:, None], 0.0, self._truth)
        rewards = np.where(diverged | fresh, 0.0, self._reward.of(finite, self._forces))
        self._ended = terminated | truncated
        return self._observations(), rewards, terminated, truncated, self._information()

    def close_extras(self, **kwargs: Any) -> None:
        """Free the threads and the models."""
        self._ended = None
        if self._pool is not None:
            self._pool.shutdown()
        self._first.close()

    def _begin(self, i: int) -> None:
        task, world, first = self._first.dm_environment.task, self._worlds[i], self._physics.world
        reseed(task, self._randoms[i])
        scenario = task.draw(first.scenario)
        world.follow(scenario, first.episode if scenario is first.scenario else None)
        world.model.compute_only()
        mujoco.mj_resetData(world.model.mj_model, world.model.mj_data)
        world.begin()
        self._instants[i] = self._steps[i] = 0
        self._forces[i] = 0.0
        self._look(i)

    def _look(self, i: int) -> None:
        """Note the state of an environment, and what is seen of it."""
        world, instant = self._worlds[i], int(self._instants[i])
        self._truth[i], self._peaks[i] = world.state, world.run.peak
        self._seen[i] = np.concatenate([world.measured(instant), world.told(instant)])

    def _observations(self) -> Floats:
        return observed(self._seen, self.scale)

    def _information(self) -> dict[str, Any]:
        forces = self._forces[:, 0] if self._forces.shape[1] == 1 else self._forces
        known = {"time": self._physics.world.time(self._instants), "force": forces.copy()}
        if self._first.randomize:
            names = [world.scenario.name for world in self._worlds]
            known["sample"] = np.array(names, dtype=object)
        there = np.ones(self.num_envs, dtype=np.bool_)
        return {**known, **{f"_{name}": there.copy() for name in known}}


CartPoleVectorEnv = ScenarioVectorEnv  # what it was called when there was no other plant
