"""A small case of each robustness study against single runs: what the slow tests do at length."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.execution.executors import open_executor
from afl_mujoco.scenario.imperfections import Imperfections
from afl_mujoco.scenario.ranges import Ranges
from afl_mujoco.scenario.sample_space import SampleSpace, sample_point, sample_scenario
from afl_mujoco.simulation.attraction.grid import FALLEN, SETTLED
from afl_mujoco.studies.attraction.deployed import map_starts
from afl_mujoco.studies.bisection import BRACKETED
from afl_mujoco.studies.cube_search import Budget
from afl_mujoco.studies.monte_carlo import worst_case
from afl_mujoco.studies.monte_carlo.campaign import Campaign, run_campaign
from afl_mujoco.studies.monte_carlo.trial import Settings
from afl_mujoco.studies.monte_carlo.worst_case import distance_of, search_worst
from afl_mujoco.studies.thresholds import sweep as thresholds

LQR = afl.CONTROLLERS["lqr"]
LEANING = afl.Scenario(name="leaning", duration=2.0, initial_state=(0.0, 0.2, 0.0, 0.0))
SPACE = SampleSpace(
    replace(LEANING, ranges=Ranges(varied={"phi": (-1.3, 1.3), "delay": (0.0, 0.2)}))
)
SAMPLES = 16


def run(scenario: afl.Scenario) -> afl.Trajectory:
    return afl.simulate_mujoco(scenario, LQR, "sampled")


@pytest.fixture(scope="module")
def campaign() -> Campaign:
    with open_executor(1) as executor:
        return run_campaign(
            [LQR], SPACE, samples=SAMPLES, seed=1, settings=Settings(), executor=executor
        )


@pytest.mark.parametrize("name", ["delay", "rail"])
def test_a_threshold_is_where_single_runs_begin_to_fail(name: str) -> None:
    settings = thresholds.Settings(seeds=1, scan=5, tolerance=0.1)
    found = thresholds.sweep((name, LQR, (LEANING,), settings)).survives
    assert found.bound == BRACKETED
    key = {"delay": "delay", "rail": "rail_half_length"}[name]
    for level, survives in ((found.holds_at, True), (found.fails_at, False)):
        alone = run(replace(LEANING, imperfections=Imperfections(**{key: level})))
        reached = np.abs(alone.state[:, 0]).max() >= level if name == "rail" else False
        assert (alone.outcome.kind == "completed" and not reached) == survives


def test_a_campaign_is_of_single_runs(campaign: Campaign) -> None:
    trials = campaign.trials["lqr"]
    for index, trial in enumerate(trials):
        alone = run(sample_scenario(SPACE, index, 1))
        assert (alone.outcome.kind, alone.outcome.time) == (trial.outcome, trial.end_time)
        assert trial.peak_phi == np.abs(alone.state[:, 1]).max()
        assert trial.passed == (alone.outcome.kind == "completed")
    assert campaign.success("lqr").count == sum(trial.passed for trial in trials)
    assert 0 < len(campaign.failures("lqr")) < SAMPLES


def test_a_search_finds_worse_than_the_samples_and_nearer(campaign: Campaign) -> None:
    with open_executor(1) as executor:
        budget = Budget(generations=3, population=6)
        hardest, nearest = search_worst(LQR, campaign, budget=budget, executor=executor)
    assert hardest.trial.severity(2.0) >= max(t.severity(2.0) for t in campaign.trials["lqr"])
    failures = [distance_of(SPACE, sample_point(SPACE, i, 1)) for i in campaign.failures("lqr")]
    assert nearest.distance <= min(failures)
    assert not nearest.trial.passed


def test_the_nearest_failure_is_searched_from_the_nearest_known(
    campaign: Campaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worst_case, "minimise", lambda cost, start, *rest: (start, 1))
    points = {i: sample_point(SPACE, i, 1) for i in campaign.failures("lqr")}
    distances = {i: distance_of(SPACE, point) for i, point in points.items()}
    best = min(distances, key=lambda i: distances[i])
    assert best != min(distances), "the first failure must not be the nearest one too"
    with open_executor(1) as executor:
        budget = Budget(generations=1, population=4)
        _, nearest = search_worst(LQR, campaign, budget=budget, executor=executor)
    assert (nearest.noise, nearest.distance) == (best, distances[best])


def test_a_map_of_starts_is_of_single_runs() -> None:
    scenario = replace(LEANING, duration=6.0)
    angles, rates = np.linspace(-1.4, 1.4, 5), np.array([-1.0, 1.0])
    found = map_starts(
        scenario, LQR, angles, rates, timestep=None, integrator="RK4", threads=1,
        progress=lambda runs: None,
    )  # fmt: skip
    kinds = {FALLEN: "fell", SETTLED: "completed"}
    assert set(kinds) <= set(found.outcome.ravel().tolist())
    for (row, column), code in np.ndenumerate(found.outcome):
        alone = run(replace(scenario, initial_state=(0.0, angles[column], 0.0, rates[row])))
        assert alone.outcome.kind == kinds.get(code, "completed")
