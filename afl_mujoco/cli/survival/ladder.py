"""`afl-mujoco ladder`."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from afl_mujoco.cli.terminal import FILMS, SUCCESS, SURVIVAL, ScenarioNames, count_bar, typed

if TYPE_CHECKING:
    from afl_mujoco.scenario.scenario import Scenario
    from afl_mujoco.validation.ladder.climb import Settings

SCENARIO = "step-step"

INDIFFERENT = ("out", "validation", "films", "workers", "cluster")
"""Options that leave the numbers as they are."""

CAREFUL, QUICK = (4, 13, 0.02), (2, 7, 0.2)
"""Seeds, levels of the scan and tolerance, where not given otherwise."""


@dataclass(frozen=True, kw_only=True)
class Ladder:
    """Find how much delay, noise, friction and so on each controller survives in MuJoCo.

    Example: afl-mujoco ladder step-step --controllers adaptive lqr --rungs delay noise --quick

    Each rung departs from the ideal in one way, in MuJoCo. Written are what a good laboratory rig
    would do, and by bisection the level from which the pole falls, the run diverges or the cart
    reaches an end stop; then all together. Writes ladder.json and figures. The whole takes some
    ten minutes on two cores.
    """

    scenarios: ScenarioNames = ()
    """Scenarios by name, or TOML files: each level must be survived in all of them; step-step by
    default."""
    controllers: tuple[str, ...] = (
        "fixed",
        "adaptive",
        "fixed-retuned",
        "adaptive-retuned",
        "adaptive-nominal",
        "adaptive-estimated",
        "lqr",
        "pole-placement",
        "partial-linearization",
    )
    """Controllers by name, or module:function of your own."""
    rungs: tuple[str, ...] = ()
    """Rungs by name; all, and all of them together, by default."""
    seeds: int | None = None
    """Seeds of the noise, all of which must be survived; 4 by default."""
    scan: int | None = None
    """Levels of the scan before bisection; 13 by default."""
    tolerance: float | None = None
    """Relative width to which bisection narrows a threshold; 0.02 by default."""
    quick: bool = False
    """2 seeds, 7 levels and a tolerance of 0.2, where not given otherwise."""
    integrator: str = "RK4"
    """MuJoCo's integrator: RK4, Euler, implicit, implicitfast."""
    gain_labels: str = "table2"
    """Reading of the paper's gain columns K and Phi: table2 or table1 (decision D2)."""
    workers: int = min(2, os.cpu_count() or 1)
    """Processes to share the work among; the numbers do not depend on it."""
    cluster: str | None = None
    """Address of a Dask scheduler, tcp://host:port, whose workers share it instead."""
    out: Path = SURVIVAL
    """Folder for the files."""
    validation: Path | None = None
    """Folder of a report, whose page is made anew; renders/validation, unless --out is given."""
    films: Path = FILMS
    """Folder with films.json, for the page."""

    def run(self) -> int:
        """Climb, write and print."""
        from afl_mujoco.scenario.files import find_scenario

        # What is quick to check comes before what is slow to import.
        scenarios = tuple(find_scenario(name) for name in self.scenarios or (SCENARIO,))

        from rich.console import Console

        from afl_mujoco.cli.survival.ending import finish, require_page
        from afl_mujoco.control.controllers import find_controller
        from afl_mujoco.files import output_folder
        from afl_mujoco.reporting.survival.ladder.figures import draw_ladder
        from afl_mujoco.reporting.survival.ladder.table import print_ladder
        from afl_mujoco.reporting.survival.study import write_study
        from afl_mujoco.validation.ladder.ladder import (
            require_climbable,
            run_ladder,
            unit_count,
        )

        controllers = [find_controller(name, self.gain_labels) for name in self.controllers]
        settings = self._settings(scenarios)
        require_climbable(controllers, settings, self.rungs, self.workers)
        require_page("ladder", self.out, self.validation, self.films)
        folder = output_folder(self.out)
        with count_bar(unit_count(controllers, self.rungs), "climbing") as progress:
            found = run_ladder(
                controllers,
                settings,
                self.rungs,
                workers=self.workers,
                cluster=self.cluster,
                progress=progress,
            )
        content = found.to_dict()
        command = typed("ladder", self, INDIFFERENT)
        files = write_study("ladder", content, draw_ladder(content), folder, command=command)
        print_ladder(content, Console(width=None if sys.stdout.isatty() else 160))
        finish(files, self.out, self.validation, self.films)
        return SUCCESS

    def _settings(self, scenarios: tuple[Scenario, ...]) -> Settings:
        """Return how the ladder is climbed."""
        from afl_mujoco.validation.ladder.climb import Settings

        seeds, scan, tolerance = QUICK if self.quick else CAREFUL
        return Settings(
            scenarios=scenarios,
            seeds=seeds if self.seeds is None else self.seeds,
            scan=scan if self.scan is None else self.scan,
            tolerance=tolerance if self.tolerance is None else self.tolerance,
            integrator=self.integrator,
        )
