"""The worst that can be found: CMA-ES over the cube that Monte Carlo draws from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from afl_mujoco.control.controller import Controller
from afl_mujoco.execution.executors import Executor, compute_all
from afl_mujoco.scenario.sample_space import SampleSpace, acting, sample_point, search_generator
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.studies.cube_search import Budget, Point, minimise
from afl_mujoco.studies.monte_carlo.campaign import Campaign
from afl_mujoco.studies.monte_carlo.trial import Settings, Trial, run_trials

HARDEST, NEAREST = "hardest", "nearest"
"""What is searched: the hardest sample, and the failure nearest to the scenario itself."""

STEP = {HARDEST: 0.3, NEAREST: 0.1}
"""Standard deviation at the start, as a share of the cube's edge."""

PIECE = 4
"""Number of points of a generation that a worker runs at a time."""


class Start(NamedTuple):
    """A point of the cube, and the sample whose noise it has.

    Attributes
    ----------
    point
        The point.
    noise
        Index of the sample.
    """

    point: Point
    noise: int


class PointUnit(NamedTuple):
    """What a worker is asked to run.

    Attributes
    ----------
    controller, space, seed, points, noise, settings
        The controller, the cube, the campaign's seed, points of the cube, the index of the sample
        whose noise they have, and how to run them.
    """

    controller: Controller
    space: SampleSpace
    seed: int
    points: Sequence[Point]
    noise: int
    settings: Settings


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Found:
    """What a search found.

    Attributes
    ----------
    question
        `HARDEST` or `NEAREST`.
    controller
        Its name.
    point, noise
        Its point in the cube, and the index of the sample whose noise it has.
    trial
        How the run there ended.
    distance
        Distance from the scenario itself in the cube, as a share of the cube's diagonal.
    runs
        Number of runs that the search took.
    changes
        By coordinate, its distance from the scenario as a share of its range, farthest first.
    """

    question: str
    controller: str
    point: Point
    noise: int
    trial: Trial
    distance: float
    runs: int
    changes: dict[str, float]


def search_worst(
    controller: Controller,
    campaign: Campaign,
    *,
    budget: Budget,
    executor: Executor,
    progress: Callable[[int], None] = lambda runs: None,
) -> list[Found]:
    """Search for a controller's hardest sample, then for its failure nearest to the scenario.

    The first search starts from the hardest sample of the campaign, the second from the nearest
    failure known. Each keeps the noise of the sample that it starts from, so that its cost
    function does not change and it finds nothing milder than what was known. There is no second
    search if nothing fails, and none at all if nothing passes.
    """
    rng, spent = search_generator(campaign.seed), 0

    def search(question: str, start: Start) -> tuple[Start, Found]:
        def costs(points: list[Point]) -> list[float]:
            nonlocal spent
            found = _trials_at(points, start.noise, controller, campaign, executor)
            spent += len(points)
            progress(spent)
            return [
                _cost(question, campaign.space, point, trial)
                for point, trial in zip(points, found, strict=True)
            ]

        point, tried = minimise(costs, start.point, STEP[question], rng, budget)
        trial = _trials_at([point], start.noise, controller, campaign, executor)[0]
        end = Start(point, start.noise)
        return end, _found(question, controller, campaign, end, trial, tried)

    def distance(start: Start) -> float:
        return distance_of(campaign.space, start.point)

    trials = campaign.trials[controller.name]
    if not any(trial.passed for trial in trials):
        return []
    severities = [trial.severity(campaign.space.scenario.duration) for trial in trials]
    end, hardest = search(HARDEST, _sample(campaign, int(np.argmax(severities))))
    known = [_sample(campaign, i) for i in campaign.failures(controller.name)]
    known += [] if hardest.trial.passed else [end]
    return [hardest, search(NEAREST, min(known, key=distance))[1]] if known else [hardest]


def worst_scenario(
    space: SampleSpace, point: ArrayLike, noise: int, seed: int, question: str
) -> Scenario:
    """Return the scenario at a point that a search found; arguments as in `Found`."""
    scenario = space.scenario_of(point, noise, seed)
    return replace(scenario, name=f"{scenario.name}-{question}")


def most_runs(budget: Budget) -> int:
    """Return the most runs that `search_worst` reports for one controller."""
    return 2 * budget.points


def _sample(campaign: Campaign, index: int) -> Start:
    """Return the point of a sample, with its noise."""
    return Start(sample_point(campaign.space, index, campaign.seed), index)


def _trials_at(
    points: list[Point], noise: int, controller: Controller, campaign: Campaign, executor: Executor
) -> list[Trial]:
    """Run a controller at points of the cube, shared among workers."""
    pieces = [points[i : i + PIECE] for i in range(0, len(points), PIECE)]
    units = [PointUnit(controller, campaign.space, campaign.seed, piece, noise, campaign.settings)
             for piece in pieces]  # fmt: skip
    return [trial for some in compute_all(run_points, units, executor) for trial in some]


def _cost(question: str, space: SampleSpace, point: Point, trial: Trial) -> float:
    """Return what a search minimises."""
    severity = trial.severity(space.scenario.duration)
    if question == HARDEST:
        return -severity
    # every failure ranks before every run that passes; of the latter the most severe ranks first
    return 2.0 - severity if trial.passed else distance_of(space, point)


def run_points(unit: PointUnit) -> list[Trial]:
    """Run a controller at points of the cube."""
    scenarios = [unit.space.scenario_of(point, unit.noise, unit.seed) for point in unit.points]
    return run_trials(scenarios, unit.controller, unit.settings)


def distance_of(space: SampleSpace, point: Point) -> float:
    """Return how far a point is from the scenario, as a share of the cube's diagonal.

    Coordinates that the shapes of its schedules do not use do not count.
    """
    moved = list(acting(_away(space, point)).values())
    return float(np.linalg.norm(moved) / np.sqrt(space.dimension))


def _away(space: SampleSpace, point: Point) -> dict[str, float]:
    """Return the distance of every coordinate of a point from that of the scenario."""
    return dict(zip(space.coordinates, (point - space.reference).tolist(), strict=True))


def _found(
    question: str, controller: Controller, campaign: Campaign, end: Start, trial: Trial, tried: int
) -> Found:
    """Assemble what a search found."""
    space, point = campaign.space, end.point
    away = _away(space, point)
    return Found(
        question=question,
        controller=controller.name,
        point=point,
        noise=end.noise,
        trial=trial,
        distance=distance_of(space, point),
        runs=tried,
        changes=dict(sorted(away.items(), key=lambda item: (-abs(item[1]), item[0]))),
    )
