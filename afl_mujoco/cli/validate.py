"""`afl-mujoco validate`."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from afl_mujoco.cli.terminal import (
    CHECK_FAILED,
    FILMS,
    ROBUSTNESS,
    SUCCESS,
    VALIDATION,
    ScenarioNames,
    progress_bar,
    separated,
    typed,
)

if TYPE_CHECKING:
    from afl_mujoco.document.blocks import Section
    from afl_mujoco.execution.executors import Executor
    from afl_mujoco.reporting.page.inputs.films import Film
    from afl_mujoco.studies.verification.campaign import Report

INDIFFERENT = ("out", "films", "robustness", "page", "workers")
"""Options that leave the numbers as they are, and so are no part of what reproduces them."""


@dataclass(frozen=True, kw_only=True)
class Validate:
    """Compare MuJoCo with the analytic model and give a verdict.

    Example: afl-mujoco validate step-step my-scenario.toml --controllers fixed adaptive

    Writes report.html, which needs no other file; report.json, report.md, junit.xml, curves.npz and
    figures. Exit code 0 if every check holds, 1 if one fails.
    """

    scenarios: ScenarioNames = ()
    """Scenarios by name, or TOML files; all nine of the paper by default."""
    controllers: tuple[str, ...] = ("fixed", "adaptive")
    """Controllers by name, as of `afl-mujoco simulate --help` but for -estimated; or your own,
    module:attribute (examples/README.md)."""
    gain_labels: str = "table2"
    """Reading of the paper's gain columns K and Phi: table2 or table1 (decision D2)."""
    full: bool = False
    """Add refinement studies, ledgers, a second method, and what the paper's physics leaves out."""
    timestep: float = 1e-3
    """Physics step of MuJoCo [s]."""
    control_period: float | None = None
    """How long sampled mode holds the force [s], a multiple of the timestep; one by default."""
    workers: int = min(2, os.cpu_count() or 1)
    """Processes to share the work among; the numbers do not depend on it."""
    page: bool = True
    """Draw the figures and write report.html."""
    films: Path = FILMS
    """Folder with films.json, which `afl-mujoco render` writes: films for the page, if there."""
    robustness: Path = ROBUSTNESS
    """Folder with results of studies, such as `afl-mujoco thresholds` writes: for the page."""
    out: Path = VALIDATION
    """Folder for the report."""

    def run(self) -> int:
        """Run the campaign, write and print its report."""
        from afl_mujoco.scenario.catalogue import SCENARIOS
        from afl_mujoco.scenario.files import find_scenario

        # What is quick to check comes before what is slow to import.
        scenarios = [find_scenario(name) for name in self.scenarios or SCENARIOS]

        from rich.console import Console

        from afl_mujoco.control.catalogue import find_controller
        from afl_mujoco.execution.executors import open_executor
        from afl_mujoco.files import output_folder
        from afl_mujoco.reporting.page.folder import forget_page
        from afl_mujoco.reporting.tables import print_report, write_report
        from afl_mujoco.studies.cases import Settings, require_runnable
        from afl_mujoco.studies.verification.campaign import run_campaign
        from afl_mujoco.studies.verification.claims.schedules import FULL, QUICK

        names = separated(self.controllers)
        controllers = [find_controller(name, self.gain_labels) for name in names]
        period = self.timestep if self.control_period is None else self.control_period
        settings = Settings(timestep=self.timestep, control_period=period, full=self.full)
        require_runnable(scenarios, controllers, settings, self.workers)
        films, sections = self._films(), self._sections()
        folder = output_folder(self.out)
        total = len(scenarios) * len(controllers) + (FULL if self.full else QUICK)
        with open_executor(self.workers) as executor:
            with progress_bar(total, "validating") as progress:
                report = run_campaign(
                    scenarios, controllers, settings, executor=executor, progress=progress
                )
            report = replace(report, command=self.command)
            forget_page(folder)
            files = [*write_report(report, folder)]
            files += self._write_page(report, folder, films, sections, executor)
        print(f"wrote {', '.join(str(file) for file in files)}")
        print_report(report, Console(width=None if sys.stdout.isatty() else 140))
        return SUCCESS if report.passed else CHECK_FAILED

    @property
    def command(self) -> str:
        """What reproduces the numbers, as typed into a shell: options that are not the default."""
        return typed("validate", self, INDIFFERENT)

    def _films(self) -> tuple[Film, ...]:
        """Return the films for the page."""
        from afl_mujoco.reporting.page.inputs.films import load_films

        return load_films(self.films, self.out) if self.page else ()

    def _sections(self) -> Sequence[Section]:
        """Return what the studies say, for the page."""
        from afl_mujoco.cli.study import sections_in

        return sections_in(self.robustness) if self.page else ()

    def _write_page(
        self,
        report: Report,
        folder: Path,
        films: Sequence[Film],
        sections: Sequence[Section],
        executor: Executor,
    ) -> list[Path]:
        """Write the curves, the figures and the page."""
        from afl_mujoco.reporting.page.folder import (
            CURVES,
            FIGURES,
            figure_count,
            write_gallery,
            write_page,
        )
        from afl_mujoco.studies.verification.curves import save_curves

        save_curves(folder / CURVES, report.curves)
        if not self.page:
            return [folder / CURVES]
        data = report.to_dict()
        with progress_bar(figure_count(data, report.curves), "drawing") as progress:
            write_gallery(folder, data, report.curves, executor=executor, progress=progress)
        page = write_page(folder, films, sections, self.robustness)
        return [folder / CURVES, folder / FIGURES, page]
