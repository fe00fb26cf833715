"""A dm_control Physics whose plant follows a scenario in every physics step."""

from __future__ import annotations

import math
from typing import Any, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.compiled import kernel
from afl_mujoco.errors import InvalidValueError, MissingPackageError
from afl_mujoco.graphics import choose_backend
from afl_mujoco.plants.library import mj_forward, write_row
from afl_mujoco.plants.plant import Floats
from afl_mujoco.scenario.belief import TRUTH
from afl_mujoco.scenario.ranges import scheduled_columns
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.time_steps import instants, step_times
from afl_mujoco.simulation.decor import add_forces, add_label, add_tracks, drawn_model
from afl_mujoco.simulation.mujoco_model import (
    SimulatedModel,
    read_numbers,
    read_state,
    write_state,
)
from afl_mujoco.simulation.poses import TOWARD, tracks
from afl_mujoco.simulation.sampled.hardware import (
    RUNNING,
    RunState,
    Sensors,
    actuators_of,
    new_run,
    no_commands,
    sense,
    sensors_of,
)
from afl_mujoco.simulation.sampled.loop import Plan, Profile, advance, apply_impulse, write_plant
from afl_mujoco.simulation.sampled.runs import input_profile, last_change, told_parameters
from afl_mujoco.simulation.trajectory import STATE_LIMIT, Criterion, criterion_of, within_limits

choose_backend()
import mujoco  # noqa: E402  (like dm_control it reads MUJOCO_GL when imported)

try:
    from dm_control.mujoco import Physics as DmPhysics
    from dm_control.mujoco import wrapper
except ModuleNotFoundError as error:  # beyond Python 3.12 pip cannot install it with the rest
    rule = "must be installed: pip install --no-deps 'dm-control>=1.0.50,<1.1'"
    raise MissingPackageError(str(error.name), rule) from None

_ENDS = ("ends", "tipped", "stops", "bands")  # of a criterion, what ends a run or counts as rest
_FOREVER = 2**62  # more steps than any run has: the environment ends an episode, not the loop


class Episode(NamedTuple):
    """The inputs of a scenario, sampled on the physics steps until nothing changes any more."""

    timestep: float  # physics step [s]
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


def episode_of(model: SimulatedModel, scenario: Scenario, timestep: float, hold: int) -> Episode:
    """Return the sampled inputs of a scenario, whose imperfections the model has."""
    s, r = scenario, scenario.imperfections
    count = len(step_times(s.duration, timestep)) - 1
    changing = min(math.ceil(last_change(s) / timestep) + 1, count)
    times: Floats = np.arange(count + 1, dtype=np.float64) * timestep
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
    criterion = criterion_of(s)
    never = {name: np.full_like(getattr(criterion, name), np.inf) for name in _ENDS}
    endless = criterion._replace(**never)
    return Episode(float(timestep), profile, *course, told, *devices, endless)


@kernel
def begin_held(at, profile, run):
    """Apply what happens at the start of the first step."""
    run.marks.written = RUNNING
    write_plant(at, profile, run, 0)
    apply_impulse(at, profile, run, 0, False)


@kernel
def advance_held(
    at, timestep, endless, profile, rows, which, actuators, run, pending, instant, hold
):
    """Take a control period under the commands in MjData, or until the state diverges.

    `run.peak` tells how far from their targets the coordinates were in it.
    """
    run.peak[:] = 0.0
    read_state(at, run.after)
    if not within_limits(run.after):
        return instant
    marks = run.marks
    marks.step, marks.status, marks.written = instant, RUNNING, RUNNING
    write_plant(at, profile, run, instant)
    read_numbers(at.ctrl, run.command)
    plan = Plan(_FOREVER, hold, timestep, timestep, endless)
    advance(at, plan, actuators, profile, run, pending, np.empty((0, 0)))
    read_state(at, run.after)
    if not within_limits(run.after):
        return marks.step + 1
    write_row(at.structures, at.targets, rows[which[min(instant + hold, len(which) - 1)]])
    mj_forward(at.model, at.data)
    return instant + hold


class Physics(DmPhysics):  # type: ignore[misc]
    """A dm_control Physics whose plant follows a scenario, step by step, with its imperfections.

    Between steps model and data belong to the instant ``time()``, after its ideal impulses: a
    picture shows the current length. The instant is the whole number of timesteps nearest to
    ``data.time``, so `set_state` with MuJoCo's time in it moves along the schedule too; call
    `forward` after it. The state of the hardware, such as delayed commands, is not part of MuJoCo's
    state: `set_state` does not change it.

    timestep: Physics step [s], which divides the scenario's duration.
    """

    def __init__(
        self, scenario: Scenario, *, timestep: float, integrator: str, hold: int = 1
    ) -> None:
        self._timestep, self._integrator, self.hold = timestep, integrator, hold
        self._model = drawn_model(scenario, timestep=timestep, integrator=integrator)
        self.follow(scenario)
        data = wrapper.MjData(wrapper.MjModel(self._model.mj_model))
        self._model.drive(data.ptr)
        super().__init__(data)
        self.reset()

    def follow(self, scenario: Scenario) -> None:
        """Take a scenario of the plant, and its hardware; `begin` starts it."""
        self.scenario = scenario
        self._model.set_imperfections(scenario.imperfections)
        self.episode = episode_of(self._model, scenario, self._timestep, self.hold)
        self.pending = no_commands(self.episode.actuators)
        self.run = self._new_run()
        self._seen_at: tuple[Any, ...] = ()

    def _new_run(self) -> RunState:
        return new_run(len(self.scenario.plant.coordinates), len(self.scenario.plant.inputs))

    @property
    def addresses(self) -> Any:
        """`SimulatedModel.addresses` of its model and data."""
        return self._model.addresses

    @property
    def instant(self) -> int:
        """Number of steps since t = 0."""
        return round(float(self.data.ptr.time) / self._timestep)

    def told_parameters(self) -> Floats:
        """Return the parameters that are `scheduled` as a controller assumes them now."""
        told = self.episode.told
        found: Floats = told[min(self.instant, len(told) - 1)].copy()
        return found

    def true_state(self) -> Floats:
        """Return the true state, shape (2 n,)."""
        data = self.data.ptr
        return np.concatenate([data.qpos, data.qvel])

    def measured(self) -> Floats:
        """Return the state as measured at this control tick, shape (2 n,)."""
        now = (self.instant, self.true_state().tobytes())
        if now != self._seen_at:  # filters and differences must see each tick once
            sense(self.addresses, self.episode.sensors, self.run, self.instant // self.hold)
            self._seen_at = now
        return self.run.measured.copy()

    def diverged(self) -> bool:
        """Return whether the state exceeds `STATE_LIMIT` or is not finite."""
        return not within_limits(self.true_state())

    def begin(self) -> None:
        """Put the plant at t = 0 into its initial state, then apply the impulses there."""
        self.data.ptr.time = 0.0
        write_state(self.addresses, np.array(self.scenario.initial_state))
        self.run, self._seen_at = self._new_run(), ()
        self.pending[:] = 0.0
        begin_held(self.addresses, self.episode.profile, self.run)
        self.forward()

    def reset(self, keyframe_id: int | None = None) -> None:
        """Return to the scenario's initial state, plant included."""
        super().reset(keyframe_id)
        self._model.set_imperfections(self.scenario.imperfections)
        self.begin()

    def forward(self) -> None:
        """Update everything in model and data to this instant and state."""
        e, at = self.episode, self.addresses
        row = e.rows[e.which[min(self.instant, len(e.which) - 1)]]
        write_row(at.structures, at.targets, row)
        super().forward()

    def step(self, nstep: int = 1) -> None:
        """Advance under the commands in MjData, which then holds what the drives exert."""
        for name, force in zip(self.scenario.plant.inputs, self.data.ptr.ctrl, strict=True):
            if not abs(force) < STATE_LIMIT:
                unit = f" {self.scenario.plant.units[name]}".rstrip()
                rule = f"must be below {STATE_LIMIT:g}{unit}"
                raise InvalidValueError("control", rule, f"{force:g}{unit}")
        e = self.episode
        reached = advance_held(
            self.addresses, e.timestep, e.endless, e.profile, e.rows, e.which, e.actuators,
            self.run, self.pending, self.instant, nstep,
        )  # fmt: skip
        self.data.ptr.time = reached * self._timestep

    def render(self, *args: Any, **settings: Any) -> NDArray[np.uint8]:
        """Return a picture as dm_control does, with rails, and forces as arrows."""
        decorated = {"scene_callback": _decorate, **settings}
        if any(settings.get(name) for name in ("depth", "segmentation")):
            decorated = settings
        picture: NDArray[np.uint8] = super().render(*args, **decorated)
        return picture

    def copy(self, share_model: bool = False) -> NoReturn:
        """Raise: the state of the hardware is not part of MuJoCo's, and the model changes."""
        raise InvalidValueError("Physics", "cannot be copied: load the scenario again")

    __getstate__ = copy

    def _reload_from_model(self, model: Any) -> None:
        raise InvalidValueError("model", "cannot be replaced: it follows the scenario")


def _decorate(physics: Physics, scene: mujoco.MjvScene) -> None:
    """Draw rails with numbers, end stops, limits and forces."""
    model, held = physics._model, physics.episode.profile.push
    along = held[min(physics.instant, len(held) - 1)]  # coordinates
    exerted = np.array(physics.data.ptr.ctrl)
    add_forces(scene, model, exerted, np.concatenate([np.zeros_like(exerted), along]))
    place, size = np.array(physics.data.ptr.qpos), float(model.mj_model.stat.extent)
    rails = tracks(physics.scenario, model, TOWARD)
    for number, spot in add_tracks(scene, model, rails, place, 2.0 * size):
        add_label(scene, spot - [0.0, 0.0, 0.06 * size], f"{number:g} m")  # letters stand on it
