"""Readings of the paper: under which of them its numbers hold.

Run: make readings ARGS="--quick --out DIR"

Searches for the readings nearest to Table 3, freely and among round numbers; draws random readings
and says what drives the improvement; counts the rows of Table 1 that are optima. Writes
readings.json and a scenario file of each case of each named reading, which validate takes (a pole
of 5 cm is stiff: --timestep 0.00025). A full run takes 25 minutes on two cores, a quick one two.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count, product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from afl_mujoco.cli.terminal import count_bar
from afl_mujoco.errors import require_count
from afl_mujoco.files import output_folder, remove_file, write_json
from afl_mujoco.pool import compute_all, open_executor, require_workers
from afl_mujoco.scenario.files import save_scenario
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.studies.shared.record import versions
from afl_mujoco.studies.shared.search import Budget, minimise
from research.batch import closed_loop_terms
from research.command import Parser, run_command
from research.gain_tuning import GAIN_BOX
from research.genetic import LARGEST_SEED
from research.paper import (
    AXES,
    CASES,
    COLUMNS,
    HORIZON,
    LABELS,
    NEAR,
    OPTIMAL,
    PUBLISHED_IMPROVEMENTS,
    SCALE_PHI,
    SCALE_Z,
    SCHEDULES,
    SIGNED,
    Array,
    Fit,
    both_errors,
    improvement_error,
    improvements,
    nominal_terms,
    published_fits,
    published_rows,
    random_readings,
    readings_at,
    scaled,
    scenario_of,
    terms_of,
    value_error,
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Goal:
    """What a reading is to come near to."""

    # function of the objectives, shape (N, 4, 2), that returns the error of each reading
    error: Callable[[Array], Array]
    meaning: str  # what the error measures, with its unit
    scales: bool  # whether the scales are free too; otherwise they are those of D4


_POINTS = "rms difference of the four improvements [percentage points]"

GOALS: Mapping[str, Goal] = {
    "improvements-d4": Goal(error=improvement_error, meaning=_POINTS, scales=False),
    "improvements": Goal(error=improvement_error, meaning=_POINTS, scales=True),
    "values": Goal(
        error=value_error,
        meaning="rms difference of the eight objectives [%]",
        scales=True,
    ),
    "both": Goal(
        error=both_errors, meaning="root of the sum of the squares of both errors", scales=True
    ),
}
"""The goals by name."""

WIDER = 3.0
"""Factor by which the range of the logarithms of the scales is wider than for random readings."""

ROUND_TIME = 0.5
ROUND_HORIZONS = (10.0, 15.0, 20.0, 30.0)
ROUND_LEVELS = {"M": 0.1 * np.arange(1, 21), "l": 0.05 * np.arange(1, 21)}
"""The paper's own grids of M and l."""

ROUND_FACTOR = 0.1
"""Grid of log10 of the factors of the scales."""

LATEST = max(ROUND_HORIZONS)

Unit = tuple[str, int, int, Budget]
"""Goal, number of the restart, seed and budget of a search."""

Found = tuple[list[float], float, int]
"""A reading, its error, and how many readings were tried."""


def nearest(unit: Unit) -> Found:
    """Return the reading nearest to a goal, by CMA-ES from a random start.

    Labels (D2) and the sign of the largest force (D5) are taken in turn by the restarts.
    """
    name, restart, seed, budget = unit
    goal = GOALS[name]
    rng = np.random.default_rng((seed, list(GOALS).index(name), restart))
    free = [k for k in range(len(AXES)) if k not in _fixed(goal)]

    def readings(points: list[Array]) -> Array:
        cube = np.full((len(points), len(AXES)), 0.5)
        cube[:, free] = points
        cube[:, LABELS], cube[:, SIGNED] = restart % 2, restart // 2 % 2
        found = readings_at(cube)
        found[:, [SCALE_Z, SCALE_PHI]] *= WIDER
        return found

    def cost(points: list[Array]) -> list[float]:
        return _costs(goal, readings(points))

    best, tried = minimise(cost, rng.random(len(free)), 0.3, rng, budget)
    one = tidied(readings([best])[0])
    return one.tolist(), float(_costs(goal, one[None])[0]), tried


def _fixed(goal: Goal) -> tuple[int, ...]:
    """Return the unknowns that a search for a goal does not vary."""
    return (LABELS, SIGNED) if goal.scales else (LABELS, SIGNED, SCALE_Z, SCALE_PHI)


def _costs(goal: Goal, readings: Array) -> list[float]:
    """Return errors that are finite, as the search needs them."""
    errors = goal.error(terms_of(readings).objectives(readings))
    return np.minimum(errors, 1e6).tolist()  # type: ignore[no-any-return]


def tidied(one: Array) -> Array:
    """Return a reading with times in multiples of 2 ms, and its other numbers with few digits."""
    found = np.round(one, 4)
    found[HORIZON] = round(one[HORIZON], 2)
    for times, _ in SCHEDULES.values():
        found[times] = np.round(2e-3 * np.round(one[times] / 2e-3), 3)
    return found


def rounded(readings: Array, goal: Goal) -> Array:
    """Return the round readings next to others, their times still increasing."""
    found = readings.copy()
    horizons = np.array(ROUND_HORIZONS)
    nearest_horizon = np.abs(readings[:, HORIZON, None] - horizons).argmin(axis=1)
    found[:, HORIZON] = horizons[nearest_horizon]
    last = found[:, HORIZON, None] - ROUND_TIME
    for (symbol, _), (times, levels) in SCHEDULES.items():
        rank = ROUND_TIME * np.arange(len(times))  # without it equal times may stand side by side
        halves = ROUND_TIME * np.round(readings[:, times] / ROUND_TIME) - rank
        apart = np.clip(halves, ROUND_TIME, last - rank[-1])
        found[:, times] = np.maximum.accumulate(apart, axis=1) + rank
        grid = ROUND_LEVELS[symbol]
        found[:, levels] = grid[np.abs(readings[:, levels, None] - grid).argmin(axis=2)]
    scales = [SCALE_Z, SCALE_PHI]
    found[:, scales] = np.round(readings[:, scales] / ROUND_FACTOR) * ROUND_FACTOR
    if not goal.scales:
        found[:, scales] = 0.0
    return found


def sound(readings: Array) -> NDArray[np.bool_]:
    """Return which readings have increasing times before their horizon."""
    found = np.ones(len(readings), dtype=bool)
    for times, _ in SCHEDULES.values():
        instants = readings[:, times]
        found &= (np.diff(instants, axis=1) > 0.0).all(axis=1)
        found &= instants[:, -1] < readings[:, HORIZON]
    return found


def round_starts(
    name: str, found: Sequence[Found], draws: tuple[int, int], seed: int, threads: int
) -> list[list[float]]:
    """Return round readings to descend from: next to the nearest found freely, and drawn."""
    goal, (count, kept) = GOALS[name], draws
    nearest_found = np.array([min(found, key=lambda one: one[1])[0]])
    drawn = rounded(random_readings(count, seed), goal)
    errors = goal.error(terms_of(drawn, threads).objectives(drawn))
    best = drawn[np.argsort(errors, kind="stable")[:kept]]
    return [*rounded(nearest_found, goal).tolist(), *best.tolist()]


RoundUnit = tuple[str, list[float]]
"""Goal and start of a descent among round readings."""


def descend(unit: RoundUnit) -> Found:
    """Return the round reading that no change of one unknown brings nearer to a goal."""
    name, start = unit
    goal, best = GOALS[name], np.array(start)
    least, tried = _costs(goal, best[None])[0], 1
    alternatives = {k: _alternatives(k) for k in range(len(AXES))}
    if not goal.scales:
        del alternatives[SCALE_Z], alternatives[SCALE_PHI]
    while True:
        before = least
        for k, values in alternatives.items():
            others = np.repeat(best[None], len(values), axis=0)
            others[:, k] = values
            for times, _ in SCHEDULES.values():
                others[:, times] = np.sort(others[:, times], axis=1)
            others = others[sound(others)]
            costs = _costs(goal, others)
            tried += len(others)
            if len(others) and min(costs) < least:
                least = min(costs)
                best = others[int(np.argmin(costs))]
        if least == before:
            return best.tolist(), least, tried


def _alternatives(k: int) -> NDArray[Any]:
    """Return the round values of an unknown."""
    axis = AXES[k]
    if axis.kind == "time":
        return np.arange(ROUND_TIME, LATEST, ROUND_TIME)
    if axis.kind == "horizon":
        return np.array(ROUND_HORIZONS)
    if axis.kind == "scale":
        end = round(WIDER * axis.high / ROUND_FACTOR)
        return ROUND_FACTOR * np.arange(-end, end + 1)
    return np.array([0.0, 1.0]) if axis.kind == "choice" else ROUND_LEVELS[axis.kind]


def round_count() -> int:
    """Return how many round readings there are, without the choice of scales."""
    total = 0
    for horizon in ROUND_HORIZONS:
        times = round(horizon / ROUND_TIME) - 1
        each = 1
        for instants, levels in SCHEDULES.values():
            ways = np.prod([(times - k) / (k + 1) for k in range(len(instants))])
            each *= round(float(ways)) * 20 ** len(levels)
        total += each
    return 4 * total


QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
REPEATS = 5
"""Independent estimates of the Sobol' indices."""

Driver = tuple[str, float, float, float]
"""An unknown with its total-order Sobol' index: mean, least and largest of `REPEATS` estimates."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CaseShares:
    """How one improvement of Table 3 does over random readings."""

    case: str  # the case, and the paper's improvement [%]
    paper: float
    # shares of the readings under which the improvement is within `NEAR` percentage points of the
    # paper's, at least half of it, and above zero
    near: float
    half: float
    positive: float
    quantiles: tuple[float, ...]  # quantiles of the improvement [%] at `QUANTILES`
    histogram: tuple[float, ...]  # shares of the readings in the bins between `EDGES`
    # unknowns that matter in the case, largest index first. The index is the share of the variance
    # of the improvement in which the unknown has a part, alone or with others; an improvement below
    # the first edge of the histogram counts as that
    drivers: tuple[Driver, ...]


EDGES = tuple(range(-100, 105, 5))
"""Edges of the histogram of improvements [%]; what lies below is in the first bin."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensitivity:
    """What random readings say."""

    samples: int  # readings drawn, and how many of them a run fell under
    lost: int
    # numbers of readings under which all four improvements are within `NEAR` percentage points, and
    # at least half of the paper's
    all_near: int
    all_half: int
    cases: tuple[CaseShares, ...]  # each case of Table 3


def sensitivity_of(samples: int, base: int, seed: int, threads: int) -> Sensitivity:
    """Draw random readings and say how often Table 3 holds, and what drives it."""
    found = _improvements(random_readings(samples, seed), threads)
    sound = np.isfinite(found).all(axis=1)
    kept = found[sound]
    near = np.abs(kept - PUBLISHED_IMPROVEMENTS) <= NEAR
    half = kept >= 0.5 * PUBLISHED_IMPROVEMENTS
    drivers = _drivers(base, seed, threads)
    clipped = np.clip(kept, EDGES[0], EDGES[-1])
    return Sensitivity(
        samples=samples,
        lost=int((~sound).sum()),
        all_near=int(near.all(axis=1).sum()),
        all_half=int(half.all(axis=1).sum()),
        cases=tuple(
            CaseShares(
                case=case,
                paper=float(PUBLISHED_IMPROVEMENTS[k]),
                near=float(near[:, k].sum() / samples),
                half=float(half[:, k].sum() / samples),
                positive=float((kept[:, k] > 0.0).sum() / samples),
                quantiles=tuple(np.quantile(kept[:, k], QUANTILES).tolist()),
                histogram=tuple((np.histogram(clipped[:, k], EDGES)[0] / samples).tolist()),
                drivers=drivers[k],
            )
            for k, case in enumerate(CASES)
        ),
    )


def _improvements(readings: Array, threads: int) -> Array:
    """Return the improvements under readings [%], shape (N, 4)."""
    return improvements(terms_of(readings, threads).objectives(readings))


def _drivers(base: int, seed: int, threads: int) -> list[tuple[Driver, ...]]:
    """Return the total-order Sobol' indices of each case's unknowns, largest first."""
    from scipy.stats import sobol_indices, uniform

    def model(points: Array) -> Array:
        found = _improvements(readings_at(points.T), threads)
        return np.clip(found, EDGES[0], None).T

    uniforms: list[Any] = [uniform()] * len(AXES)
    totals = np.stack(
        [
            sobol_indices(
                func=model, n=base, dists=uniforms, rng=np.random.default_rng((seed, repeat))
            ).total_order
            for repeat in range(1, REPEATS + 1)
        ]
    )
    found = []
    for low, mean, high in zip(
        totals.min(axis=0), totals.mean(axis=0), totals.max(axis=0), strict=True
    ):
        order = [i for i in np.argsort(-mean, kind="stable") if mean[i] != 0.0]
        found.append(
            tuple((AXES[i].name, float(mean[i]), float(low[i]), float(high[i])) for i in order)
        )
    return found


SPAN = 4.0
"""Largest log10 of a factor on a scale."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Optima:
    """How Table 1 does under one horizon and one reading of its columns."""

    labels: str  # reading of the columns (D2), and the horizon [s]
    horizon: float
    best: int  # largest number of rows that are optimal under one choice of scales
    # log10 of the factors on D4's scales for the integrals of z and phi, where that is so
    scales: tuple[float, float]
    as_decided: int  # number of rows that are optimal under D4's scales
    median_excess: float  # median excess over the optimum where most rows are optimal [1]
    # rms relative difference of column OF from the best non-negative weights of the terms [1]
    column_error: float


def judge_optima(unit: tuple[str, float, int, int]) -> Optima:
    """Compare Table 1 with the optimum over a grid of gains, under a grid of scales.

    The optimum over a grid is not below that over the box, so that the excess is, if anything, too
    small: the paper is given the benefit.
    """
    labels, horizon, slopes, steps = unit
    rows = published_rows()
    plants, columns = rows[:, [4, 5]], COLUMNS[labels]
    ends = [*zip(GAIN_BOX.lower, GAIN_BOX.upper, strict=True)]
    axes = [
        np.linspace(*ends[0], max(slopes // 4, 2)),
        np.geomspace(*ends[1], slopes),
        np.linspace(*ends[2], max(slopes // 8, 2)),
    ]
    gains = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    nominal = nominal_terms()
    published = _terms(rows[:, columns], plants, horizon) / nominal
    grid = np.linspace(-SPAN, SPAN, steps)
    pairs = np.stack(np.meshgrid(grid, grid, indexing="ij"), axis=-1).reshape(-1, 2)
    weights = np.column_stack([10.0**-pairs, np.ones(len(pairs))])
    excess = np.empty((len(rows), len(pairs)))
    for k, plant in enumerate(plants):
        here = published[k] @ weights.T
        terms = _terms(gains, np.broadcast_to(plant, (len(gains), 2)), horizon) / nominal
        least = np.minimum((terms @ weights.T).min(axis=0), here)
        excess[k] = here / least - 1.0
    good = (excess <= OPTIMAL).sum(axis=0)
    most = int(np.lexsort((np.median(excess, axis=0), -good))[0])
    decided = int(np.abs(pairs).sum(axis=1).argmin())
    _, residual = nnls(published / rows[:, [3]], np.ones(len(rows)))
    return Optima(
        labels=labels,
        horizon=horizon,
        best=int(good[most]),
        scales=(float(pairs[most, 0]), float(pairs[most, 1])),
        as_decided=int(good[decided]),
        median_excess=float(np.median(excess[:, most])),
        column_error=float(residual / np.sqrt(len(rows))),
    )


def _terms(gains: Array, plants: Array, horizon: float) -> Array:
    """Return the terms of (O1), shape (N, 3)."""
    found = closed_loop_terms(gains, plants, duration=horizon)
    terms = np.column_stack([found.iae_z, found.iae_phi, found.max_force])
    terms[found.lost] = np.inf
    return terms


@dataclass(frozen=True, slots=True, kw_only=True)
class FittedReading:
    """The reading found nearest to a goal."""

    name: str  # its name, and that of the goal
    goal: str
    round: bool  # whether its numbers are round
    error: float  # its error, in the unit of the goal
    errors: tuple[float, ...]  # the errors that all restarts ended with, smallest first
    tried: int  # readings tried by all restarts together
    values: dict[str, float]  # the unknowns by name, as in `readings_at`
    # objectives of the cases with fixed and adaptive gains, at the common scale that brings them
    # nearest to Table 3
    objectives: tuple[tuple[float, float], ...]
    improvements: tuple[float, ...]  # by how much adaptive gains lower them [%]

    @property
    def vector(self) -> Array:
        """The unknowns as an array."""
        return np.array([self.values[axis.name] for axis in AXES])

    @property
    def scenarios(self) -> list[Scenario]:
        """The four cases."""
        return [scenario_of(self.vector, case, self.name) for case in CASES]


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """The content of readings.json."""

    schema: int = 1
    command: str = "make readings"
    versions: dict[str, str] = field(default_factory=lambda: dict(versions()))
    seed: int
    readings: tuple[FittedReading, ...]
    """The readings nearest to each goal, free and round."""
    draws: int
    """Round readings drawn for each goal before the descents."""
    sensitivity: Sensitivity
    optima: tuple[Optima, ...]
    """Table 1 under each horizon and labels."""
    fits: tuple[Fit, ...]
    """The fits of Table 2 beside the printed rows."""


def named_readings(
    searched: Sequence[str],
    found: Sequence[Found],
    started: Sequence[str],
    descended: Sequence[Found],
) -> tuple[FittedReading, ...]:
    """Return the best reading of each goal, searched freely and among round numbers."""
    named = []
    for is_round, goals, results in ((False, searched, found), (True, started, descended)):
        for goal in GOALS:
            mine = [one for name, one in zip(goals, results, strict=True) if name == goal]
            if mine:
                named.append(_named(goal, is_round, mine))
    return tuple(named)


def _named(goal: str, is_round: bool, found: Sequence[Found]) -> FittedReading:
    """Return the best of the readings found for a goal."""
    values, error, _ = min(found, key=lambda one: one[1])
    one = np.array(values)[None]
    objectives = scaled(terms_of(one).objectives(one))
    return FittedReading(
        name=f"{'round' if is_round else 'nearest'}-{goal}",
        goal=goal,
        round=is_round,
        error=error,
        errors=tuple(sorted(error for _, error, _ in found)),
        tried=sum(tried for *_, tried in found),
        values={axis.name: float(x) for axis, x in zip(AXES, values, strict=True)},
        objectives=tuple((float(f), float(a)) for f, a in objectives[0]),
        improvements=tuple(improvements(objectives)[0].tolist()),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Effort:
    """How much a run spends."""

    restarts: int
    generations: int
    population: int
    draws: int
    """Round readings drawn for each goal."""
    descents: int
    """How many of the best of them are descended from."""
    samples: int
    """Random readings."""
    base: int
    """Base sample of each estimate of the Sobol' indices, a power of two."""
    horizons: tuple[float, ...]
    slopes: int
    steps: int
    """Horizons [s], grid points of lambda and of each scale for Table 1."""


FULL = Effort(
    restarts=16, generations=800, population=24, draws=20000, descents=8, samples=50000, base=512,
    horizons=(10.0, 15.0, 20.0, 30.0), slopes=80, steps=81,
)  # fmt: skip
QUICK = Effort(
    restarts=4, generations=120, population=16, draws=2000, descents=1, samples=4000, base=32,
    horizons=(20.0,), slopes=24, steps=41,
)  # fmt: skip


def find_readings(effort: Effort, seed: int, workers: int = 1) -> Result:
    """Search, draw and count; the result does not depend on the workers."""
    budget = Budget(generations=effort.generations, population=effort.population)
    searches = [(goal, k, seed, budget) for goal in GOALS for k in range(effort.restarts)]
    tables = list(product(COLUMNS, effort.horizons, [effort.slopes], [effort.steps]))
    sensitivity = sensitivity_of(effort.samples, effort.base, seed, workers)
    with open_executor(workers) as executor:
        with count_bar(len(searches), "searching readings") as show:
            advance = counted(show)
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
        with count_bar(len(starts), "descending among round readings") as show:
            descended = compute_all(descend, starts, executor, counted(show))
        optima = compute_all(judge_optima, tables, executor)
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


def counted(show: Callable[[int], None]) -> Callable[[int], None]:
    """Return a function that advances a bar by one."""
    done = count(1)
    return lambda _: show(next(done))


def write(result: Result, folder: Path) -> None:
    """Write readings.json and the scenario files, in place of older ones."""
    for kind, goal, case in product(("nearest", "round"), GOALS, CASES):
        remove_file(folder / f"{kind}-{goal}-{case}.toml")
    for scenario in (scenario for one in result.readings for scenario in one.scenarios):
        save_scenario(scenario, folder / f"{scenario.name}.toml")
    write_json(folder / "readings.json", result)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line."""
    parser = Parser(prog="make readings", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="two minutes instead of 25")
    parser.add_argument("--seed", type=int, default=0, help="of everything drawn")
    parser.add_argument("--workers", type=int, default=min(2, os.cpu_count() or 1))
    parser.add_argument("--out", type=Path, default=Path("renders/readings"))
    options = parser.parse_args(arguments)
    require_count("seed", options.seed, 0, LARGEST_SEED)
    require_workers(options.workers)
    folder = output_folder(options.out)
    result = find_readings(QUICK if options.quick else FULL, options.seed, options.workers)
    write(result, folder)
    found = result.sensitivity
    print(f"Under {found.all_near} of {found.samples} random readings all four improvements are "
          f"within {NEAR:g} points of Table 3.")  # fmt: skip
    print(f"{'improvement [%]':<24}", *(f"{case:>20}" for case in CASES))
    for name, row in [("Table 3", PUBLISHED_IMPROVEMENTS.tolist())] + [
        (one.name, one.improvements) for one in result.readings
    ]:
        print(f"{name:<24}", *(f"{x:>20.2f}" for x in row))
    for one in result.optima:
        print(f"Table 1 read as {one.labels}, {one.horizon:g} s: {one.best} of its rows optimal")
    print(f"wrote readings.json and {len(CASES) * len(result.readings)} scenarios in {folder}")


if __name__ == "__main__":
    run_command(main)
