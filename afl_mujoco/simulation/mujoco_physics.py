"""A dm_control Physics whose plant follows a scenario in every physics step."""

from __future__ import annotations

from typing import Any, NoReturn

from afl_mujoco.errors import InvalidValueError, MissingPackageError
from afl_mujoco.graphics import choose_backend
from afl_mujoco.plants.plant import Floats
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.decor import drawn_model
from afl_mujoco.simulation.sampled.episode import World
from afl_mujoco.simulation.trajectory import STATE_LIMIT, within_limits

choose_backend()

try:
    from dm_control.mujoco import Physics as DmPhysics
    from dm_control.mujoco import wrapper
except ModuleNotFoundError as error:  # beyond Python 3.12 pip cannot install it with the rest
    rule = "must be installed: pip install --no-deps 'dm-control>=1.0.50,<1.1'"
    raise MissingPackageError(str(error.name), rule) from None


class Physics(DmPhysics):  # type: ignore[misc]
    """A dm_control Physics whose plant follows a scenario, step by step, with its imperfections.

    Between steps model and data belong to the instant ``time()``, after its ideal impulses: a
    picture shows the current length. The instant is the whole number of timesteps nearest to
    ``data.time``, so `set_state` with MuJoCo's time in it moves along the schedule too; call
    `forward` after it. The state of the hardware, such as delayed commands, is not part of MuJoCo's
    state: `set_state` does not change it.

    timestep: Physics step [s]; the last ends at the scenario's duration, though ``time()`` counts
    whole ones.
    """

    def __init__(
        self, scenario: Scenario, *, timestep: float, integrator: str, hold: int = 1
    ) -> None:
        self._seen_at: tuple[int, bytes] | None = None
        self._model = drawn_model(scenario, timestep=timestep, integrator=integrator)
        self.world = World(self._model, timestep, hold)
        self.world.follow(scenario)
        data = wrapper.MjData(wrapper.MjModel(self._model.mj_model))
        self._model.drive(data.ptr)
        super().__init__(data)
        self.reset()

    @property
    def scenario(self) -> Scenario:
        """The scenario that it follows."""
        return self.world.scenario

    @property
    def instant(self) -> int:
        """Number of steps since t = 0."""
        return round(float(self.data.ptr.time) / self.world.timestep)

    def measured(self) -> Floats:
        """Return the state as measured at this control tick, shape (2 n,)."""
        now = (self.instant, self.world.state.tobytes())
        if now != self._seen_at:  # filters and differences must see each tick once
            self.world.measured(self.instant)
            self._seen_at = now
        return self.world.run.measured.copy()

    def diverged(self) -> bool:
        """Return whether the state exceeds `STATE_LIMIT` or is not finite."""
        return not within_limits(self.world.state)

    def begin(self) -> None:
        """Put the plant at t = 0 into its initial state, then apply the impulses there."""
        self.data.ptr.time = 0.0
        self._seen_at = None
        with self.check_invalid_state():
            self.world.begin()

    def reset(self, keyframe_id: int | None = None) -> None:
        """Return to the scenario's initial state, plant included."""
        super().reset(keyframe_id)
        self._model.set_imperfections(self.scenario.imperfections)
        self.begin()

    def forward(self) -> None:
        """Update everything in model and data to this instant and state."""
        with self.check_invalid_state():
            self.world.write_at(self.instant)

    def step(self, nstep: int = 1) -> None:
        """Advance under the commands in MjData, which then holds what the drives exert."""
        for name, force in zip(self.scenario.plant.inputs, self.data.ptr.ctrl, strict=True):
            if not abs(force) < STATE_LIMIT:
                unit = f" {self.scenario.plant.units[name]}".rstrip()
                rule = f"must be below {STATE_LIMIT:g}{unit}"
                raise InvalidValueError("control", rule, f"{force:g}{unit}")
        self.data.ptr.time = self.world.advance(self.instant, nstep) * self.world.timestep

    def copy(self, share_model: bool = False) -> NoReturn:
        """Raise: the state of the hardware is not part of MuJoCo's, and the model changes."""
        raise InvalidValueError("Physics", "cannot be copied: load the scenario again")

    __getstate__ = copy

    def _reload_from_model(self, model: Any) -> None:
        raise InvalidValueError("model", "cannot be replaced: it follows the scenario")
