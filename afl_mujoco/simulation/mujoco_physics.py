"""A dm_control Physics whose plant follows a scenario in every physics step."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.compiled import kernel, load
from afl_mujoco.errors import InvalidValueError, MissingPackageError
from afl_mujoco.graphics import choose_backend
from afl_mujoco.scenario.belief import TRUTH
from afl_mujoco.scenario.sampling import instants, step_times
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation import mujoco_model as mm
from afl_mujoco.simulation.decor import add_forces, add_marks, add_stops, marks_near, show_mass
from afl_mujoco.simulation.sampled.hardware import (
    RECORD,
    RUNNING,
    Actuator,
    Sensors,
    actuator_of,
    new_run,
    no_commands,
    sense,
    sensors_of,
)
from afl_mujoco.simulation.sampled.loop import (
    PROFILE,
    Criterion,
    Plan,
    advance,
    apply_impulse,
    write_plant,
)
from afl_mujoco.simulation.sampled.runs import input_profile, last_change, told_parameters
from afl_mujoco.simulation.trajectory import STATE_LIMIT, within_limits

choose_backend()
import mujoco  # noqa: E402  (like dm_control it reads MUJOCO_GL when imported)

try:
    from dm_control.mujoco import Physics as DmPhysics
    from dm_control.mujoco import wrapper
except ModuleNotFoundError as error:  # beyond Python 3.12 pip cannot install it with the rest
    raise MissingPackageError(
        str(error.name), "must be installed: pip install --no-deps 'dm-control>=1.0.50,<1.1'"
    ) from None

_FOREVER = 2**62
"""More steps than any run has: the environment ends an episode, not the loop."""


class Episode(NamedTuple):
    """The inputs of a scenario, sampled on the physics steps until nothing changes any more."""

    constants: tuple[float, float, float]  # physics step [s], m [kg] and g [m/s^2]
    profile: NDArray[Any]  # as in `loop.start`; its last row applies from then on
    # M [kg] and l [m] at each instant, after the jump where there is one, shape (N, 2)
    now: NDArray[np.float64]
    # M [kg] and l [m] that a controller assumes: late and with an error if the scenario has such
    # imperfections
    told: NDArray[np.float64]
    sensors: Sensors  # the hardware
    actuator: Actuator


def episode_of(scenario: Scenario, timestep: float, hold: int) -> Episode:
    """Return the sampled inputs of a scenario.

    timestep: Physics step [s].
    """
    s, r = scenario, scenario.imperfections
    count = len(step_times(s.duration, timestep)) - 1
    changing = min(math.ceil(last_change(s) / timestep) + 1, count)
    times: NDArray[np.float64] = np.arange(count + 1, dtype=np.float64) * timestep
    profile = input_profile(s, times[: min(changing + 1, count) + 1])
    until = min(changing + 1 + math.ceil(r.parameter_delay / timestep), count)
    at = instants(times[: until + 1])
    now = np.stack([s.cart_mass(at), s.half_length(at)], axis=1)
    if changing + 1 >= count:  # beyond the horizon the plant keeps what it had there
        profile = np.concatenate([profile, np.zeros(1, PROFILE)])
        profile["cart_mass"][-1], profile["half_length"][-1] = now[-1]
    told = now
    if r.parameter_delay or s.belief != TRUTH:
        told = np.stack(told_parameters(s, at), axis=1)
    return Episode(
        constants=(float(timestep), s.pole_mass, s.gravity),
        profile=profile,
        now=now,
        told=told,
        sensors=sensors_of(r, hold * timestep),
        actuator=actuator_of(r, timestep, count),
    )


@kernel
def _plan(constants, hold):
    """Return the plan of a control period, built here because Python would take longer."""
    timestep, pole_mass, gravity = constants
    endless = Criterion(
        fall_angle=np.inf, z=np.inf, phi=np.inf, z_dot=np.inf, phi_dot=np.inf, dwell=0
    )
    return Plan(
        steps=_FOREVER,
        hold=hold,
        timestep=timestep,
        last=timestep,
        pole_mass=pole_mass,
        gravity=gravity,
        rail=np.inf,
        criterion=endless,
    )


@kernel
def begin_held(at, constants, profile, run):
    """Apply what happens at the start of the first step."""
    run.written_mass = np.nan
    write_plant(at, _plan(constants, 1), profile, run, 0)
    apply_impulse(at, profile, 0, False)


@kernel
def advance_held(at, constants, profile, now, actuator, run, pending, instant, hold):
    """Take the steps of a control period under the command in MjData; return the instant reached.

    It stops where the state diverges. Otherwise it leaves model and data at that instant, with the
    (M, l) that `now` holds for it.
    """
    plan = _plan(constants, hold)
    if not within_limits(mm.read_state(at)):
        return instant
    run.step, run.status, run.written_mass = instant, RUNNING, np.nan
    write_plant(at, plan, profile, run, instant)
    force = load(at.control)
    advance(at, plan, actuator, profile, run, pending, np.empty((0, len(RECORD))), force)
    if not within_limits(mm.read_state(at)):
        return run.step + 1
    i = min(instant + hold, len(now) - 1)
    mm.write_parameters(at, now[i, 0], plan.pole_mass, now[i, 1], plan.gravity)
    mm.mj_forward(at.model, at.data)
    return instant + hold


class Physics(DmPhysics):  # type: ignore[misc]
    """A dm_control Physics whose plant follows a scenario, step by step, with its imperfections.

    Between steps model and data belong to the instant ``time()``, after its ideal impulses: a
    picture shows the current length. The instant is the whole number of timesteps nearest to
    ``data.time``, so `set_state` with MuJoCo's time in it moves along the schedule too; call
    `forward` after it. The state of the hardware, such as delayed commands, is not part of MuJoCo's
    state: `copy` copies it, `set_state` does not change it.

    timestep: Physics step [s], which divides the scenario's duration.
    """

    def __init__(
        self, scenario: Scenario, *, timestep: float, integrator: str, hold: int = 1
    ) -> None:
        self._timestep, self._integrator, self.hold = timestep, integrator, hold
        self._model = mm.CartPoleModel(
            scenario.parameters_at(0.0), file="scene.xml", timestep=timestep, integrator=integrator
        )
        self._take(scenario)
        data = wrapper.MjData(wrapper.MjModel(self._model.mj_model))
        self._model.drive(data.ptr)
        super().__init__(data)
        self.reset()

    def _take(self, scenario: Scenario) -> None:
        """Take the inputs of a scenario."""
        self.scenario = scenario
        self.episode = episode_of(scenario, self._timestep, self.hold)
        self.pending = no_commands(self.episode.actuator)
        self.run: Any = new_run()
        self._seen: NDArray[np.float64] = np.zeros(4)
        self._seen_at: tuple[float, ...] = ()

    def follow(self, scenario: Scenario) -> None:
        """Take another scenario's plant and hardware; `begin` starts it."""
        self._take(scenario)
        self._model.set_imperfections(scenario.imperfections, scenario.parameters_at(0.0))

    @property
    def addresses(self) -> Any:
        """`CartPoleModel.addresses` of its model and data."""
        return self._model.addresses

    @property
    def instant(self) -> int:
        """Number of steps since t = 0."""
        return round(float(self.data.ptr.time) / self._timestep)

    def parameters(self) -> NDArray[np.float64]:
        """Return the true (M, l) [kg, m] now, after the jump where there is one, shape (2,)."""
        return self._at_instant(self.episode.now)

    def told_parameters(self) -> NDArray[np.float64]:
        """Return (M, l) [kg, m] as a controller assumes them now, shape (2,)."""
        return self._at_instant(self.episode.told)

    def _at_instant(self, rows: NDArray[np.float64]) -> NDArray[np.float64]:
        found: NDArray[np.float64] = rows[min(self.instant, len(rows) - 1)].copy()
        return found

    def measured(self) -> NDArray[np.float64]:
        """Return (z, phi, z_dot, phi_dot) as measured at this control tick, shape (4,)."""
        now = (self.instant, *mm.read_state(self.addresses))
        if now != self._seen_at:  # filters and differences must see each tick once
            tick = self.instant // self.hold
            seen = sense(self.addresses, self.episode.sensors, self.run, tick)
            self._seen, self._seen_at = np.array(seen), now
        return self._seen.copy()

    def diverged(self) -> bool:
        """Return whether the state exceeds `STATE_LIMIT` or is not finite."""
        return not within_limits(mm.read_state(self.addresses))

    def begin(self, state: Sequence[float]) -> None:
        """Put the plant at t = 0 into `state`, then apply the impulses at that instant.

        state: (z, phi, z_dot, phi_dot) [m, rad, m/s, rad/s].
        """
        self.data.ptr.time = 0.0
        mm.write_state(self.addresses, *(float(x) for x in state))
        self.run, self._seen_at = new_run(), ()
        self.pending[:] = 0.0
        begin_held(self.addresses, self.episode.constants, self.episode.profile, self.run)
        self.forward()

    def reset(self, keyframe_id: int | None = None) -> None:
        """Return to the scenario's initial state, plant included."""
        super().reset(keyframe_id)
        self._model.set_imperfections(self.scenario.imperfections, self.scenario.parameters_at(0.0))
        self.begin(self.scenario.initial_state)

    def forward(self) -> None:
        """Update everything in model and data to this instant and state."""
        mass, length = self.parameters()
        s = self.scenario
        mm.write_parameters(self.addresses, mass, s.pole_mass, length, s.gravity)
        super().forward()

    def step(self, nstep: int = 1) -> None:
        """Advance under the held command, with the plant and the push of each physics step.

        The control in MjData holds the command before the call, and the force that the actuator
        exerts after it. A state that has diverged stays as it is.
        """
        force = self.data.ptr.ctrl[0]
        if not abs(force) < STATE_LIMIT:
            raise InvalidValueError("control", f"must be below {STATE_LIMIT:g} N", f"{force:g} N")
        e = self.episode
        reached = advance_held(
            self.addresses, e.constants, e.profile, e.now, e.actuator, self.run, self.pending,
            self.instant, nstep,
        )  # fmt: skip
        self.data.ptr.time = reached * self._timestep

    def render(self, *args: Any, **settings: Any) -> NDArray[np.uint8]:
        """Return a picture as dm_control does, with forces as arrows; M sets the cart's size."""
        decorated = {"scene_callback": _decorate, **settings}
        if any(settings.get(name) for name in ("depth", "segmentation")):
            decorated = settings
        picture: NDArray[np.uint8] = super().render(*args, **decorated)
        return picture

    def __getstate__(self) -> tuple[Any, ...]:
        vector = self.get_state(mujoco.mjtState.mjSTATE_INTEGRATION)
        memory = (self.run.copy(), self.pending.copy(), self._seen_at)
        seen = self._seen.copy()
        return self.scenario, self._timestep, self._integrator, self.hold, vector, memory, seen

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        scenario, timestep, integrator, hold, vector, memory, seen = state
        self.__init__(scenario, timestep=timestep, integrator=integrator, hold=hold)  # type: ignore[misc]
        self.set_state(vector, mujoco.mjtState.mjSTATE_INTEGRATION)
        self.run, self.pending, self._seen_at = memory
        self._seen = seen
        self.forward()

    def copy(self, share_model: bool = False) -> Physics:
        """Return an independent Physics at the same instant of the same scenario."""
        if share_model:
            raise InvalidValueError("share_model", "must be false: the model changes", True)
        twin = type(self).__new__(type(self))
        twin.__setstate__(self.__getstate__())
        return twin

    def _reload_from_model(self, model: Any) -> None:
        raise InvalidValueError("model", "cannot be replaced: it follows the scenario")


def _decorate(physics: Physics, scene: mujoco.MjvScene) -> None:
    """Draw the cart's mass, the forces on it, the end stops and the marks of the rail near it."""
    mass, _ = physics.parameters()
    z = float(physics.data.ptr.qpos[0])
    i = min(physics.instant, len(physics.episode.profile) - 1)
    show_mass(scene, physics.model.geom("cart").id, float(mass))
    add_marks(scene, marks_near(z), numbered=True)
    add_stops(scene, physics.scenario.rail, float(mass))
    push = float(physics.episode.profile["push"][i])
    add_forces(scene, z, float(mass), float(physics.data.ptr.ctrl[0]), push)
