"""What the Monte Carlo study finds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from afl_mujoco.scenario.sample_space import SampleSpace
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.studies.monte_carlo.campaign import Campaign
from afl_mujoco.studies.monte_carlo.rates import CONFIDENCE, Rate
from afl_mujoco.studies.monte_carlo.trial import Trial
from afl_mujoco.studies.monte_carlo.worst_case import HARDEST, NEAREST, Found, worst_scenario

FOLDER = "montecarlo"
"""Folder of the scenario files; it holds a folder for each controller."""

NAMES = {HARDEST: "hardest.toml", NEAREST: "nearest-failure.toml"}
"""Names of the scenario files of what a search found."""

Interval = tuple[float, float]

QUANTILES = (0.0, 0.05, 0.25, 0.5, 0.75, 0.95)
"""Quantiles of the least margin that are kept."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Failure:
    """A sample that a controller did not pass.

    Attributes
    ----------
    index
        Index of the sample.
    outcome, end_time
        How the run ended, and when [s]; no time if the controller failed.
    message
        How the controller failed, if it did.
    failure
        How the run failed, from `failure_of`.
    missed
        The requirements that were not met.
    margin
        Its least margin; None if it ended early or has none.
    file
        Its scenario file beside the result; None if it was not kept.
    """

    index: int
    outcome: str
    end_time: float | None
    message: str | None
    failure: str
    missed: tuple[str, ...]
    margin: float | None
    file: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class ControllerRates:
    """How often one controller passed, and settled.

    Attributes
    ----------
    controller, asked
        Its name, and the name by which it was requested.
    samples, passed, settled
        Number of samples; of runs that met the requirements or, without any, survived to the end;
        and of runs that settled.
    rate, settled_rate
        Shares of these runs [1], with exact intervals.
    median_displacement, largest_displacement
        Median and largest peak abs(z) of the runs that passed [m]; None if none did.
    failures_by_kind
        Number of failures by `Failure.failure`.
    margins
        Quantiles `QUANTILES` of the least margin of the runs that have one; empty if none has.
    unmargined
        Number of runs that have none: they ended early, or never settle.
    missed
        Number of runs that did not meet each requirement.
    failures
        The failures, in order of their index.
    """

    controller: str
    asked: str
    samples: int
    passed: int
    rate: float
    interval: Interval
    settled: int
    settled_rate: float
    settled_interval: Interval
    median_displacement: float | None
    largest_displacement: float | None
    failures_by_kind: dict[str, int]
    margins: tuple[float, ...]
    unmargined: int
    missed: dict[str, int]
    failures: tuple[Failure, ...]

    @property
    def success(self) -> Rate:
        """The rate of runs that passed."""
        return Rate(self.passed, self.samples)

    @property
    def settling(self) -> Rate:
        """The rate of runs that settled."""
        return Rate(self.settled, self.samples)


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """Two controllers on the same samples: how many both passed, only one of them, or neither.

    The p-value is that of McNemar's exact test.
    """

    first: str
    second: str
    both: int
    only_first: int
    only_second: int
    neither: int
    p_value: float


@dataclass(frozen=True, slots=True, kw_only=True)
class WorstCase:
    """What a search found for one controller.

    Attributes
    ----------
    controller, question
        Its name, and what was searched: `HARDEST` or `NEAREST`.
    failed, outcome, end_time, message, failure, missed, margin
        How the run ended, as in `Failure`.
    severity
        As in `Trial`.
    distance
        Distance from the scenario itself in the cube, as a share of the cube's diagonal.
    runs
        Number of runs that the search took.
    changes
        By coordinate, its distance from the scenario as a share of its range, farthest first.
    point, noise
        Its point in the cube, and the index of the sample whose noise it has.
    file
        Its scenario file beside the result.
    """

    controller: str
    question: str
    failed: bool
    outcome: str
    end_time: float | None
    message: str | None
    failure: str
    missed: tuple[str, ...]
    margin: float | None
    severity: float
    distance: float
    runs: int
    changes: dict[str, float]
    point: tuple[float, ...]
    noise: int
    file: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """Every controller on the same samples, and the worst that a search found.

    Attributes
    ----------
    seed, samples
        Seed of the campaign, and its number of samples.
    integrator, timestep
        MuJoCo's integrator, and its step [s], None for the default.
    confidence
        Confidence level of the intervals [1].
    space
        The space that the samples are drawn from.
    controllers, comparisons, worst_cases
        What was found; no worst cases if none were searched.
    film
        Whether the hardest samples are to be filmed.
    assumed
        Whether the scenario did not say what varies, so that `with_ranges` decided.
    """

    seed: int
    samples: int
    integrator: str
    timestep: float | None
    confidence: float
    space: SampleSpace
    controllers: tuple[ControllerRates, ...]
    comparisons: tuple[Comparison, ...]
    worst_cases: tuple[WorstCase, ...]
    film: bool = False
    assumed: bool = False

    def scenario_of(self, one: WorstCase) -> Scenario:
        """Return the scenario of what a search found."""
        return worst_scenario(self.space, one.point, one.noise, self.seed, one.question)

    @property
    def judged(self) -> bool:
        """Whether more than completion decides what passes."""
        scenario = self.space.scenario
        rail = "rail_half_length" in self.space.varied
        return rail or bool(scenario.required.keys() - {"completes"})


def result_of(
    campaign: Campaign,
    found: Sequence[Found],
    *,
    keep: int | None = None,
    asked: Mapping[str, str] | None = None,
    film: bool = False,
    assumed: bool = False,
) -> Result:
    """Return a campaign and what the searches found as a result.

    Parameters
    ----------
    keep
        How many failures of each controller have a scenario file; ``None`` for all.
    asked
        The name by which each controller was requested, if it differs from its own.
    film, assumed
        As in `Result`.
    """
    names = {name: name for name in campaign.trials} | dict(asked or {})
    return Result(
        seed=campaign.seed,
        samples=campaign.samples,
        integrator=campaign.settings.integrator,
        timestep=campaign.settings.timestep,
        confidence=CONFIDENCE,
        space=campaign.space,
        controllers=tuple(_rates(campaign, name, names[name], keep) for name in campaign.trials),
        comparisons=tuple(
            Comparison(first=a, second=b, p_value=pairing.p_value, **asdict(pairing))
            for (a, b), pairing in campaign.pairings().items()
        ),
        worst_cases=tuple(_worst(campaign, one) for one in found),
        film=film,
        assumed=assumed,
    )


def _rates(campaign: Campaign, name: str, asked: str, keep: int | None) -> ControllerRates:
    """Return one controller's rates and failures."""
    passed, settled = campaign.success(name), campaign.settling(name)
    median, largest = campaign.peak_displacement(name) or (None, None)
    kinds = [trial.failure for trial in campaign.trials[name]]
    margins = [trial.margin for trial in campaign.trials[name] if trial.margin is not None]
    missed = [requirement for trial in campaign.trials[name] for requirement in trial.missed]
    failures = campaign.failures(name)
    kept = set(failures[:keep])
    return ControllerRates(
        controller=name,
        asked=asked,
        samples=campaign.samples,
        passed=passed.count,
        rate=passed.share,
        interval=passed.interval,
        settled=settled.count,
        settled_rate=settled.share,
        settled_interval=settled.interval,
        median_displacement=median,
        largest_displacement=largest,
        failures_by_kind={kind: kinds.count(kind) for kind in sorted(set(kinds) - {""})},
        margins=tuple(np.quantile(margins, QUANTILES).tolist()) if margins else (),
        unmargined=campaign.samples - len(margins),
        missed={requirement: missed.count(requirement) for requirement in sorted(set(missed))},
        failures=tuple(
            Failure(
                index=i,
                file=f"{FOLDER}/{name}/failure-{i:04d}.toml" if i in kept else None,
                **_ending(campaign.trials[name][i]),
            )
            for i in failures
        ),
    )


def _worst(campaign: Campaign, found: Found) -> WorstCase:
    """Return what a search found."""
    return WorstCase(
        controller=found.controller,
        question=found.question,
        failed=not found.trial.passed,
        severity=found.trial.severity(campaign.space.scenario.duration),
        distance=found.distance,
        runs=found.runs,
        changes=found.changes,
        point=tuple(found.point.tolist()),
        noise=found.noise,
        file=f"{FOLDER}/{found.controller}/{NAMES[found.question]}",
        **_ending(found.trial),
    )


def _ending(trial: Trial) -> dict[str, Any]:
    """Return how a trial ended, with a missing time as None."""
    time = None if math.isnan(trial.end_time) else trial.end_time
    ending = {"outcome": trial.outcome, "end_time": time, "message": trial.message}
    return {**ending, "failure": trial.failure, "missed": trial.missed, "margin": trial.margin}
