"""`afl-mujoco view`."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Annotated

import tyro

from afl_mujoco.cli.simulate import Name
from afl_mujoco.cli.terminal import SUCCESS, CallLimit
from afl_mujoco.control.names import KNOWN, SUBJECT
from afl_mujoco.errors import InvalidValueError

FRAMES_A_SECOND = 60


@dataclass(frozen=True, kw_only=True)
class View:
    """Show a run in MuJoCo's interactive viewer, in real time, until the window is closed.

    Example: afl-mujoco view step-step-impulse --controller adaptive
    """

    scenario: Name = "step-step-impulse"
    """Scenario by name, or a TOML file."""
    controller: Annotated[str, tyro.conf.arg(help=f"Controller by name: {KNOWN}")] = SUBJECT
    timestep: float | None = None
    """Physics step of MuJoCo [s]; by default the longest up to 0.001 that divides the control
    period."""
    control_period: float | None = None
    """How long the force is held [s], a multiple of the timestep; by default that of the
    scenario, else one step."""
    integrator: str = "RK4"
    """MuJoCo's integrator: RK4, Euler, implicit, implicitfast."""
    call_limit: CallLimit = None
    speed: float = 1.0
    """Seconds of the run that are shown per second."""

    def run(self) -> int:
        """Run the simulation, then show it."""
        from afl_mujoco.control.catalogue import find_controller
        from afl_mujoco.graphics import require_display
        from afl_mujoco.scenario.files import find_scenario

        scenario = find_scenario(self.scenario)
        controller = find_controller(self.controller)
        if not 0.0 < self.speed < float("inf"):
            raise InvalidValueError("speed", "must be positive and finite", self.speed)
        require_display()
        os.environ["MUJOCO_GL"] = "glfw"

        from afl_mujoco.films.replay import Deployment, record
        from afl_mujoco.films.viewer import view
        from afl_mujoco.simulation.mujoco_model import CartPoleModel

        deployment = Deployment(
            timestep=self.timestep, control_period=self.control_period, integrator=self.integrator
        )
        replay = record(scenario, controller, deployment, FRAMES_A_SECOND)
        view(replay, CartPoleModel(scenario.parameters_at(0.0), file="scene.xml"), self.speed)
        return SUCCESS
