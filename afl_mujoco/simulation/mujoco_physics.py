"""A dm_control Physics whose plant follows a scenario, physics step by physics step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.compiled import kernel, load, store
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.graphics import choose_backend
from afl_mujoco.scenario.sampling import impulses_by_step, whole_steps
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation import mujoco_model as mm
from afl_mujoco.simulation.trajectory import STATE_LIMIT

choose_backend()
import mujoco  # noqa: E402  (like dm_control it reads MUJOCO_GL when imported)
from dm_control.mujoco import Physics as DmPhysics  # noqa: E402
from dm_control.mujoco import wrapper  # noqa: E402

# Columns of a course: M, l and push of the step that starts at an instant, the impulse at that
# instant, and M, l at it.
_M_MIDDLE, _L_MIDDLE, _PUSH, _IMPULSE, _M, _L = range(6)


def _course(scenario: Scenario, timestep: float) -> NDArray[np.float64]:
    """Return what the plant meets at each instant, shape (N + 1, 6); the last row holds forever."""
    count = whole_steps("duration", scenario.duration, "timestep", timestep)
    index = np.arange(count + 1, dtype=np.float64)
    starts, middles = index * timestep, (index[:-1] + 0.5) * timestep
    course = np.zeros((count + 1, 6))
    course[:, _M] = scenario.cart_mass(starts)
    course[:, _L] = scenario.half_length(starts)
    course[:, [_M_MIDDLE, _L_MIDDLE]] = course[:, [_M, _L]]
    course[:-1, _M_MIDDLE] = scenario.cart_mass(middles)
    course[:-1, _L_MIDDLE] = scenario.half_length(middles)
    course[:-1, _PUSH] = scenario.pushes(middles)
    course[:-1, _IMPULSE] = impulses_by_step(scenario, starts)
    return course


@kernel
def _arrive(at, row, constants):
    """Apply the ideal impulse of an instant, with the parameters of the step that starts there."""
    pole_mass, gravity = constants
    if row[_IMPULSE] != 0.0:
        force = load(at[mm.CONTROL])
        mm.write_parameters(at, row[_M_MIDDLE], pole_mass, row[_L_MIDDLE], gravity)
        z, phi = load(at[mm.Z]), load(at[mm.PHI])
        z_dot, phi_dot = load(at[mm.Z_DOT]), load(at[mm.PHI_DOT])
        jump = mm.strike(at, z, phi, z_dot, phi_dot, row[_IMPULSE])
        mm.write_state(at, z, phi, z_dot + jump[0], phi_dot + jump[1])
        store(at[mm.CONTROL], force)


@kernel
def _within_limits(at):
    """Return whether the state has not diverged."""
    return (
        abs(load(at[mm.Z])) < STATE_LIMIT
        and abs(load(at[mm.PHI])) < STATE_LIMIT
        and abs(load(at[mm.Z_DOT])) < STATE_LIMIT
        and abs(load(at[mm.PHI_DOT])) < STATE_LIMIT
    )


@kernel
def _advance(at, course, constants, first, count):
    """Take `count` steps from instant `first` on and return the instant reached.

    It stops where the state diverges. Else it leaves model and data as they are at that instant.
    """
    pole_mass, gravity = constants
    last = len(course) - 1
    written = (np.nan, np.nan)
    for k in range(first, first + count):
        if not _within_limits(at):
            return k
        row = course[min(k, last)]
        wanted = (row[_M_MIDDLE], row[_L_MIDDLE])
        if wanted != written:
            mm.write_parameters(at, wanted[0], pole_mass, wanted[1], gravity)
            written = wanted
        store(at[mm.PUSH], row[_PUSH])
        mm.mj_step(at[mm.MODEL], at[mm.DATA])
        if course[min(k + 1, last), _IMPULSE] != 0.0:
            _arrive(at, course[min(k + 1, last)], constants)
            written = (np.nan, np.nan)
    if _within_limits(at):
        row = course[min(first + count, last)]
        mm.write_parameters(at, row[_M], pole_mass, row[_L], gravity)
        mm.mj_forward(at[mm.MODEL], at[mm.DATA])
    return first + count


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
        self._course = _course(scenario, timestep)
        self._constants = (scenario.pole_mass, scenario.gravity)
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

    def _now(self) -> NDArray[np.float64]:
        """Return the row of the course that starts now, shape (6,)."""
        row: NDArray[np.float64] = self._course[min(self._instant, len(self._course) - 1)]
        return row

    def parameters(self) -> NDArray[np.float64]:
        """Return (M, l) [kg, m] now, after the jump where there is one, shape (2,)."""
        return self._now()[[_M, _L]]

    def diverged(self) -> bool:
        """Return whether the state exceeds `STATE_LIMIT` or is not finite."""
        return not _within_limits(self._model.addresses)

    def begin(self, state: Sequence[float]) -> None:
        """Put the plant at t = 0 into `state`, then apply the impulses that strike there.

        Parameters
        ----------
        state
            (z, phi, z_dot, phi_dot) [m, rad, m/s, rad/s].
        """
        self.data.ptr.time = 0.0
        mm.write_state(self._model.addresses, *(float(x) for x in state))
        _arrive(self._model.addresses, self._now(), self._constants)
        self.forward()

    def reset(self, keyframe_id: int | None = None) -> None:
        """Return to the scenario's initial state, plant included.

        Parameters
        ----------
        keyframe_id
            For dm_control; the model has no keyframes.
        """
        super().reset(keyframe_id)
        self.begin(self.scenario.initial_state)

    def forward(self) -> None:
        """Make everything in model and data what it is at this instant, for this state."""
        row, (pole_mass, gravity) = self._now(), self._constants
        mm.write_parameters(self._model.addresses, row[_M], pole_mass, row[_L], gravity)
        super().forward()

    def step(self, nstep: int = 1) -> None:
        """Advance, the plant and the push those of each physics step, the control held.

        A state that has diverged stays as it is.

        Parameters
        ----------
        nstep
            Number of physics steps.

        Raises
        ------
        InvalidValueError
            If the control is not finite.
        """
        force = self.data.ptr.ctrl[0]
        if not abs(force) < STATE_LIMIT:
            raise InvalidValueError("control", f"must be below {STATE_LIMIT:g} N", f"{force:g} N")
        reached = _advance(
            self._model.addresses, self._course, self._constants, self._instant, nstep
        )
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
        """Return an independent Physics at the same instant of the same scenario.

        Parameters
        ----------
        share_model
            Must be false: each changes its model as it goes.
        """
        if share_model:
            raise InvalidValueError("share_model", "must be false, for the model changes", True)
        twin = type(self).__new__(type(self))
        twin.__setstate__(self.__getstate__())
        return twin

    def _reload_from_model(self, model: Any) -> None:
        raise InvalidValueError("model", "cannot be replaced: it follows the scenario")
