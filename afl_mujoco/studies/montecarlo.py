"""Run controllers on random hardware; search the worst case."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from afl_mujoco.control.controller import Controller
from afl_mujoco.control.names import chosen, find_controllers, subject_of
from afl_mujoco.errors import FileError, require_count, writing
from afl_mujoco.files import hidden_folder
from afl_mujoco.pool import open_executor
from afl_mujoco.report.blocks import MISSING, Block, Cell, Figure, Matrix, Report, fixed, percent
from afl_mujoco.scenario.catalogue import with_ranges
from afl_mujoco.scenario.files import Replay, find_scenario, save_scenario
from afl_mujoco.scenario.imperfections import LARGEST_SEED
from afl_mujoco.scenario.sample_space import SampleSpace, sample_scenario
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.time_steps import Deployed
from afl_mujoco.simulation.judgement import beyond, require_start
from afl_mujoco.studies.shared.contract import (
    ControllerNames,
    Interrupted,
    Progress,
    ScenarioName,
    Study,
    Timestep,
    silent,
)
from afl_mujoco.studies.shared.robustness import (
    HARDEST,
    NEAREST,
    Worst,
    changes_of,
    require_runs,
    sample,
    search_worst,
    worst_scenario,
)
from afl_mujoco.studies.shared.run import Rows, Run
from afl_mujoco.studies.shared.search import Budget
from afl_mujoco.studies.shared.tables import how, middle

LABORATORY = "laboratory"
MOST_SAMPLES = 1_000_000
SAMPLES, GENERATIONS = 1000, 30  # number of samples, and of generations of each search
QUICK = 100, 5  # the same of a quick study

FOLDER = "montecarlo"  # folder of the scenario files; it holds a folder for each controller

FILES = {HARDEST: "hardest.toml", NEAREST: "nearest-failure.toml"}
"""Names of the scenario files of what a search found."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Run controllers on the same random hardware samples, then search for the worst case.

    Example: afl-mujoco montecarlo my-rig.toml --controllers adaptive lqr --quick

    The table [ranges] of the scenario file says what varies: start, schedules of M and l within
    bounds and rates, imperfections. A scenario without it gets random laboratory hardware for all
    imperfections that are ideal in it. A run passes if it meets the scenario's requirements or,
    if there are none, survives to the end. The search looks for the sample that fails worst, or
    has the least robustness left. Writes montecarlo.json, figures, and a scenario file for every
    failure, which `afl-mujoco simulate` replays to the same bits. A full run takes about ten
    minutes on two cores.
    """

    scenario: ScenarioName = LABORATORY
    """Scenario by name, or TOML file; laboratory: the paper's plant on random laboratory hardware,
    its M and l changing at random."""
    controllers: ControllerNames = ()
    samples: int | None = None
    """Number of hardware samples; 1000 by default. Sample i does not depend on the number."""
    seed: int = 1
    """Seed of the samples, their noise and the search."""
    worst_case: bool = True
    """Do not search for the hardest sample and the nearest failure (by CMA-ES)."""
    generations: int | None = None
    """Number of generations of each search, 16 runs each; 30 by default."""
    quick: bool = False
    """100 samples and 5 generations, unless other numbers are given."""
    timestep: Timestep = None


class Request(NamedTuple):
    """What is studied."""

    space: SampleSpace
    controllers: Sequence[Controller]
    names: Sequence[str]  # by which the controllers were asked for
    assumed: bool = False  # whether the scenario does not say what varies
    samples: int = SAMPLES
    seed: int = 1
    deployed: Deployed = Deployed()
    budget: Budget | None = None  # of the searches, if there are any

    @property
    def scenarios(self) -> tuple[Scenario, ...]:
        """The scenario whose ranges are drawn from."""
        return (self.space.scenario,)


def prepare(options: Options) -> Request:
    """Return what the options ask for, or raise if a rule is broken."""
    o = options
    asked = find_scenario(o.scenario)
    names, default = chosen(o.controllers, [asked]), QUICK if o.quick else (SAMPLES, GENERATIONS)
    controllers = find_controllers(names, [asked])
    samples, generations = (
        usual if given is None else given
        for given, usual in zip((o.samples, o.generations), default, strict=True)
    )
    budget = Budget(generations=generations)
    space, deployed = SampleSpace(with_ranges(asked)), Deployed(timestep=o.timestep)
    require_runs(controllers, [space.scenario], deployed)
    for corner in space.corners:
        require_start(corner)
    require_count("samples", samples, 1, MOST_SAMPLES)
    require_count("seed", o.seed, 0, LARGEST_SEED)
    return Request(
        space=space, controllers=controllers, names=names, assumed=not asked.ranges,
        samples=samples, seed=o.seed, deployed=deployed,
        budget=budget if o.worst_case else None,
    )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """Every controller on the same samples, and the worst that a search found."""

    seed: int  # of the samples
    timestep: float | None  # of MuJoCo [s], None for the default
    space: SampleSpace  # that the samples are drawn from
    rows: Rows  # every run, controller by controller; its draw is the number of the sample
    asked: Mapping[str, str]  # by controller, the name by which it was asked for
    # by controller, shares of the runs that pass and that end at rest, with exact 95 % intervals
    rates: Mapping[str, Mapping[str, tuple[float, float, float]]]
    worst_cases: tuple[Worst, ...] = ()  # none if nothing was searched
    assumed: bool = False  # whether the scenario does not say what varies

    @property
    def runs(self) -> dict[str, list[Run]]:
        """The runs by controller."""
        return {name: [run for run in self.rows if run.controller == name] for name in self.asked}

    @property
    def words(self) -> dict[str, str]:
        """What the shares of `rates` are called."""
        passes = "passes" if self.space.scenario.judged else "survives"
        return {"passes": passes, "settles": "ends at rest"}

    @property
    def samples(self) -> int:
        """How many samples there are."""
        return len(self.rows) // len(self.asked)

    def failures(self, controller: str) -> list[Run]:
        """Return the runs of a controller that failed; each has a scenario file."""
        return [run for run in self.runs[controller] if run.failure]


def rate(runs: Sequence[bool]) -> tuple[float, float, float]:
    """Return a share, and the ends of its exact (Clopper-Pearson) 95 % interval."""
    from scipy.stats import binomtest

    count, of = sum(runs), len(runs)
    ends = binomtest(count, of).proportion_ci(confidence_level=0.95, method="exact")
    return count / of, float(ends.low), float(ends.high)


def run(
    request: Request, *, progress: Progress = silent, workers: int = 1, cluster: str | None = None
) -> Result:
    """Run the samples and the searches; the result does not depend on the workers."""
    space, controllers, _, _, samples, seed, deployed, budget = request
    worst: list[Worst] = []
    try:
        runs = sample(controllers, space, samples, seed, deployed, progress, workers, cluster)
    except Interrupted as early:
        raise Interrupted(_result(request, early.result, worst), early.done) from None
    try:
        with open_executor(workers, cluster) as executor:
            for one in controllers:
                if budget is None:
                    break

                def advance(done: int, name: str = one.name, most: int = 2 * budget.points) -> None:
                    progress(f"searching the worst case for {name}", done, most)

                found = search_worst(
                    one, space, runs[one.name], seed, budget, deployed, executor, advance
                )
                held = f"{FOLDER}/{one.name}"
                worst += [replace(x, file=f"{held}/{FILES[x.question]}") for x in found]
    except KeyboardInterrupt:
        done = f"{samples} samples, {len(worst)} searches"
        raise Interrupted(_result(request, runs, worst), done) from None
    return _result(request, runs, worst)


def _result(request: Request, runs: Mapping[str, list[Run]], worst: Sequence[Worst]) -> Result:
    return Result(
        seed=request.seed,
        timestep=request.deployed.timestep,
        space=request.space,
        rows=tuple(run for some in runs.values() for run in some),
        asked=dict(zip(runs, request.names, strict=True)),
        rates={
            name: {"passes": rate([not run.failure for run in some]),
                   "settles": rate([run.settled for run in some])}
            for name, some in runs.items()
        },
        worst_cases=tuple(worst),
        assumed=request.assumed,
    )  # fmt: skip


# --- what is shown ------------------------------------------------------------------------------


def report(result: Result) -> Report:
    """Return what is shown of samples and searches."""
    ours, (passes, rests) = subject_of(list(result.asked)), result.words.values()
    shares = {
        name: [percent(rates[key][0], 3) for key in result.words]
        for name, rates in result.rates.items()
    }
    said = [
        f"{name} {passes} {passed} and {rests} on {rested}"
        for name, (passed, rested) in sorted(shares.items(), key=lambda one: one[0] != ours)
    ]
    blocks: list[Block] = [
        Figure(
            name="montecarlo-rates",
            title=f"How often each controller {passes} and {rests}, {result.samples} samples",
            caption=f"Filled: {passes}; hollow: {rests}; with exact 95 % intervals.",
            draw=partial(_draw_rates, result),
        ),
        _rates(result),
    ]
    if result.worst_cases:
        blocks.append(_worst_cases(result))
    blocks += _messages(result)
    headline = f"{result.samples} samples of {result.space.scenario.name}: {'; '.join(said)}."
    return Report(headline=headline, blocks=blocks)


def _rates(result: Result) -> Matrix:
    rows: list[list[Cell | str]] = []
    own = result.space.scenario
    for name, some in result.runs.items():
        failures = [run.failure for run in some if run.failure]
        kinds = sorted(set(failures), key=lambda kind: (-failures.count(kind), kind))
        fails = "; ".join(f"{how(kind, own)} {failures.count(kind)} ×" for kind in kinds) or MISSING
        margins = [run.margin for run in some if run.failure or run.margin is not None]
        margin = middle(margins, -math.inf)  # a failure without one is worse than any
        shares = (
            f"{percent(share, 3)} ({fixed(100.0 * low, 1)} to {fixed(100.0 * high, 1)})"
            for share, low, high in (result.rates[name][key] for key in result.words)
        )
        rows.append([name, *shares, MISSING if margin is None else percent(margin), fails])
    how_often = [f"{word.capitalize()} on [%]" for word in result.words.values()]
    return Matrix(
        caption=f"Seed {result.seed}, with 95 % intervals",
        columns=["Controller", *how_often, "Median margin", "How it fails"],
        rows=rows,
    ).filled


def _draw_rates(result: Result) -> Any:
    from afl_mujoco.report.figures import Dot, dots

    rows: dict[str, list[Dot]] = {name: [] for name in result.rates}
    for name, rates in result.rates.items():
        for word, found in rates.items():
            share, low, high = (100.0 * x for x in found)
            text, hollow = f"{result.words[word]} {share:.1f} %", word == "settles"
            rows[name].append(Dot(at=share, thin=(low, high), text=text, hollow=hollow))
    return dots(rows, "share of the samples [%]", bounds=(-1.0, 101.0))


def _worst_cases(result: Result) -> Matrix:
    rows: list[list[Cell | str]] = []
    for one in result.worst_cases:
        (run,) = one.run
        moved = [(name, x) for name, x in changes_of(result.space, one.point).items()
                 if " instant " not in name and " shape" not in name]  # fmt: skip
        at = f" at {fixed(run.time, 2)} s" if run.failure == run.outcome and run.time else ""
        words = how(run.failure, result.space.scenario) + at
        outcome = Cell(words, "bad" if run.failure else "good")
        most = ", ".join(f"{name} {fixed(x, 2)}" for name, x in moved[:2])
        numbers = (percent(run.margin), fixed(one.distance, 2))
        rows.append([one.controller, one.question, outcome, *numbers, most, one.file])
    return Matrix(
        caption="What a search found: distance from the scenario as a share of the diagonal of all "
        "ranges; what was moved most, as a share of its range",
        columns=["Controller", "Search", "Outcome", "Margin", "Distance", "Moved most", "File"],
        rows=rows,
    ).filled


def _messages(result: Result) -> Iterator[str]:
    if result.assumed:
        yield (
            f"{result.space.scenario.name} does not say what varies, so that its ideal "
            "imperfections are those of random laboratory hardware; a table `[ranges]` in its file "
            "changes this."
        )
    plant = result.space.scenario.plant
    if not result.space.scenario.is_cart_pole:
        yield from (f"{said}." for said in beyond(plant, result.space.varied))
    for name, runs in result.runs.items():
        if all(run.failure for run in runs):
            passes = result.words["passes"]
            yield f"{name} {passes} on no sample: there is none harder to search for."
        for run in [run for run in runs if run.message][:1]:
            yield f"{name} on sample {run.draw}: {run.message}"
    lines = [
        f"afl-mujoco simulate {file_of(name, runs[0])} --controller {result.asked[name]}"
        for name in result.asked
        if (runs := result.failures(name))
    ]
    if lines:
        yield (
            "Replay a failure, identical to the last bit: the files are in the folder of the "
            "results, and a controller of your own is looked for where the command runs."
        )
        yield "```sh\n" + "\n".join(lines) + "\n```"


# --- scenario files -----------------------------------------------------------------------------

_OURS = re.compile(r"failure-\d{4,}\.toml|" + "|".join(map(re.escape, FILES.values())))


def file_of(controller: str, run: Run) -> str:
    """Return the scenario file of a failure beside the result."""
    return f"{FOLDER}/{controller}/failure-{run.draw:04d}.toml"


def require_files(folder: Path) -> None:
    """Raise if the folder of the scenario files holds anything that this study did not write."""
    held = folder / FOLDER
    if not held.exists():
        return
    if not held.is_dir() or held.is_symlink():
        raise FileError(str(held), "must be a folder that this study wrote: it is replaced")
    for path in sorted(held.rglob("*")):
        level = len(path.relative_to(held).parts)
        ours = path.is_dir() if level == 1 else level == 2 and _OURS.fullmatch(path.name)
        if path.is_symlink() or not ours:
            rule = "was not written by this study, which replaces its folder: move it away"
            raise FileError(str(path), rule)


def write_files(result: Result, folder: Path) -> list[Path]:
    """Write a scenario file of each failure and of each worst case, in place of older ones."""
    require_files(folder)
    space, seed = result.space, result.seed
    scenarios = {
        file_of(name, run): sample_scenario(space, run.draw, seed)
        for name in result.asked
        for run in result.failures(name)
    }
    scenarios |= {one.file: worst_scenario(space, one, seed) for one in result.worst_cases}
    replays = {
        name: Replay(controller=asked, timestep=result.timestep)
        for name, asked in result.asked.items()
    }
    with hidden_folder(folder, FOLDER) as staging:
        try:
            with writing(folder / FOLDER):
                for name in replays:
                    (staging / FOLDER / name).mkdir(parents=True)
                for file, scenario in scenarios.items():
                    place, replay = (folder / file).parent, replays[Path(file).parent.name]
                    save_scenario(scenario, staging / file, replay=replay, moves_to=place)
                if (folder / FOLDER).exists():
                    (folder / FOLDER).rename(staging / "before")
                (staging / FOLDER).rename(folder / FOLDER)
        finally:
            before = staging / "before"
            if not (folder / FOLDER).exists() and before.exists():  # a Ctrl-C in between
                before.rename(folder / FOLDER)
    return [folder / FOLDER]


STUDY = Study(
    module=__name__, name="montecarlo", title="Monte Carlo and worst case", order=20, schema=9
)
