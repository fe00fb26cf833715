"""`afl-mujoco attraction`."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from afl_mujoco.cli.terminal import FILMS, SUCCESS, SURVIVAL, count_bar, typed

if TYPE_CHECKING:
    from afl_mujoco.control.law import Law
    from afl_mujoco.simulation.attraction.cells import Cells, Settling
    from afl_mujoco.validation.attraction.comparison import Comparison

GRID, QUICK_GRID = 101, 21

INDIFFERENT = ("out", "validation", "films", "threads")
"""Options that leave the numbers as they are."""


@dataclass(frozen=True, kw_only=True)
class Attraction:
    """Map from where each controller settles: by the equations, in MuJoCo, where they disagree.

    Example: afl-mujoco attraction --controllers adaptive lqr --quick

    One map over (phi0, phi0') on one plant, one over (M, l) from one start. Writes attraction.json,
    an npz for each map, and a figure for each plane. The whole takes some ten minutes on two
    cores.
    """

    controllers: tuple[str, ...] = ("adaptive", "lqr")
    """Controllers by name; not a law in Python, nor one told by the estimator."""
    planes: tuple[str, ...] = ("states", "plants")
    """Maps to draw: states, plants."""
    grid: int | None = None
    """Cells along each axis; 101 by default."""
    quick: bool = False
    """21 cells along each axis, where not given otherwise."""
    mass: float = 1.0
    """Cart mass M of the map over states [kg]."""
    length: float = 0.5
    """Half-length l of the map over states [m]."""
    max_angle: float = 1.55
    """The map over states reaches from minus this to this phi0 [rad]."""
    max_rate: float = 10.0
    """The map over states reaches from minus this to this phi0' [rad/s]."""
    masses: tuple[float, float] = (0.1, 2.0)
    """Edges of the map over plants: M [kg]."""
    lengths: tuple[float, float] = (0.05, 1.0)
    """Edges of the map over plants: l [m]."""
    start_angle: float = -math.pi / 3.0
    """phi0 of the map over plants [rad]."""
    horizon: float = 20.0
    """When a rollout that has neither settled nor fallen ends as undecided [s]."""
    timestep: float = 2e-3
    """MuJoCo's physics step, over which the control is held [s]."""
    integrator: str = "RK4"
    """MuJoCo's integrator: RK4, Euler, implicit, implicitfast."""
    gain_labels: str = "table2"
    """Reading of the paper's gain columns K and Phi: table2 or table1 (decision D2)."""
    threads: int = min(2, os.cpu_count() or 1)
    """Threads to share the rollouts among; the numbers do not depend on it."""
    out: Path = SURVIVAL
    """Folder for the files."""
    validation: Path | None = None
    """Folder of a report, whose page is made anew; renders/validation, unless --out is given."""
    films: Path = FILMS
    """Folder with films.json, for the page."""

    def run(self) -> int:
        """Make the maps, write and print them."""
        controllers, maps, settling = self._request()  # what is quick to check comes first

        import sys

        from rich.console import Console

        from afl_mujoco.cli.survival.ending import finish, require_page
        from afl_mujoco.files import output_folder
        from afl_mujoco.reporting.survival.attraction_figures import attraction_figures
        from afl_mujoco.reporting.survival.attraction_table import print_attraction
        from afl_mujoco.reporting.survival.study import remove_study, write_study
        from afl_mujoco.validation.attraction.files import save_comparisons

        require_page("attraction", self.out, self.validation, self.films)
        folder = output_folder(self.out)
        rollouts = 2 * len(controllers) * sum(len(cells.starts) for cells in maps)
        with count_bar(rollouts, "mapping") as progress:
            found = self._compare(controllers, maps, settling, progress)
        remove_study("attraction", folder)
        maps_of = save_comparisons(found, folder)
        content = {"maps": [comparison.to_dict() for comparison in found]}
        command = typed("attraction", self, INDIFFERENT, positional=False)
        drawn = attraction_figures(found)
        files = write_study("attraction", content, drawn, folder, command=command, files=maps_of)
        print_attraction(found, Console(width=None if sys.stdout.isatty() else 140))
        finish(files, self.out, self.validation, self.films)
        return SUCCESS

    def _request(self) -> tuple[list[Law], list[Cells], Settling]:
        """Return laws, cells and criterion, or raise at what breaks a rule."""
        from afl_mujoco.control.controllers import find_controller
        from afl_mujoco.errors import UnknownNameError
        from afl_mujoco.execution.threads import require_threads
        from afl_mujoco.scenario.parameters import require_distinct
        from afl_mujoco.scenario.sampling import whole_steps
        from afl_mujoco.simulation.attraction.cells import Settling
        from afl_mujoco.simulation.mujoco_model import INTEGRATORS

        require_distinct("controller", self.controllers)
        require_distinct("plane", self.planes)
        controllers = [find_controller(name, self.gain_labels) for name in self.controllers]
        maps = [self._cells(plane) for plane in self.planes]
        settling = Settling(horizon=self.horizon)
        for name, time in (("dwell", settling.dwell), ("horizon", settling.horizon)):
            whole_steps(name, time, "timestep", self.timestep)
        if self.integrator not in INTEGRATORS:
            raise UnknownNameError.among("integrator", self.integrator, INTEGRATORS)
        require_threads(self.threads)
        for controller in controllers:
            _ = controller.compiled  # raises if it is written in Python
            for cells in maps:  # raises if a gain is not positive
                masses, lengths = cells.plants.T
                controller.law_inputs(masses, lengths, cells.pole_mass, cells.gravity)
        return controllers, maps, settling

    def _cells(self, plane: str) -> Cells:
        """Return the cells of a plane."""
        from afl_mujoco.errors import UnknownNameError
        from afl_mujoco.simulation.attraction.cells import (
            PLANES,
            STATES,
            axis,
            plant_cells,
            state_cells,
        )

        if plane not in PLANES:
            raise UnknownNameError.among("plane", plane, PLANES)
        count = self.grid if self.grid is not None else QUICK_GRID if self.quick else GRID
        if plane == STATES:
            return state_cells(
                axis("max_angle", -self.max_angle, self.max_angle, count),
                axis("max_rate", -self.max_rate, self.max_rate, count),
                cart_mass=self.mass,
                half_length=self.length,
            )
        return plant_cells(
            axis("masses", *self.masses, count),
            axis("lengths", *self.lengths, count),
            start=(0.0, self.start_angle, 0.0, 0.0),
        )

    def _compare(
        self,
        controllers: list[Law],
        maps: list[Cells],
        settling: Settling,
        progress: Callable[[int], None],
    ) -> list[Comparison]:
        """Return each law on each map, by the equations and in MuJoCo."""
        from afl_mujoco.simulation.attraction.mujoco_map import map_in_mujoco
        from afl_mujoco.simulation.attraction.ode_map import map_by_ode
        from afl_mujoco.validation.attraction.comparison import Comparison

        done = 0

        def advance(cells: int) -> None:
            nonlocal done
            done += cells
            progress(done)

        shared: Any = {"settling": settling, "threads": self.threads, "progress": advance}
        engine: Any = shared | {"timestep": self.timestep, "integrator": self.integrator}
        return [
            Comparison(
                map_by_ode(cells, controller, **shared),
                map_in_mujoco(cells, controller, **engine),
            )
            for cells in maps
            for controller in controllers
        ]
