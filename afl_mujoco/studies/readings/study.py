"""The configuration of the study of readings, and its run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from afl_mujoco.studies.contract import Progress, Study, counted, silent

if TYPE_CHECKING:
    from afl_mujoco.studies.readings.result import Result


@dataclass(frozen=True, kw_only=True)
class Readings:
    """Find under which readings of the paper its numbers hold.

    Example: afl-mujoco readings --quick

    A reading is a choice of what the paper leaves open: values and times of the schedules, horizon
    and scales of the objective, labels of two columns, the sign of the largest force. Searches for
    the readings nearest to Table 3, freely and among round numbers; draws random readings and says
    what drives the improvement; counts the rows of Table 1 that are optima. Writes readings.json,
    figures, and a scenario file of each case of each fitted reading, which validate and simulate
    take. A full run takes about fifteen minutes on two cores.
    """

    seed: int = 0
    """Seed of everything drawn."""
    quick: bool = False
    """Fewer restarts, draws and grid points: two minutes instead of fifteen."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Effort:
    """How much a run spends.

    Attributes
    ----------
    restarts, generations, population
        Of each search.
    draws, descents
        Round readings drawn for each goal, and how many of the best are descended from.
    samples, base
        Random readings, and the base sample of each estimate of the Sobol' indices, a power of two.
    horizons, slopes, steps
        Horizons, grid points of lambda and of each scale for Table 1.
    """

    restarts: int
    generations: int
    population: int
    draws: int
    descents: int
    samples: int
    base: int
    horizons: tuple[float, ...]
    slopes: int
    steps: int


LARGEST_SEED = 2**63 - 1

FULL = Effort(
    restarts=16, generations=800, population=24, draws=20000, descents=8, samples=50000, base=512,
    horizons=(10.0, 15.0, 20.0, 30.0), slopes=80, steps=81,
)  # fmt: skip
QUICK = Effort(
    restarts=4, generations=120, population=16, draws=2000, descents=1, samples=4000, base=32,
    horizons=(20.0,), slopes=24, steps=41,
)  # fmt: skip


def check(configuration: Readings) -> None:
    """Raise if the configuration breaks a rule."""
    from afl_mujoco.errors import require_count

    require_count("seed", configuration.seed, 0, LARGEST_SEED)


def run(configuration: Readings, *, progress: Progress = silent, workers: int = 1) -> Result:
    """Search, draw and count; the result does not depend on the workers."""
    from itertools import product

    from afl_mujoco.execution.executors import compute_all, open_executor
    from afl_mujoco.studies.cube_search import Budget
    from afl_mujoco.studies.paper_tables import LABELS, published_fits
    from afl_mujoco.studies.readings.optima import judge_optima
    from afl_mujoco.studies.readings.result import Result, named_readings
    from afl_mujoco.studies.readings.search import GOALS, descend, nearest, round_starts
    from afl_mujoco.studies.readings.sensitivity import sensitivity_of

    effort, seed = QUICK if configuration.quick else FULL, configuration.seed
    budget = Budget(generations=effort.generations, population=effort.population)
    searches = [(goal, k, seed, budget) for goal in GOALS for k in range(effort.restarts)]
    tables = list(product(LABELS, effort.horizons, [effort.slopes], [effort.steps]))
    progress("drawing readings", 0, 1)
    sensitivity = sensitivity_of(effort.samples, effort.base, seed, workers)
    progress("drawing readings", 1, 1)
    with open_executor(workers) as executor:
        advance = counted(progress, "searching readings", len(searches))
        found = compute_all(nearest, searches, executor, advance)
        starts = [
            (goal, start)
            for goal in GOALS
            for start in round_starts(
                goal,
                [one for (name, *_), one in zip(searches, found, strict=True) if name == goal],
                (effort.draws, effort.descents),
                seed,
                workers,
            )
        ]
        advance = counted(progress, "descending among round readings", len(starts))
        descended = compute_all(descend, starts, executor, advance)
        advance = counted(progress, "Table 1", len(tables))
        optima = compute_all(judge_optima, tables, executor, advance)
    return Result(
        seed=seed,
        readings=named_readings(
            [goal for goal, *_ in searches], found, [goal for goal, _ in starts], descended
        ),
        draws=effort.draws,
        sensitivity=sensitivity,
        optima=tuple(optima),
        fits=published_fits(),
    )


STUDY = Study(
    name="readings",
    title="Readings of the paper",
    order=55,
    schema=1,
    configuration=Readings,
    check=check,
    run=run,
)
