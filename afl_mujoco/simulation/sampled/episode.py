"""A plant that follows a scenario under commands from outside, for dm_control and Gymnasium."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from afl_mujoco.compiled import kernel, load, store
from afl_mujoco.plants.library import mj_forward, mujoco, write_row
from afl_mujoco.plants.plant import Floats
from afl_mujoco.scenario.belief import TRUTH
from afl_mujoco.scenario.ranges import scheduled_columns
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.time_steps import SNAP, instants, last_step, step_times
from afl_mujoco.simulation.judgement import require_start
from afl_mujoco.simulation.mujoco_model import SimulatedModel, read_numbers, read_state, write_state
from afl_mujoco.simulation.sampled.hardware import (
    RUNNING,
    Sensors,
    actuators_of,
    new_run,
    no_commands,
    sense,
    sensors_of,
)
from afl_mujoco.simulation.sampled.loop import Plan, Profile, advance, apply_impulse, write_plant
from afl_mujoco.simulation.sampled.runs import input_profile, last_change, told_parameters
from afl_mujoco.simulation.trajectory import Criterion, criterion_of, within_limits

_FOREVER = 2**62  # more steps than any run has: the environment ends an episode, not the loop


class Episode(NamedTuple):
    """The inputs of a scenario, sampled on the physics steps until nothing changes any more."""

    profile: Profile  # as in `loop.start`
    # what is in the model at each instant, after the jump where there is one: the rows, and the row
    # of each of N instants
    rows: Floats
    which: NDArray[np.int64]
    # the parameters that are `scheduled` at each instant, as a controller assumes them: late and
    # with an error if the scenario has such imperfections, shape (N, parameters)
    told: Floats
    sensors: Sensors  # the hardware
    actuators: NDArray[Any]
    endless: Criterion  # from where deviations are measured; nothing ends the loop


def _episode_of(model: SimulatedModel, scenario: Scenario, timestep: float, hold: int) -> Episode:
    """Return the sampled inputs of a scenario, whose imperfections the model has."""
    s, r = scenario, scenario.imperfections
    times = step_times(s.duration, timestep)
    count = len(times) - 1
    changing = min(math.ceil(last_change(s) / timestep) + 1, count)
    profile = input_profile(model, s, times[: min(changing + 1, count) + 1])
    until = min(changing + 1 + math.ceil(r.parameter_delay / timestep), count)
    at = instants(times[: until + 1])
    now = s.values(at)
    if changing + 1 >= count:  # beyond the horizon the plant keeps what it had there
        whole: Any = profile
        none, which = Profile(*(np.zeros_like(x[:1]) for x in whole)), np.array([len(whole.rows)])
        last = none._replace(rows=model.rows(now[-1]), which=which, split=np.array([-1.0]))
        profile = Profile(*map(np.concatenate, zip(whole, last, strict=True)))
    told = told_parameters(s, at) if r.parameter_delay or s.belief != TRUTH else now
    told, course = told[:, scheduled_columns(s.plant)].copy(), model.course(now)
    devices = sensors_of(s, hold * timestep), actuators_of(s, timestep, count)
    never = np.full(len(s.target), np.inf)
    endless = criterion_of(s)._replace(ends=never, tipped=never)
    return Episode(profile, *course, told, *devices, endless)


@kernel
def _begin(at, state, profile, run):
    """Put the plant into a state, and apply what happens at the start of the first step."""
    write_state(at, state)
    run.marks.written = RUNNING
    write_plant(at, profile, run, 0, True)
    apply_impulse(at, profile, run, 0, False)


@kernel
def _advance(at, plan, profile, rows, which, actuators, run, pending, instant):
    """Take a control period under the commands in MjData, or until the state diverges.

    `run.peak` tells how far from their targets the coordinates were in it.
    """
    run.peak[:] = 0.0
    read_state(at, run.after)
    if not within_limits(run.after):
        return instant
    marks = run.marks
    marks.step, marks.status, marks.written = instant, RUNNING, RUNNING
    write_plant(at, profile, run, instant, False)
    read_numbers(at.ctrl, run.command)
    advance(at, plan, actuators, profile, run, pending, np.empty((0, 0)))
    read_state(at, run.after)
    if not within_limits(run.after):
        return marks.step + 1
    write_row(at.structures, at.targets, rows[which[min(marks.step, len(which) - 1)]])
    mj_forward(at.model, at.data)
    row = min(marks.step - 1, len(profile.beside) - 1)
    for i in range(at.k):  # what acts beside a drive is not exerted by it
        if profile.beside[row, i] != 0.0:
            store(at.ctrl + 8 * i, load(at.ctrl + 8 * i) - profile.beside[row, i])
    return marks.step


class World:
    """A model that follows a scenario, with its hardware; instants are counted in physics steps."""

    def __init__(self, model: SimulatedModel, timestep: float, hold: int) -> None:
        self.model, self.timestep = model, timestep  # physics step [s]
        self.hold = hold  # physics steps of a control period

    def follow(self, scenario: Scenario, episode: Episode | None = None) -> None:
        """Take a scenario of the plant, of which the episode may be known; `begin` starts it."""
        require_start(scenario)
        self.scenario = scenario
        times = step_times(scenario.duration, self.timestep)
        self.last = len(times) - 1  # instant of the horizon
        self.shorter = last_step(times, self.timestep)  # the step that ends there [s]
        self.model.set_imperfections(scenario.imperfections)
        self.episode = episode or _episode_of(self.model, scenario, self.timestep, self.hold)

    def begin(self) -> None:
        """Put the plant into its initial state, then apply the impulses there."""
        at, e = self.model.addresses, self.episode
        self.run, self.pending = new_run(at.n, at.k), no_commands(e.actuators)
        _begin(at, np.array(self.scenario.initial_state), e.profile, self.run)
        self.write_at(0)

    def write_at(self, instant: int) -> None:
        """Write the parameters of an instant to the model, and bring its data up to them."""
        at, e = self.model.addresses, self.episode
        write_row(at.structures, at.targets, e.rows[e.which[min(instant, len(e.which) - 1)]])
        mujoco.mj_forward(self.model.mj_model, self.model.mj_data)

    def advance(self, instant: int, steps: int) -> int:
        """Advance under the commands in MjData, which then holds what the drives exert.

        Return the instant reached: that of the horizon where it is nearer, as a run ends there, and
        an earlier one where the state diverged.
        """
        e, end = self.episode, self.last if instant < self.last else _FOREVER
        plan = Plan(end, steps, self.timestep, self.shorter, e.endless)
        reached: int = _advance(
            self.model.addresses, plan, e.profile, e.rows, e.which, e.actuators, self.run,
            self.pending, instant,
        )  # fmt: skip
        return reached

    def time(self, instant: ArrayLike) -> Any:
        """Return the time of instants [s]: that of the last is the scenario's duration."""
        return np.minimum(np.multiply(instant, self.timestep), self.scenario.duration)

    def measured(self, instant: int) -> Floats:
        """Measure the state, shape (2 n,); filters and differences must see each tick once."""
        tick, sensors = -(-instant // self.hold), self.episode.sensors
        if instant == self.last:  # the last control period may be shorter
            elapsed = self.scenario.duration - (tick - 1) * self.hold * self.timestep
            if elapsed < (1.0 - SNAP) * sensors.period:
                sensors = sensors_of(self.scenario, elapsed)
        sense(self.model.addresses, sensors, self.run, tick)
        return self.run.measured.copy()

    def told(self, instant: int) -> Floats:
        """Return the parameters that are `scheduled` as a controller assumes them."""
        told = self.episode.told
        found: Floats = told[min(instant, len(told) - 1)].copy()
        return found

    @property
    def state(self) -> Floats:
        """The true state, shape (2 n,)."""
        data = self.model.mj_data
        return np.concatenate([data.qpos, data.qvel])
