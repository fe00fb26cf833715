"""The worst that can be found: CMA-ES over the cube that Monte Carlo draws from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from afl_mujoco.control.law import Law
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.sweep.executors import Executor
from afl_mujoco.sweep.sweep import compute_all
from afl_mujoco.validation.montecarlo.campaign import Campaign, ending_of
from afl_mujoco.validation.montecarlo.space import SampleSpace, sample_point, search_generator
from afl_mujoco.validation.montecarlo.trial import Settings, Trial, run_trials

Point = NDArray[np.float64]

HARDEST, NEAREST = "hardest", "nearest"
"""The questions: the hardest rig found, and the failure nearest to the paper's nominal run."""

STEP = {HARDEST: 0.3, NEAREST: 0.1}
"""Standard deviation at the start, as a share of the cube's edge."""

PIECE = 4
"""Points of a generation that a worker runs at a time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Budget:
    """How much a search may spend; it ends earlier where the strategy itself does.

    Attributes
    ----------
    generations, population
        Generations, and points in each.

    Raises
    ------
    InvalidValueError
        If there is too little of either.
    """

    generations: int = 30
    population: int = 16

    def __post_init__(self) -> None:
        """Check both."""
        for name, least in (("generations", 1), ("population", 4)):
            if getattr(self, name) < least:
                raise InvalidValueError(name, f"must be at least {least}", getattr(self, name))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Found:
    """What a search found.

    Attributes
    ----------
    question
        `HARDEST` or `NEAREST`.
    controller
        Its name.
    scenario, trial
        The rig, and how the run on it ended.
    distance
        From the paper's nominal run in the cube, as a share of the cube's diagonal.
    runs
        How many were spent.
    changes
        By coordinate, how far it is from the nominal run as a share of its range, farthest first.
    """

    question: str
    controller: str
    scenario: Scenario
    trial: Trial
    distance: float
    runs: int
    changes: dict[str, float]

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data."""
        return {
            "question": self.question,
            "controller": self.controller,
            "failed": not self.trial.survived,
            **ending_of(self.trial),
            "severity": self.trial.severity(self.scenario.duration),
            "distance": self.distance,
            "runs": self.runs,
            "changes": self.changes,
        }


def minimise(
    cost: Callable[[list[Point]], Sequence[float]],
    start: Point,
    step: float,
    rng: Generator,
    budget: Budget,
) -> tuple[Point, int]:
    """Search the unit cube by CMA-ES; return the best point and how many were tried.

    Parameters
    ----------
    cost
        Takes points of the cube and returns what to minimise, one number each. The start is
        tried first, alone.
    start
        Where to begin.
    step
        Standard deviation at first.
    rng
        The only source of chance.
    budget
        When to end.
    """
    import cma

    options = {
        "bounds": [0.0, 1.0],
        "popsize": budget.population,
        "maxiter": budget.generations,
        "randn": lambda rows, genes: rng.standard_normal((rows, genes)),
        "seed": np.nan,  # the global generator is left alone
        "verbose": -9,
    }
    strategy = cma.CMAEvolutionStrategy(start, step, options)
    best, least, tried = start, cost([start])[0], 1
    while not strategy.stop():
        asked = strategy.ask()
        points = [np.clip(x, 0.0, 1.0) for x in asked]
        costs = list(cost(points))
        strategy.tell(asked, costs)
        tried += len(points)
        k = int(np.argmin(costs))
        if costs[k] < least:
            best, least = points[k], costs[k]
    return best, tried


def search_worst(
    law: Law,
    campaign: Campaign,
    *,
    budget: Budget,
    executor: Executor,
    progress: Callable[[int], None] = lambda runs: None,
) -> list[Found]:
    """Search the hardest rig for a law, then the failure nearest to the paper's nominal run.

    Both searches have the noise of sample 0, so that they walk through a landscape that keeps
    still. The first starts from the middle of the cube; the second from the nearest failure
    known, and there is none if no failure is.

    Parameters
    ----------
    law
        One of the campaign's.
    campaign
        Gives space, seed, settings, and the failures known.
    budget
        Of each search.
    executor
        From `open_executor`; who computes does not change a bit.
    progress
        Called with how many runs are done, of at most ``2 * (1 + generations * population)``.
    """
    space, spent = campaign.space, 0
    rng = search_generator(campaign.seed)

    def trials_at(points: list[Point]) -> list[Trial]:
        nonlocal spent
        pieces = [points[i : i + PIECE] for i in range(0, len(points), PIECE)]
        units = [(law, space, campaign.seed, piece, campaign.settings) for piece in pieces]
        found = [trial for some in compute_all(run_points, units, executor) for trial in some]
        spent += len(points)
        progress(spent)
        return found

    def gentleness(points: list[Point]) -> list[float]:
        return [-trial.severity(space.duration) for trial in trials_at(points)]

    def distance(points: list[Point]) -> list[float]:
        # every failure before every survivor; a survivor the better the harder it had it
        return [
            2.0 - trial.severity(space.duration) if trial.survived else distance_of(space, point)
            for point, trial in zip(points, trials_at(points), strict=True)
        ]

    middle = np.full(space.dimension, 0.5)
    hardest, tried = minimise(gentleness, middle, STEP[HARDEST], rng, budget)
    results = [_found(HARDEST, law, campaign, hardest, trials_at([hardest])[0], tried)]
    known = [sample_point(space, i, campaign.seed) for i in campaign.failures(law.name)]
    known += [hardest] if not results[0].trial.survived else []
    if known:
        start = min(known, key=lambda point: distance_of(space, point))
        nearest, tried = minimise(distance, start, STEP[NEAREST], rng, budget)
        trial = trials_at([nearest])[0]
        if not trial.survived:
            results.append(_found(NEAREST, law, campaign, nearest, trial, tried))
    return results


def run_points(
    unit: tuple[Law, SampleSpace, int, Sequence[Point], Settings],
) -> list[Trial]:
    """Run a law at points of the cube.

    Parameters
    ----------
    unit
        The law, the space, the seed of the campaign, the points and the settings.
    """
    law, space, seed, points, settings = unit
    return run_trials([space.scenario_of(point, 0, seed) for point in points], law, settings)


def distance_of(space: SampleSpace, point: Point) -> float:
    """Return how far a point is from the paper's nominal run, as a share of the cube's diagonal.

    Parameters
    ----------
    space
        Gives the nominal run's point.
    point
        The point.
    """
    return float(np.linalg.norm(point - space.reference) / np.sqrt(space.dimension))


def _found(
    question: str, law: Law, campaign: Campaign, point: Point, trial: Trial, tried: int
) -> Found:
    """Put a result together."""
    space = campaign.space
    away = dict(zip(space.coordinates, (point - space.reference).tolist(), strict=True))
    return Found(
        question=question,
        controller=law.name,
        scenario=space.scenario_of(point, 0, campaign.seed),
        trial=trial,
        distance=distance_of(space, point),
        runs=tried,
        changes=dict(sorted(away.items(), key=lambda item: (-abs(item[1]), item[0]))),
    )
