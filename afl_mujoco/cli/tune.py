"""`afl-mujoco tune`: the gain table, and the gain functions fitted to it."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from afl_mujoco.cli.terminal import SUCCESS, count_bar, plain_help, progress_bar, say

if TYPE_CHECKING:
    from afl_mujoco.control.gain_table import GainTable
    from afl_mujoco.studies.gain_tuning.gain_table import PairSearch


@plain_help
@dataclass(frozen=True, kw_only=True)
class Table:
    """Search for the best gains of every plant of a grid with the paper's genetic algorithm.

    Example: afl-mujoco tune table --quick

    Writes gain_table.json: gains, and the objective on the ideal ODE and in MuJoCo. Finished plants
    are saved at once, and those in progress every second; --resume continues to the same bits. The
    full setting of the paper, 400 plants, takes about half an hour on two cores.
    """

    quick: bool = False
    """A grid of 9 plants and a population of 200 over 60 generations, unless given otherwise."""
    cart_masses: tuple[float, ...] | None = None
    """Cart masses of the grid [kg]; the paper's 0.1 to 2.0 by default."""
    half_lengths: tuple[float, ...] | None = None
    """Half-lengths of the grid [m]; the paper's 0.05 to 1.00 by default."""
    population: int | None = None
    """Number of chromosomes; the paper's 1000 by default."""
    generations: int | None = None
    """Number of generations; the paper's 1000 by default."""
    lower: tuple[float, float, float] | None = None
    """Least K, lambda and Phi; 100, 1, 90 by default (decision D8)."""
    upper: tuple[float, float, float] | None = None
    """Largest K, lambda and Phi; 200, 5, 110 by default (decision D8)."""
    seed: int = 0
    """Seed of every search, combined with the position of its plant in the grid."""
    resume: bool = False
    """Continue the search that is in the folder."""
    workers: int = min(2, os.cpu_count() or 1)
    """Number of processes that share the work; the results do not depend on it."""
    cluster: str | None = None
    """Share the work among the workers of a Dask cluster: tcp://host:port."""
    out: Path | None = None
    """Folder for the table and the checkpoints; renders/tuning, or renders/tuning-quick."""

    def run(self) -> int:
        """Run the searches, score their winners in MuJoCo, write the table."""
        import numpy as np

        from afl_mujoco.control.gain_table import GainTable
        from afl_mujoco.errors import FileError
        from afl_mujoco.execution.executors import compute_all, open_executor
        from afl_mujoco.execution.store import Store
        from afl_mujoco.files import output_folder
        from afl_mujoco.studies.gain_tuning.gain_cost import paper_scales
        from afl_mujoco.studies.gain_tuning.gain_table import search_pair, table_provenance
        from afl_mujoco.studies.gain_tuning.rescoring import mujoco_objective

        provenance = table_provenance(self._units(None))  # what is quick to check comes first
        default = "renders/tuning-quick" if self.quick else "renders/tuning"
        folder = output_folder(self.out or default)
        kept = folder / "searches"
        if kept.exists() and not self.resume:
            raise FileError(str(kept), "has a search: pass --resume to continue it, or remove it")
        with open_executor(self.workers, self.cluster) as executor:
            store = Store(output_folder(kept) / "finished.json", provenance)
            alone = self.cluster is None  # a checkpoint is a file of this machine
            units = self._units(output_folder(kept / "checkpoints") if alone else None)
            with progress_bar(len(units), "searching") as advance:
                rows = compute_all(
                    search_pair, units, executor, lambda _: advance("searching"), store
                )
            winners = [(row, paper_scales()) for row in rows]
            with progress_bar(len(units), "scoring in MuJoCo") as advance:
                scores = compute_all(
                    mujoco_objective, winners, executor, lambda _: advance("scoring in MuJoCo")
                )
        scored = [[*row, score] for row, score in zip(rows, scores, strict=True)]
        table = GainTable(np.array(scored, dtype=float), provenance)
        table.save(folder / "gain_table.json")
        _print_rows(table)
        say(f"wrote {folder / 'gain_table.json'}, {len(table.rows)} plants")
        return SUCCESS

    def _units(self, checkpoints: Path | None) -> list[PairSearch]:
        """Return the searches to run."""
        from afl_mujoco.scenario.parameters import CART_MASSES, HALF_LENGTHS
        from afl_mujoco.studies.gain_tuning.gain_cost import GAIN_BOX
        from afl_mujoco.studies.gain_tuning.gain_table import (
            QUICK_LENGTHS,
            QUICK_MASSES,
            QUICK_SETTINGS,
            pair_searches,
        )
        from afl_mujoco.studies.gain_tuning.settings import Box, GeneticSettings

        defaults = QUICK_SETTINGS if self.quick else GeneticSettings()
        settings = replace(
            defaults,
            population_size=defaults.population_size
            if self.population is None
            else self.population,
            generations=defaults.generations if self.generations is None else self.generations,
        )
        grid = (QUICK_MASSES, QUICK_LENGTHS) if self.quick else (CART_MASSES, HALF_LENGTHS)
        return pair_searches(
            grid[0] if self.cart_masses is None else self.cart_masses,
            grid[1] if self.half_lengths is None else self.half_lengths,
            settings,
            self.seed,
            box=Box(self.lower or GAIN_BOX.lower, self.upper or GAIN_BOX.upper),
            checkpoints=checkpoints,
        )


def _print_rows(table: GainTable) -> None:
    """Print about ten rows of a table."""
    for row in table.rows[:: max(1, len(table.rows) // 10)]:
        say("M {:.2f} kg, l {:.2f} m: K {:.4f}, lambda {:.4f}, Phi {:.4f}, OF {:.6f},"
              " in MuJoCo {:.6f}".format(*row))  # fmt: skip


@plain_help
@dataclass(frozen=True, kw_only=True)
class Fit:
    """Fit the gain function (G1) to a gain table, by the paper's search and by least squares.

    Example: afl-mujoco tune fit --table renders/tuning/gain_table.json

    Writes gain_functions.json: every fit with its RMSE, and the gains of the controllers
    fixed-retuned and adaptive-retuned. The package's own table is used by default.
    """

    table: Path | None = None
    """A table that `tune table` wrote."""
    seed: int = 0
    """Seed of the searches and of the starts of least squares."""
    out: Path = Path("renders/tuning")
    """Folder for the file."""

    def run(self) -> int:
        """Fit, print the fits, write them."""
        from afl_mujoco.control.gain_table import GainTable
        from afl_mujoco.files import output_folder
        from afl_mujoco.studies.gain_tuning.fit import FITS, damped_slope, fit_table, save_fits

        table = GainTable.shipped() if self.table is None else GainTable.load(self.table)
        damped_slope(table)  # what is quick to check comes first
        folder = output_folder(self.out)
        with count_bar(FITS, "fitting") as progress:
            fits = fit_table(table, seed=self.seed, progress=progress)
        say(*(fit.line() for fit in fits))
        save_fits(folder / "gain_functions.json", table, fits, seed=self.seed)
        say(f"wrote {folder / 'gain_functions.json'}")
        return SUCCESS


@dataclass(frozen=True, kw_only=True)
class Tune:
    """Find gains: a table by plant, and functions fitted to it.

    Example: afl-mujoco tune table --quick
    """

    what: Table | Fit
    """What to find."""

    def run(self) -> int:
        """Run the chosen command."""
        return self.what.run()
