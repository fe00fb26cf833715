"""`afl-mujoco montecarlo`."""

from __future__ import annotations

import os
import shlex
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from afl_mujoco.cli.terminal import FILMS, SUCCESS, SURVIVAL, count_bar, typed

if TYPE_CHECKING:
    from afl_mujoco.control.law import Law
    from afl_mujoco.execution.executors import Executor
    from afl_mujoco.validation.montecarlo.campaign import Campaign
    from afl_mujoco.validation.montecarlo.search import Budget
    from afl_mujoco.validation.montecarlo.trial import Settings
    from afl_mujoco.validation.montecarlo.worst_case import Found

SAMPLES, QUICK_SAMPLES = 1000, 100
GENERATIONS, QUICK_GENERATIONS = 30, 5

INDIFFERENT = ("out", "validation", "films", "workers", "cluster")
"""Options that leave the numbers as they are, and so are no part of what reproduces them."""


@dataclass(frozen=True, kw_only=True)
class MonteCarloOptions:
    """Run controllers on random laboratory rigs, the same for each; then search the worst rig.

    Example: afl-mujoco montecarlo --controllers adaptive lqr --quick

    Random are start, schedules of M and l, noise, encoders, friction, delay and lag. Writes
    montecarlo.json, figures, and a scenario file of every failure, which `afl-mujoco simulate`
    replays to the same bits. The whole takes some ten minutes on two cores.
    """

    controllers: tuple[str, ...] = ("adaptive", "lqr")
    """Controllers by name, or laws in Python, my_module:my_law."""
    samples: int | None = None
    """Rigs; 1000 by default. Rig i is the same whatever their number."""
    seed: int = 1
    """Seed of the rigs, their noise and the search."""
    worst_case: bool = True
    """Search the hardest rig and the nearest failure by CMA-ES."""
    generations: int | None = None
    """Generations of each search, of 16 rigs each; 30 by default."""
    quick: bool = False
    """100 rigs and 5 generations, where not given otherwise."""
    integrator: str = "RK4"
    """MuJoCo's integrator: RK4, as `simulate` has it, Euler, implicit, implicitfast."""
    keep: int | None = None
    """Scenario files of failures to keep of each controller; all by default."""
    workers: int = min(2, os.cpu_count() or 1)
    """Processes to share the work among; the numbers do not depend on it."""
    cluster: str | None = None
    """Share it among the workers of a Dask cluster: tcp://host:port."""
    out: Path = SURVIVAL
    """Folder for the files."""
    validation: Path | None = None
    """Folder of a report, whose page is made anew; renders/validation, unless --out is given."""
    films: Path = FILMS
    """Folder with films.json, for that page."""

    def run(self) -> int:
        """Run the campaign and the searches, write and print them."""
        laws, settings, budget = self._request()  # what is quick to check comes first

        from rich.console import Console

        from afl_mujoco.cli.survival.ending import finish, require_page
        from afl_mujoco.execution.executors import open_executor
        from afl_mujoco.files import output_folder
        from afl_mujoco.reporting.page.survival.rates import replay_command
        from afl_mujoco.reporting.survival.montecarlo_figures import draw_montecarlo
        from afl_mujoco.reporting.survival.montecarlo_table import print_montecarlo
        from afl_mujoco.reporting.survival.study import remove_study, write_study
        from afl_mujoco.validation.montecarlo.files import require_ours, write_scenarios

        require_page("montecarlo", self.out, self.validation, self.films)
        folder = output_folder(self.out)
        require_ours(folder)
        with open_executor(self.workers, self.cluster) as executor:
            campaign = self._campaign(laws, settings, executor)
            found = self._search(laws, campaign, budget, executor) if self.worst_case else []
        figures = draw_montecarlo(campaign)
        remove_study("montecarlo", folder)  # lest it speak of files that are gone
        asked = {law.name: name for law, name in zip(laws, self.controllers, strict=True)}
        held = write_scenarios(campaign, found, folder, keep=self.keep, asked=asked)
        content = self._content(campaign, found)
        files = write_study("montecarlo", content, figures, folder, command=self.command)
        print_montecarlo(campaign, found, Console(width=None if sys.stdout.isatty() else 140))
        for entry in content["controllers"]:
            if command := replay_command(entry, folder):
                print(f"replay: {command}")
        finish([*files, held], self.out, self.validation, self.films)
        return SUCCESS

    @property
    def command(self) -> str:
        """What reproduces the numbers, as typed into a shell: options that are not the default."""
        return typed("montecarlo", self, INDIFFERENT, positional=False)

    def _request(self) -> tuple[list[Law], Settings, Budget]:
        """Return laws, settings and budget, or raise at what breaks a rule."""
        from afl_mujoco.control.controllers import find_controller
        from afl_mujoco.errors import InvalidValueError
        from afl_mujoco.validation.montecarlo.campaign import require_campaign
        from afl_mujoco.validation.montecarlo.search import Budget
        from afl_mujoco.validation.montecarlo.space import SampleSpace
        from afl_mujoco.validation.montecarlo.trial import Settings

        laws = [find_controller(name) for name in self.controllers]
        settings = Settings(integrator=self.integrator)
        require_campaign(
            laws, SampleSpace(), samples=self._samples, seed=self.seed, settings=settings
        )
        for name, least in (("workers", 1), ("keep", 0)):
            value = getattr(self, name)
            if value is not None and value < least:
                raise InvalidValueError(name, f"must be at least {least}", value)
        default = QUICK_GENERATIONS if self.quick else GENERATIONS
        budget = Budget(generations=default if self.generations is None else self.generations)
        return laws, settings, budget

    @property
    def _samples(self) -> int:
        """How many rigs there are."""
        default = QUICK_SAMPLES if self.quick else SAMPLES
        return default if self.samples is None else self.samples

    def _campaign(self, laws: list[Law], settings: Settings, executor: Executor) -> Campaign:
        """Run every controller on every rig."""
        from afl_mujoco.validation.montecarlo.campaign import run_campaign
        from afl_mujoco.validation.montecarlo.space import SampleSpace

        with count_bar(self._samples * len(laws), "sampling") as progress:
            return run_campaign(
                laws,
                SampleSpace(),
                samples=self._samples,
                seed=self.seed,
                settings=settings,
                executor=executor,
                progress=progress,
            )

    def _search(
        self, laws: list[Law], campaign: Campaign, budget: Budget, executor: Executor
    ) -> list[Found]:
        """Search the worst for each controller."""
        from afl_mujoco.validation.montecarlo.worst_case import most_runs, search_worst

        found: list[Found] = []
        for law in laws:
            with count_bar(most_runs(budget), f"searching the worst for {law.name}") as progress:
                found += search_worst(
                    law, campaign, budget=budget, executor=executor, progress=progress
                )
        return found

    def _content(self, campaign: Campaign, found: list[Found]) -> dict[str, Any]:
        """Return the study as plain data, with the files and what replays them."""
        from afl_mujoco.validation.montecarlo.files import (
            failure_file,
            found_file,
            kept_failures,
        )

        content = campaign.to_dict()
        for entry, asked in zip(content["controllers"], self.controllers, strict=True):
            name = entry["controller"]
            kept = kept_failures(campaign, name, self.keep)
            for failure in entry["failures"]:
                i = failure["index"]
                failure["file"] = failure_file(name, i) if i in kept else None
            entry["replay"] = self._replay(asked)
        content["worst_cases"] = [one.to_dict() | {"file": found_file(one)} for one in found]
        return content

    def _replay(self, asked: str) -> str:
        """Return the command that replays a file of a controller."""
        words = ["afl-mujoco", "simulate", "FILE", "--controller", asked]
        if self.integrator != "RK4":
            words += ["--integrator", self.integrator]
        return shlex.join(words)


MonteCarlo = Annotated[MonteCarloOptions, tyro.conf.subcommand("montecarlo")]
"""The command, its name one word."""
