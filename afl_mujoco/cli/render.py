"""`afl-mujoco render`."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path

from afl_mujoco.cli.terminal import FILMS, SUCCESS, CallLimit, count_bar, say, separated, typed
from afl_mujoco.control.names import PAPER
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.studies.contract import ControllerNames, ScenarioNames

INDIFFERENT = ("out", "workers")
"""Options that do not change the films."""

SHOWCASE = ("step-step", "step-trapezoid", "trapezoid-step", "trapezoid-trapezoid")


@dataclass(frozen=True, kw_only=True)
class Render:
    """Film runs in MuJoCo with the ideal equations as a ghost, without a display.

    Example: afl-mujoco render step-step-impulse --controllers fixed,adaptive --size 1280x720

    Writes one MP4 for each scenario and controller, one of up to four controllers side by side
    and, if no scenario is named, a showcase of the paper's four cases. Also writes films.json,
    from which `afl-mujoco report` takes them.
    """

    scenarios: ScenarioNames = ()
    """Scenarios by name, or TOML files; all nine of the paper and the showcase by default."""
    controllers: ControllerNames = PAPER
    size: str = "1280x720"
    """Width x height in pixels, even, at most 1920x1080."""
    fps: int = 30
    """Frames per second."""
    timestep: float | None = None
    """Physics step of MuJoCo [s]; by default the longest up to 0.001 that divides the control
    period."""
    control_period: float | None = None
    """How long the force is held [s], a multiple of the timestep; by default that of the
    scenario, else one step."""
    integrator: str = "RK4"
    """MuJoCo's integrator: RK4, Euler, implicit, implicitfast."""
    call_limit: CallLimit = None
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
        names = separated(self.controllers)
        controllers = [find_controller(name) for name in names]
        size = self._size()
        require_backend()

        from afl_mujoco.films.plan import plan
        from afl_mujoco.films.renderer import make_films, write_stills
        from afl_mujoco.films.replay import Deployment

        deployment = Deployment(
            timestep=self.timestep, control_period=self.control_period, integrator=self.integrator
        )
        cases = () if self.scenarios else [SCENARIOS[f"{name}-impulse"] for name in SHOWCASE]
        films = plan(
            scenarios,
            controllers,
            cases,
            deployment=deployment,
            size=size,
            fps=self.fps,
            command=typed("render", self, INDIFFERENT),
        )
        folder = output_folder(self.out)
        if self.still is not None:
            files = write_stills(films, self.still, folder)
        else:
            with count_bar(sum(film.frames for film in films), "filming") as progress:
                files = make_films(films, folder, workers=self.workers, progress=progress)
        say(*(f"wrote {file}" for file in files))
        return SUCCESS

    def _size(self) -> tuple[int, int]:
        """Return width and height."""
        if not (found := re.fullmatch(r"(\d{1,6})x(\d{1,6})", self.size)):
            raise InvalidValueError("size", "must be WIDTHxHEIGHT, such as 1280x720", self.size)
        return int(found[1]), int(found[2])
