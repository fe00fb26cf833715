"""`afl-mujoco margins`."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from afl_mujoco.cli.terminal import FILMS, SUCCESS, SURVIVAL, count_bar, typed

if TYPE_CHECKING:
    from afl_mujoco.control.law import Law

QUICK = 4
"""Of how many M and l one is looked at in haste."""

INDIFFERENT = ("out", "validation", "films", "workers")
"""Options that leave the numbers as they are."""


@dataclass(frozen=True, kw_only=True)
class Margins:
    """Gain, phase, disk and delay margins of each controller at upright, over a grid of plants.

    Example: afl-mujoco margins --controllers fixed lqr --control-period 0.005

    The loop is linearised by finite differences on MuJoCo; on six of the plants the delay at which
    a small motion in MuJoCo grows is measured as well. Writes margins.json and figures.
    """

    controllers: tuple[str, ...] = (
        "fixed",
        "adaptive",
        "fixed-retuned",
        "adaptive-retuned",
        "lqr",
        "pole-placement",
        "partial-linearization",
    )
    """Controllers by name, or a law in Python, my_module:my_law."""
    cart_masses: tuple[float, ...] | None = None
    """Cart masses M of the grid [kg]; the paper's 20 by default."""
    half_lengths: tuple[float, ...] | None = None
    """Half-lengths l of the grid [m]; the paper's 20 by default."""
    control_period: float = 1e-3
    """How long the sampled loop holds the force [s]."""
    workers: int = min(2, os.cpu_count() or 1)
    """Processes to share the work among; the numbers do not depend on it."""
    quick: bool = False
    """Every fourth M and l of the paper where not given otherwise, and two plants measured."""
    measure: bool = True
    """Measure on six plants of the grid what delay MuJoCo bears."""
    out: Path = SURVIVAL
    """Folder for the files."""
    validation: Path | None = None
    """Folder of a report, whose page is made anew; renders/validation, unless --out is given."""
    films: Path = FILMS
    """Folder with films.json, for the page."""

    def run(self) -> int:
        """Survey the margins, write and print them."""
        from rich.console import Console

        from afl_mujoco.cli.survival.ending import finish, require_page
        from afl_mujoco.control.baselines.design import CART_MASSES, HALF_LENGTHS
        from afl_mujoco.control.controllers import find_controller
        from afl_mujoco.control.estimation.estimated_law import refuse_estimated
        from afl_mujoco.files import output_folder
        from afl_mujoco.reporting.page.survival.tables import measured_text
        from afl_mujoco.reporting.survival.margins_figures import draw_margins
        from afl_mujoco.reporting.survival.margins_table import print_margins
        from afl_mujoco.reporting.survival.study import write_study
        from afl_mujoco.validation.margins.survey import require_survey, survey_margins

        controllers = [find_controller(name) for name in self.controllers]
        refuse_estimated(controllers)
        every = QUICK if self.quick else 1
        masses = self.cart_masses or CART_MASSES[::every]
        lengths = self.half_lengths or HALF_LENGTHS[::every]
        require_survey(controllers, masses, lengths, self.control_period, self.workers)
        require_page("margins", self.out, self.validation, self.films)
        folder = output_folder(self.out)
        with count_bar(len(controllers) * len(masses), "linearising") as progress:
            survey = survey_margins(
                controllers,
                cart_masses=masses,
                half_lengths=lengths,
                control_period=self.control_period,
                workers=self.workers,
                progress=progress,
            )
        content = {**survey.to_dict(), "measured": self._measure(controllers, masses, lengths)}
        command = typed("margins", self, INDIFFERENT, positional=False)
        files = write_study("margins", content, draw_margins(content), folder, command=command)
        print_margins(survey, Console(width=None if sys.stdout.isatty() else 140))
        if said := measured_text(content):
            print(said)
        finish(files, self.out, self.validation, self.films)
        return SUCCESS

    def _measure(
        self, controllers: Sequence[Law], masses: Sequence[float], lengths: Sequence[float]
    ) -> list[dict[str, Any]]:
        """Return margin and measurement of each law on some plants of the grid."""
        from afl_mujoco.validation.margins.delay import compare_delays, measured_plants

        if not self.measure:
            return []
        plants = measured_plants(masses, lengths, few=self.quick)
        with count_bar(len(controllers) * len(plants), "measuring") as progress:
            found = compare_delays(
                controllers,
                plants,
                control_period=self.control_period,
                workers=self.workers,
                progress=progress,
            )
        return [comparison.to_dict() for comparison in found]
