"""Search the gain table, and fit the gain functions to it. Run: make tune ARGS="--quick".

Writes gain_table.json (gains, and the objective on the ideal ODE and in MuJoCo) and, if the nominal
plant is among at least nine, gain_functions.json (every fit with its RMSE, and the gains of
fixed-retuned and adaptive-retuned) and gain_table.png.
Finished plants are saved at once, and those in progress every second; --resume continues to the
same bits. The paper's 400 plants take about half an hour on two cores.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from afl_mujoco.cli.terminal import count_bar
from afl_mujoco.control.catalogue import AFLController
from afl_mujoco.control.gains import GAIN_NAMES, GainFunction, Gains
from afl_mujoco.errors import FileError
from afl_mujoco.files import output_folder, read_json, write_json
from afl_mujoco.pool import compute_all, open_executor
from afl_mujoco.report.figures import save_figure, styled
from afl_mujoco.scenario.parameters import CART_MASSES, HALF_LENGTHS, NOMINAL
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.metrics import metrics
from afl_mujoco.simulation.mujoco_rollout import simulate_mujoco
from afl_mujoco.studies.verify.claims import with_objective
from research.command import Parser, run_command
from research.figures import draw_gain_table, fits_of
from research.gain_tuning import (
    FITS,
    GAIN_BOX,
    GainTable,
    PairSearch,
    fit_table,
    pair_searches,
    paper_scales,
    save_fits,
    search_pair,
    table_provenance,
)
from research.genetic import Box, GeneticSettings, differences

QUICK_MASSES, QUICK_LENGTHS = (0.1, 1.0, 2.0), (0.05, 0.5, 1.0)
QUICK_SETTINGS = GeneticSettings(population_size=200, generations=60)


def mujoco_objective(row: Sequence[float]) -> float | None:
    """Return the objective (O1) of a row (M, l, K, lambda, Phi, ...) in MuJoCo; None if it fell."""
    mass, length, *gains = row
    found = Gains(**dict(zip(GAIN_NAMES, gains[:3], strict=True)))
    controller = AFLController(name="row", gain_function=GainFunction.constant(found))
    scenario = Scenario(name="row", schedule={"cart_mass": mass, "half_length": length})
    run = simulate_mujoco(scenario, controller, "continuous", timestep=1e-3)
    return with_objective(metrics(scenario, controller, run), paper_scales())["objective"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Finished:
    """The rows that are found so far, by place, and what they depend on."""

    provenance: dict[str, Any]
    rows: dict[int, list[float]]


def finished_before(file: Path, provenance: dict[str, Any]) -> dict[int, list[float]]:
    """Return the rows of an earlier run that was broken off; another's file is refused."""
    if not file.exists():
        return {}
    there = read_json(file, Finished, "is not of a search", "remove it to start anew")
    if found := differences(there.provenance, json.loads(json.dumps(provenance))):
        rule = f"holds another search: {', '.join(found[:3])}; name another folder"
        raise FileError(str(file), rule)
    return dict(there.rows)


def search_table(options: argparse.Namespace, folder: Path) -> GainTable:
    """Return the table that is asked for, searched and scored in MuJoCo."""
    provenance = table_provenance(units_of(options, None))
    kept = folder / "searches"
    if kept.exists() and not options.resume:
        raise FileError(str(kept), "has a search: pass --resume to continue it, or remove it")
    with open_executor(options.workers, options.cluster) as executor:
        file = output_folder(kept) / "finished.json"
        rows = finished_before(file, provenance)
        alone = options.cluster is None  # a checkpoint is a file of this machine
        units = units_of(options, output_folder(kept / "checkpoints") if alone else None)
        with count_bar(len(units), "searching") as show:

            def save(_: int) -> None:
                write_json(file, Finished(provenance=provenance, rows=rows))
                show(len(rows))

            found = compute_all(search_pair, units, executor, save, kept=rows)
        scores = compute_all(mujoco_objective, found, executor)
    scored = [[*row, score] for row, score in zip(found, scores, strict=True)]
    return GainTable(np.array(scored, dtype=float), provenance)


def units_of(options: argparse.Namespace, checkpoints: Path | None) -> list[PairSearch]:
    """Return the searches to run."""
    grid = (QUICK_MASSES, QUICK_LENGTHS) if options.quick else (CART_MASSES, HALF_LENGTHS)
    settings = QUICK_SETTINGS if options.quick else GeneticSettings()
    given = {"population_size": options.population, "generations": options.generations}
    return pair_searches(
        grid[0] if options.cart_masses is None else options.cart_masses,
        grid[1] if options.half_lengths is None else options.half_lengths,
        replace(settings, **{name: x for name, x in given.items() if x is not None}),
        options.seed,
        box=Box(tuple(options.lower), tuple(options.upper)),
        checkpoints=checkpoints,
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line."""
    parser = Parser(prog="make tune", description=__doc__)
    add = parser.add_argument
    add("--quick", action="store_true", help="9 plants, population 200, 60 generations")
    add("--cart-masses", type=float, nargs="*", help="of the grid [kg]; 0.1 to 2.0 by default")
    add("--half-lengths", type=float, nargs="*", help="of the grid [m]; 0.05 to 1.00 by default")
    add("--population", type=int, help="number of chromosomes; the paper's 1000 by default")
    add("--generations", type=int, help="the paper's 1000 by default")
    add("--lower", type=float, nargs=3, default=GAIN_BOX.lower, help="least K, lambda, Phi (D8)")
    add("--upper", type=float, nargs=3, default=GAIN_BOX.upper, help="largest K, lambda, Phi")
    add("--seed", type=int, default=0, help="of every search, with the place of its plant")
    add("--resume", action="store_true", help="continue the search that is in the folder")
    add("--workers", type=int, default=min(2, os.cpu_count() or 1), help="processes")
    add("--cluster", help="share the work among a Dask cluster: tcp://host:port")
    add("--out", type=Path, default=Path("renders/tuning"), help="folder for all files")
    options = parser.parse_args(arguments)
    units_of(options, None)  # what is quick to check comes first
    folder = output_folder(options.out)
    table = search_table(options, folder)
    table.save(folder / "gain_table.json")
    print(f"wrote {folder / 'gain_table.json'}, {len(table.rows)} plants")
    nominal = [NOMINAL.cart_mass, NOMINAL.half_length]
    if len(table.rows) < 9 or not np.isclose(table.rows[:, :2], nominal).all(axis=1).any():
        return
    with count_bar(FITS, "fitting") as progress:
        fits = fit_table(table, seed=options.seed, progress=progress)
    print(*(fit.line() for fit in fits), sep="\n")
    save_fits(folder / "gain_functions.json", table, fits, seed=options.seed)
    functions = json.loads((folder / "gain_functions.json").read_text(encoding="utf-8"))
    with styled():
        save_figure(draw_gain_table(table, fits_of(functions)), folder / "gain_table.png")
    print(f"wrote {folder / 'gain_functions.json'}")


if __name__ == "__main__":
    run_command(main)
