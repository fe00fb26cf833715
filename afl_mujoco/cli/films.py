"""`afl-mujoco render` and `afl-mujoco view`."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from afl_mujoco.cli.simulate import Name
from afl_mujoco.cli.terminal import FILMS, SUCCESS, CallLimit, count_bar, say, separated, typed
from afl_mujoco.control.names import KNOWN, PAPER, SUBJECT
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.studies.contract import ControllerNames, ScenarioNames

if TYPE_CHECKING:
    from afl_mujoco.films.replay import Deployment

INDIFFERENT = ("out", "workers")
"""Options that do not change the films."""

FRAMES_A_SECOND = 60
"""Frames of a view per second."""


@dataclass(frozen=True, kw_only=True)
class _Deployed:
    """How a controller is deployed in the runs that are shown."""

    timestep: float | None = None
    """Physics step of MuJoCo [s]; by default the longest up to 0.001 that divides the control
    period."""
    control_period: float | None = None
    """How long the force is held [s], a multiple of the timestep; by default that of the
    scenario, else one step."""
    integrator: str = "RK4"
    """MuJoCo's integrator: RK4, Euler, implicit, implicitfast."""
    call_limit: CallLimit = None

    @property
    def deployment(self) -> Deployment:
        from afl_mujoco.films.replay import Deployment

        return Deployment(
            timestep=self.timestep, control_period=self.control_period, integrator=self.integrator
        )


@dataclass(frozen=True, kw_only=True)
class Render(_Deployed):
    """Film runs in MuJoCo with the ideal equations as a ghost, without a display.

    Example: afl-mujoco render step-step-impulse --controllers fixed,adaptive --size 1280x720

    Writes one MP4 for each scenario and controller, and one of up to four controllers side by
    side. Also writes films.json, from which `afl-mujoco report` takes them.
    """

    scenarios: ScenarioNames = ()
    """Scenarios by name, or TOML files; all nine of the paper by default."""
    controllers: ControllerNames = PAPER
    size: str = "1280x720"
    """Width x height in pixels, even, at most 1920x1080."""
    fps: int = 30
    """Frames per second."""
    still: float | None = None
    """Write the frame at this time [s] as a PNG, instead of each film."""
    workers: int = min(2, os.cpu_count() or 1)
    """Number of processes that share the films."""
    out: Path = FILMS
    """Folder for the films."""

    def run(self) -> int:
        """Make the films, or the stills."""
        from afl_mujoco.control.catalogue import find_controller
        from afl_mujoco.files import output_folder
        from afl_mujoco.graphics import require_backend
        from afl_mujoco.scenario.catalogue import SCENARIOS
        from afl_mujoco.scenario.files import find_scenario

        # What is quick to check comes before what is slow to import, the backend before MuJoCo.
        scenarios = [find_scenario(name) for name in self.scenarios or SCENARIOS]
        controllers = [find_controller(name) for name in separated(self.controllers)]
        if not (found := re.fullmatch(r"(\d{1,6})x(\d{1,6})", self.size)):
            raise InvalidValueError("size", "must be WIDTHxHEIGHT, such as 1280x720", self.size)
        require_backend()

        from afl_mujoco.films.video import make_films, plan, write_stills

        films = plan(
            scenarios,
            controllers,
            self.deployment,
            size=(int(found[1]), int(found[2])),
            fps=self.fps,
            command=typed("render", self, INDIFFERENT),
        )
        folder = output_folder(self.out)
        if self.still is not None:
            files = write_stills(films, self.still, folder)
        else:
            with count_bar(len(films), "filming") as progress:
                files = make_films(films, folder, workers=self.workers, progress=progress)
        say(*(f"wrote {file}" for file in files))
        return SUCCESS


@dataclass(frozen=True, kw_only=True)
class View(_Deployed):
    """Show a run in MuJoCo's interactive viewer, in real time, until the window is closed.

    Example: afl-mujoco view step-step-impulse --controller adaptive
    """

    scenario: Name = "step-step-impulse"
    """Scenario by name, or a TOML file."""
    controller: Annotated[str, tyro.conf.arg(help=f"Controller by name: {KNOWN}")] = SUBJECT
    speed: float = 1.0
    """Seconds of the run that are shown per second."""

    def run(self) -> int:
        """Run the simulation, then show it."""
        from afl_mujoco.control.catalogue import find_controller
        from afl_mujoco.graphics import require_display
        from afl_mujoco.scenario.files import find_scenario

        scenario, controller = find_scenario(self.scenario), find_controller(self.controller)
        if not 0.0 < self.speed < float("inf"):
            raise InvalidValueError("speed", "must be positive and finite", self.speed)
        require_display()
        os.environ["MUJOCO_GL"] = "glfw"

        from afl_mujoco.films.replay import record
        from afl_mujoco.films.scene import view

        view(record(scenario, controller, self.deployment, FRAMES_A_SECOND), self.speed)
        return SUCCESS
