"""Many episodes at once: the steps of all environments in one compiled call on several threads."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numba import carray  # type: ignore[attr-defined]
from numpy.typing import ArrayLike, NDArray

from afl_mujoco.compiled import kernel, pointer
from afl_mujoco.errors import InvalidValueError, require_count
from afl_mujoco.plants.library import mj_forward, mj_reset_data, write_row
from afl_mujoco.plants.plant import Floats
from afl_mujoco.pool import MOST_WORKERS
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.gym_env.environment import (
    ScenarioEnv,
    observed,
    require_no_options,
    reseed,
)
from afl_mujoco.simulation.gym_env.registration import require_gymnasium
from afl_mujoco.simulation.mujoco_model import (
    Addresses,
    SimulatedModel,
    read_numbers,
    read_state,
    write_numbers,
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
    ACTUATOR,
    RunState,
    Sensors,
    new_run,
    no_commands,
    sense,
)
from afl_mujoco.simulation.sampled.loop import Profile
from afl_mujoco.simulation.task import Reward
from afl_mujoco.simulation.trajectory import STATE_LIMIT

require_gymnasium()
import gymnasium  # noqa: E402  (an optional package; its absence raised an error in one line)
from gymnasium.utils.seeding import np_random  # noqa: E402
from gymnasium.vector import AutoresetMode  # noqa: E402
from gymnasium.vector.utils import batch_space  # noqa: E402

SHARES = 8  # parts for each thread in which environments step: who is done with one takes the next


class Many(NamedTuple):
    """What compiled code knows of N environments: every field has a row for each."""

    at: Addresses  # of their models
    sensors: Sensors
    actuators: NDArray[Any]
    runs: RunState
    # address and length of each array of an episode, as `_begin` keeps them, shape (N, arrays, 2)
    episodes: NDArray[np.int64]
    instants: NDArray[np.int64]
    # the state, its measurement, the parameters as they are told, and the inputs that acted
    truth: Floats
    seen: Floats
    told: Floats
    forces: Floats


def _stacked(rows: Sequence[Any]) -> Any:
    return type(rows[0])(*map(np.array, zip(*rows, strict=True)))


def _put(stacked: Any, i: int, row: Any) -> None:
    for field, value in zip(stacked, row, strict=True):
        field[i] = value


@kernel
def _floats(where, columns):
    return carray(pointer(where[0]), (where[1], columns), np.float64)


@kernel
def _numbers(where):
    """Return the same of one dimension: a column of the other would be a type of its own."""
    return carray(pointer(where[0]), (where[1],), np.float64)


@kernel
def _whole_numbers(where):
    return carray(pointer(where[0]), (where[1],), np.int64)


@kernel
def _plant(i, many):
    a, s, e = many.at, many.sensors, many.episodes[i]
    at = Addresses(
        a.model[i], a.data[i], a.timestep[i], a.qpos[i], a.qvel[i], a.ctrl[i], a.applied[i],
        a.qacc[i], a.smooth[i], a.n[i], a.k[i], a.bodies[i], a.parents[i], a.work[i],
        a.structures[i], a.targets[i],
    )  # fmt: skip
    sensors = Sensors(
        s.noisy[i], s.noise[i], s.step[i], s.differentiated[i], s.period[i], s.filter_share[i],
        s.seed[i],
    )  # fmt: skip
    profile = Profile(
        _floats(e[0], len(at.targets)), _whole_numbers(e[1]), _floats(e[2], at.n),
        _floats(e[3], at.k), _floats(e[4], at.n), _numbers(e[5]), _whole_numbers(e[6]),
        _floats(e[7], 15 * len(at.parents)), _floats(e[8], 15 * len(at.parents)),
    )  # fmt: skip
    return at, sensors, profile


@kernel
def _step(part, begins, hold, timestep, endless, many, commands):
    """Begin episodes from the states in ``many.truth``, or take a control period, in a part."""
    r = many.runs
    for i in part:
        at, sensors, profile = _plant(i, many)
        run = RunState(
            r.marks[i], r.drive[i], r.command[i], r.measured[i], r.seen[i], r.before[i],
            r.after[i], r.peak[i], r.iae[i], r.space[i],
        )  # fmt: skip
        e = many.episodes[i]
        rows, which = _floats(e[9], len(at.targets)), _whole_numbers(e[10])
        if begins:
            mj_reset_data(at.model, at.data)
            write_state(at, many.truth[i])
            begin_held(at, profile, run)
            write_row(at.structures, at.targets, rows[0])
            mj_forward(at.model, at.data)
        else:
            write_numbers(at.ctrl, commands[i])
            many.instants[i] = advance_held(
                at, timestep, endless, profile, rows, which, many.actuators[i], run,
                _floats(e[12], at.k), many.instants[i], hold,
            )  # fmt: skip
            read_numbers(at.ctrl, many.forces[i])
        read_state(at, many.truth[i])
        sense(at, sensors, run, many.instants[i] // hold)
        many.seen[i] = run.measured
        told = _floats(e[11], many.told.shape[1])
        many.told[i] = told[min(many.instants[i], len(told) - 1)]


class ScenarioVectorEnv(gymnasium.vector.VectorEnv):  # type: ignore[misc]
    """Many `ScenarioEnv`, step for step and bit for bit as in a `SyncVectorEnv` of them.

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
        self._hold, self._timestep = physics.hold, physics.episode.timestep
        self._randoms = [np.random.default_rng() for _ in range(num_envs)]
        plant, integrator = physics.scenario.plant, settings.get("integrator", "RK4")
        self._models = [
            SimulatedModel(plant, timestep=self._timestep, integrator=integrator)
            for _ in range(num_envs)
        ]
        n, k, each = len(plant.coordinates), len(plant.inputs), range(num_envs)
        self._many = Many(
            at=_stacked([model.addresses for model in self._models]),
            sensors=_stacked([physics.episode.sensors for _ in each]),
            actuators=np.zeros((num_envs, k), ACTUATOR),
            runs=_stacked([new_run(n, k) for _ in each]),
            episodes=np.zeros((num_envs, 13, 2), dtype=np.int64),
            instants=np.zeros(num_envs, dtype=np.int64),
            truth=np.zeros((num_envs, 2 * n)),
            seen=np.zeros((num_envs, 2 * n)),
            told=np.zeros((num_envs, physics.episode.told.shape[1])),
            forces=np.zeros((num_envs, k)),
        )
        self._reward = Reward(physics.scenario)
        self._steps = np.zeros(num_envs, dtype=np.int64)
        self._kept: list[list[Any]] = [[] for _ in each]  # whose addresses compiled code has
        self._samples = np.full(num_envs, None, dtype=object)
        self._ended: NDArray[np.bool_] | None = None

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: Any = None
    ) -> tuple[Floats, dict[str, Any]]:
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
        require_no_options(options)
        for i in count:
            if seeds[i] is not None:
                self._randoms[i], _ = np_random(seeds[i])
            self._begin(i, *self._draw(i))
        self._ended = np.zeros(self.num_envs, dtype=np.bool_)
        return self._observations(), self._information()

    def step(
        self, actions: ArrayLike
    ) -> tuple[Floats, Floats, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Hold an action, shares of the inputs' limits, in every environment."""
        if self._ended is None:
            raise gymnasium.error.ResetNeeded("reset must be called before step: no episode runs")
        values, many = np.asarray(actions, dtype=np.float64), self._many
        if values.shape != many.forces.shape:
            rule = f"must have shape {many.forces.shape}"
            raise InvalidValueError("actions", rule, values.shape)
        fresh = self._ended
        if not np.isfinite(values[~fresh]).all():
            raise InvalidValueError("actions", "must be finite", values.tolist())
        commands = self._first.inputs(values)

        begin = np.flatnonzero(fresh).tolist()
        active = np.flatnonzero(~fresh)
        count = min(len(active), SHARES * self._workers) if self._pool else 1
        parts = iter(np.array_split(active, max(count, 1)))

        endless = self._first.dm_environment.physics.episode.endless

        def work() -> None:
            for part in parts:  # taking the next is one instruction, which no thread interrupts
                _step(part, False, self._hold, self._timestep, endless, many, commands)

        self._steps += 1
        others = [self._pool.submit(work) for _ in range(self._workers - 1)] if self._pool else []
        for i in begin:  # in Python, while the others compute
            self._begin(i, *self._draw(i))
        work()
        for one in others:
            one.result()
        diverged = np.logical_not((np.abs(many.truth) < STATE_LIMIT).all(axis=1))
        terminated = (self._reward.ended(many.truth, many.runs.peak) | diverged) & ~fresh
        last = self._steps >= self._first.most_steps
        truncated = last & ~terminated & ~fresh
        finite = np.where(diverged[:, None], 0.0, many.truth)
        rewards = np.where(diverged | fresh, 0.0, self._reward.of(finite, many.forces))
        self._ended = terminated | truncated
        return self._observations(), rewards, terminated, truncated, self._information()

    def close_extras(self, **kwargs: Any) -> None:
        """Free the threads and the models."""
        if self._pool is not None:
            self._pool.shutdown()
        self._first.close()

    def _draw(self, i: int) -> tuple[Scenario, Episode]:
        task, physics = self._first.dm_environment.task, self._first.dm_environment.physics
        reseed(task, self._randoms[i])
        scenario = task.draw(physics.scenario)
        if scenario is physics.scenario:
            return scenario, physics.episode
        model = self._models[i]
        model.set_imperfections(scenario.imperfections)
        return scenario, episode_of(model, scenario, self._timestep, self._hold)

    def _begin(self, i: int, scenario: Scenario, e: Episode) -> None:
        many, model = self._many, self._models[i]
        self._kept[i] = arrays = [
            *e.profile, e.rows, e.which, e.told, no_commands(e.actuators)
        ]  # fmt: skip
        many.episodes[i] = [(one.ctypes.data, len(one)) for one in arrays]
        many.actuators[i] = e.actuators
        _put(many.sensors, i, e.sensors)
        _put(many.runs, i, new_run(many.truth.shape[1] // 2, many.forces.shape[1]))
        many.instants[i] = self._steps[i] = 0
        many.forces[i], self._samples[i] = 0.0, scenario.name
        model.set_imperfections(scenario.imperfections)
        model.compute_only()
        many.truth[i] = scenario.initial_state
        _step(np.array([i]), True, self._hold, self._timestep, e.endless, many, many.forces)

    def _observations(self) -> Floats:
        return observed(np.concatenate([self._many.seen, self._many.told], axis=1), self.scale)

    def _information(self) -> dict[str, Any]:
        many = self._many
        forces = many.forces[:, 0] if many.forces.shape[1] == 1 else many.forces
        known = {"time": many.instants * self._timestep, "force": forces.copy()}
        if self._first.randomize:
            known["sample"] = self._samples.copy()
        there = np.ones(self.num_envs, dtype=np.bool_)
        return {**known, **{f"_{name}": there.copy() for name in known}}


CartPoleVectorEnv = ScenarioVectorEnv  # what it was called when there was no other plant
