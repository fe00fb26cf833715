"""Every controller on the same samples, shared among workers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.controller import Controller
from afl_mujoco.errors import InvalidValueError, require_count
from afl_mujoco.execution.executors import Executor, compute_all
from afl_mujoco.scenario.belief import ERROR
from afl_mujoco.scenario.parameters import require_distinct
from afl_mujoco.scenario.ranges import SCHEDULES
from afl_mujoco.scenario.sample_space import SampleSpace, sample_scenario
from afl_mujoco.simulation.mujoco_model import require_integrator
from afl_mujoco.simulation.sampled.runs import ticks_of
from afl_mujoco.studies.monte_carlo.rates import Pairing, Rate, pair
from afl_mujoco.studies.monte_carlo.trial import Settings, Trial, run_trials

CHUNK = 20
"""Number of samples that a worker runs at a time."""

LARGEST_SEED = 2**63 - 1
MOST_SAMPLES = 1_000_000


class SampleUnit(NamedTuple):
    """What a worker is asked to run.

    Attributes
    ----------
    controller
        The controller.
    space
        The space that the samples are drawn from.
    seed
        Seed of the campaign.
    indices
        Indices of the samples.
    settings
        How to run them.
    """

    controller: Controller
    space: SampleSpace
    seed: int
    indices: range
    settings: Settings


@dataclass(frozen=True, slots=True, kw_only=True)
class Campaign:
    """The outcome of every controller on every sample.

    Attributes
    ----------
    space, seed, settings
        What was run, and how.
    trials
        By the controller's name, one trial for each sample, in order.
    """

    space: SampleSpace
    seed: int
    settings: Settings
    trials: Mapping[str, Sequence[Trial]]

    @property
    def samples(self) -> int:
        """How many samples there are."""
        return len(next(iter(self.trials.values())))

    def success(self, name: str) -> Rate:
        """Return how often a controller passed, by `Trial.passed`."""
        return Rate(sum(trial.passed for trial in self.trials[name]), self.samples)

    def settling(self, name: str) -> Rate:
        """Return how often a controller settled."""
        return Rate(sum(trial.settled for trial in self.trials[name]), self.samples)

    def failures(self, name: str) -> list[int]:
        """Return the indices of the samples that a controller did not pass."""
        return [i for i, trial in enumerate(self.trials[name]) if not trial.passed]

    def peak_displacement(self, name: str) -> tuple[float, float] | None:
        """Return the median and the largest peak abs(z) [m] of the runs that passed."""
        peaks = [trial.peak_z for trial in self.trials[name] if trial.passed]
        return (float(np.median(peaks)), max(peaks)) if peaks else None

    def pairings(self) -> dict[tuple[str, str], Pairing]:
        """Return the comparison of every two controllers."""
        passed = {name: [t.passed for t in found] for name, found in self.trials.items()}
        return {(a, b): pair(passed[a], passed[b]) for a, b in combinations(passed, 2)}


def run_campaign(
    controllers: Sequence[Controller],
    space: SampleSpace,
    *,
    samples: int,
    seed: int,
    settings: Settings,
    executor: Executor,
    progress: Callable[[int, str], None] = lambda runs, controller: None,
) -> Campaign:
    """Run every controller on the same samples; the result does not depend on the workers."""
    require_campaign(controllers, space, samples=samples, seed=seed, settings=settings)
    chunks = [range(i, min(i + CHUNK, samples)) for i in range(0, samples, CHUNK)]
    units = [
        SampleUnit(controller, space, seed, chunk, settings)
        for controller in controllers
        for chunk in chunks
    ]
    done = 0

    def advance(index: int) -> None:
        nonlocal done
        done += len(units[index].indices)
        progress(done, units[index].controller.name)

    found = compute_all(run_samples, units, executor, advance)
    trials: dict[str, list[Trial]] = {controller.name: [] for controller in controllers}
    for unit, some in zip(units, found, strict=True):
        trials[unit.controller.name] += some
    return Campaign(space=space, seed=seed, settings=settings, trials=trials)


def run_samples(unit: SampleUnit) -> list[Trial]:
    """Run a controller on some samples."""
    scenarios = [sample_scenario(unit.space, i, unit.seed) for i in unit.indices]
    return run_trials(scenarios, unit.controller, unit.settings)


def _told(space: SampleSpace, name: str) -> NDArray[np.float64]:
    """Return levels of M [kg] or l [m] over the whole range that a controller may assume."""
    own = space.scenario.hardware(f"{name}{ERROR}")
    bounds, errors = space.bounds(name), space.varied.get(f"{name}{ERROR}", (own, own))
    known = space.scenario.belief.known(space.scenario.parameters_at(0.0))
    told = [
        known.changed(**{f"{name}{ERROR}": error}).told(name, value)
        for value in bounds
        for error in errors
    ]
    return np.linspace(min(told), max(told), 21)


def require_campaign(
    controllers: Sequence[Controller],
    space: SampleSpace,
    *,
    samples: int,
    seed: int,
    settings: Settings,
) -> None:
    """Raise if anything would break a campaign, before it begins."""
    require_distinct("controller", [controller.name for controller in controllers])
    require_count("samples", samples, 1, MOST_SAMPLES)
    if not 0 <= seed <= LARGEST_SEED:
        raise InvalidValueError("seed", "must lie in 0 to 2**63 - 1", seed)
    require_integrator(settings.integrator)
    scenario = space.scenario
    ticks_of(scenario, settings.timestep)
    masses, lengths = (_told(space, name) for name in SCHEDULES)
    plants = np.meshgrid(masses, lengths)
    for controller in controllers:
        if not controller.interpreted:  # raises if a gain is not positive
            controller.inputs_along_run(*plants, *scenario.told_constants)
