"""`afl-mujoco estimation`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from afl_mujoco.cli.terminal import FILMS, SUCCESS, SURVIVAL, ScenarioNames, count_bar, typed

SEEDS, QUICK_SEEDS = 8, 2

INDIFFERENT = ("out", "validation", "films")
"""Options that leave the numbers as they are."""


@dataclass(frozen=True, kw_only=True)
class Estimation:
    """How well M and l are estimated online, and what it costs the loop, against being told.

    Example: afl-mujoco estimation step-step --seeds 2

    The controller is told M, l and the state by an extended Kalman filter that gets the measured
    z and phi and the commanded force. Writes estimation.json and a figure.
    """

    scenarios: ScenarioNames = ()
    """Scenarios of the paper by name; its four schedules by default."""
    controller: str = "adaptive"
    """Controller by name, without -estimated."""
    seeds: int | None = None
    """Runs under noise, each with its own; 8 by default."""
    quick: bool = False
    """2 seeds, where not given otherwise."""
    out: Path = SURVIVAL
    """Folder for the files."""
    validation: Path | None = None
    """Folder of a report, whose page is made anew; renders/validation, unless --out is given."""
    films: Path = FILMS
    """Folder with films.json for that page."""

    def run(self) -> int:
        """Study, write the files, print where they are."""
        from afl_mujoco.cli.survival.ending import finish, require_page
        from afl_mujoco.files import output_folder
        from afl_mujoco.reporting.survival.estimation_figures import draw_estimation
        from afl_mujoco.reporting.survival.study import write_study
        from afl_mujoco.validation.estimation.study import (
            CASES,
            describe,
            require_study,
            study_estimation,
        )

        cases = self.scenarios or CASES
        seeds = self.seeds if self.seeds is not None else QUICK_SEEDS if self.quick else SEEDS
        require_study(self.controller, cases, seeds)
        require_page("estimation", self.out, self.validation, self.films)
        folder = output_folder(self.out)
        with count_bar(len(cases), "estimating") as progress:
            found = study_estimation(self.controller, cases, seeds=seeds, progress=progress)
        files = write_study(
            "estimation",
            describe(found),
            [draw_estimation(found)],
            folder,
            command=typed("estimation", self, INDIFFERENT),
        )
        finish(files, self.out, self.validation, self.films)
        return SUCCESS
