"""A dm_control Physics whose plant follows a scenario, physics step by physics step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.compiled import kernel, load
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.graphics import choose_backend
from afl_mujoco.scenario.imperfections import IDEAL
from afl_mujoco.scenario.sampling import whole_steps
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation import mujoco_model as mm
from afl_mujoco.simulation.sampled.hardware import (
    RUNNING,
    actuator_of,
    new_run,
    no_commands,
)
from afl_mujoco.simulation.sampled.loop import (
    PROFILE,
    Criterion,
    Plan,
    advance,
    apply_impulse,
    write_plant,
)
from afl_mujoco.simulation.sampled.runs import input_profile
from afl_mujoco.simulation.trajectory import STATE_LIMIT, within_limits

choose_backend()
import mujoco  # noqa: E402  (like dm_control it reads MUJOCO_GL when imported)
from dm_control.mujoco import Physics as DmPhysics  # noqa: E402
from dm_control.mujoco import wrapper  # noqa: E402

_FOREVER = 2**62
"""More steps than any run has: the environment ends an episode, not the loop."""

_IDEAL = actuator_of(IDEAL, 1.0, 1)
_NO_COMMANDS = no_commands(_IDEAL)


@kernel
def _plan(constants, hold):
    """Return the numbers of a control period; built here, for Python would take longer."""
    timestep, pole_mass, gravity = constants
    endless = Criterion(
        fall_angle=np.inf, z=np.inf, phi=np.inf, z_dot=np.inf, phi_dot=np.inf, dwell=0
    )
    return Plan(
        steps=_FOREVER,
        hold=hold,
        timestep=timestep,
        pole_mass=pole_mass,
        gravity=gravity,
        rail=np.inf,
        criterion=endless,
    )


@kernel
def _begin(at, constants, profile, run):
    """Apply what happens at the start of the first step."""
    run.written_mass = np.nan
    write_plant(at, _plan(constants, 1), profile, run, 0)
    apply_impulse(at, profile, 0)


@kernel
def _advance(at, constants, profile, now, run, pending, instant, hold):
    """Take the steps of a control period under the control in MjData; return the instant reached.

    It stops where the state diverges. Else it leaves model and data as they are at that instant,
    with the (M, l) that `now` holds for each.
    """
    plan = _plan(constants, hold)
    if not within_limits(mm.read_state(at)):
        return instant
    run.step, run.status, run.written_mass = instant, RUNNING, np.nan
    write_plant(at, plan, profile, run, instant)
    force = load(at.control)
    advance(at, plan, _IDEAL, profile, run, pending, np.empty((0, 5)), force)
    if not within_limits(mm.read_state(at)):
        return run.step + 1
    i = min(instant + hold, len(now) - 1)
    mm.write_parameters(at, now[i, 0], plan.pole_mass, now[i, 1], plan.gravity)
    mm.mj_forward(at.model, at.data)
    return instant + hold


class Physics(DmPhysics):  # type: ignore[misc]
    """A dm_control Physics whose plant follows a scenario, step by step.

    Between steps model and data belong to the instant ``time()``, ideal impulses at it applied: a
    picture shows the current length. The instant is the whole number of timesteps nearest to
    ``data.time``, so `set_state` with MuJoCo's time in it moves along the schedule too; call
    `forward` after it.

    Parameters
    ----------
    scenario
        What happens to the plant.
    timestep
        Physics step [s], which divides the scenario's duration.
    integrator
        As of `CartPoleModel`.
    """

    def __init__(self, scenario: Scenario, *, timestep: float, integrator: str) -> None:
        scenario.require_ideal()
        self.scenario = scenario
        count = whole_steps("duration", scenario.duration, "timestep", timestep)
        self._profile = np.zeros(count + 1, PROFILE)  # whose last row holds forever
        self._profile[:-1] = input_profile(scenario, timestep, count, count)
        instants = np.arange(count + 1) * timestep
        masses, lengths = scenario.cart_mass(instants), scenario.half_length(instants)
        self._now = np.stack([masses, lengths], axis=1)
        self._profile["cart_mass"][-1], self._profile["half_length"][-1] = self._now[-1]
        self._run = new_run()
        self._constants = (float(timestep), scenario.pole_mass, scenario.gravity)
        self._timestep, self._integrator = timestep, integrator
        self._model = mm.CartPoleModel(
            scenario.parameters_at(0.0), file="scene.xml", timestep=timestep, integrator=integrator
        )
        data = wrapper.MjData(wrapper.MjModel(self._model.mj_model))
        self._model.drive(data.ptr)
        super().__init__(data)
        self.reset()

    @property
    def _instant(self) -> int:
        """Number of steps since t = 0."""
        return round(float(self.data.ptr.time) / self._timestep)

    def parameters(self) -> NDArray[np.float64]:
        """Return (M, l) [kg, m] now, after the jump where there is one, shape (2,)."""
        now: NDArray[np.float64] = self._now[min(self._instant, len(self._now) - 1)]
        return now.copy()

    def diverged(self) -> bool:
        """Return whether the state exceeds `STATE_LIMIT` or is not finite."""
        return not within_limits(mm.read_state(self._model.addresses))

    def begin(self, state: Sequence[float]) -> None:
        """Put the plant at t = 0 into `state`, then apply the impulses there.

        Parameters
        ----------
        state
            (z, phi, z_dot, phi_dot) [m, rad, m/s, rad/s].
        """
        self.data.ptr.time = 0.0
        mm.write_state(self._model.addresses, *(float(x) for x in state))
        _begin(self._model.addresses, self._constants, self._profile, self._run)
        self.forward()

    def reset(self, keyframe_id: int | None = None) -> None:
        """Return to the scenario's initial state, plant included."""
        super().reset(keyframe_id)
        self.begin(self.scenario.initial_state)

    def forward(self) -> None:
        """Make everything in model and data what it is at this instant, for this state."""
        mass, length = self.parameters()
        s = self.scenario
        mm.write_parameters(self._model.addresses, mass, s.pole_mass, length, s.gravity)
        super().forward()

    def step(self, nstep: int = 1) -> None:
        """Advance, the plant and the push those of each physics step, the control held.

        A state that has diverged stays as it is.
        """
        force = self.data.ptr.ctrl[0]
        if not abs(force) < STATE_LIMIT:
            raise InvalidValueError("control", f"must be below {STATE_LIMIT:g} N", f"{force:g} N")
        reached = _advance(
            self._model.addresses, self._constants, self._profile, self._now, self._run,
            _NO_COMMANDS, self._instant, nstep,
        )  # fmt: skip
        self.data.ptr.time = reached * self._timestep

    def __getstate__(self) -> tuple[Any, ...]:
        vector = self.get_state(mujoco.mjtState.mjSTATE_INTEGRATION)
        return self.scenario, self._timestep, self._integrator, vector

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        scenario, timestep, integrator, vector = state
        self.__init__(scenario, timestep=timestep, integrator=integrator)  # type: ignore[misc]
        self.set_state(vector, mujoco.mjtState.mjSTATE_INTEGRATION)
        self.forward()

    def copy(self, share_model: bool = False) -> Physics:
        """Return an independent Physics at the same instant of the same scenario."""
        if share_model:
            raise InvalidValueError("share_model", "must be false, for the model changes", True)
        twin = type(self).__new__(type(self))
        twin.__setstate__(self.__getstate__())
        return twin

    def _reload_from_model(self, model: Any) -> None:
        raise InvalidValueError("model", "cannot be replaced: it follows the scenario")
