"""The closed loop with estimated parameters against those with the true and the nominal ones."""

from __future__ import annotations

import functools
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from afl_mujoco.control.catalogue import CONTROLLERS, find_controller
from afl_mujoco.control.controller import Controller
from afl_mujoco.control.estimator import EstimatedController
from afl_mujoco.control.names import ESTIMATED as SUFFIX
from afl_mujoco.errors import InvalidValueError, UnknownNameError, require_count
from afl_mujoco.scenario.catalogue import SCENARIOS
from afl_mujoco.scenario.imperfections import IDEAL, Imperfections
from afl_mujoco.scenario.parameters import require_distinct
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.metrics import Metrics, metrics
from afl_mujoco.simulation.mujoco_rollout import simulate_mujoco
from afl_mujoco.simulation.sampled.runs import EstimatedRun, simulate_estimated
from afl_mujoco.simulation.scoring import ObjectiveScales, nominal_scales, with_objective
from afl_mujoco.simulation.trajectory import COMPLETED, Trajectory
from afl_mujoco.studies.estimation.tracking import Tracking, tracking

CASES = ("step-step", "step-trapezoid", "trapezoid-step", "trapezoid-trapezoid")
"""The paper's four schedules."""

NOISE = Imperfections(noise_z=1e-4, noise_phi=5e-4)
"""The usual noise: 0.1 mm and 0.5 mrad, as from encoders of 0.35 mm and 3600 counts per turn."""

TRUE, NOMINAL, ESTIMATED = "true", "nominal", "estimated"
"""Kinds of M and l that a controller assumes."""

METRICS = ("objective", "iae_z", "iae_phi", "max_force")
"""Metrics that are reported for a loop."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Loop:
    """The cost of one loop.

    Attributes
    ----------
    parameters
        Which M and l the controller assumes: `TRUE`, `NOMINAL` or `ESTIMATED`.
    noise
        Whether the sensors are noisy.
    runs, completed
        Number of runs, and of those in which the pole did not fall.
    metrics
        Median over the runs of each of `METRICS`; ``None`` if a run did not complete.
    largest_force
        Largest force of any run [N]; ``None`` if a run did not complete.
    """

    parameters: str
    noise: bool
    runs: int
    completed: int
    metrics: Metrics
    largest_force: float | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Runs:
    """The runs on one schedule.

    Attributes
    ----------
    scenario, controller
        What was simulated; the controller by its name with the true parameters.
    cart_mass, half_length
        How M and l were tracked under noise, one for each seed.
    noise
        Imperfections of the sensors in the noisy runs.
    loops
        The cost of each loop.
    oracle, estimated
        Runs to draw: with the true parameters and no noise, and with the estimated parameters under
        the noise of the first seed.
    """

    scenario: Scenario
    controller: str
    cart_mass: tuple[Tracking, ...]
    half_length: tuple[Tracking, ...]
    noise: Imperfections
    loops: tuple[Loop, ...]
    oracle: Trajectory
    estimated: EstimatedRun


MOST_SEEDS = 1000


def require_study(name: str, cases: Sequence[str], seeds: int) -> EstimatedController:
    """Return the controller with the estimator, or raise before anything is run."""
    require_count("seeds", seeds, 1, MOST_SEEDS)
    controller = find_controller(name)
    if controller.estimates or controller.interpreted or controller.belief is not None:
        rule = "must be a compiled controller that takes M and l: the study estimates them"
        raise InvalidValueError(f"controller {name!r}", rule)
    for case in cases:
        if case not in SCENARIOS:
            raise UnknownNameError.among("scenario", case, SCENARIOS)
    require_distinct("scenario", cases)
    return EstimatedController(name=f"{name}{SUFFIX}", controller=controller)


class Unit(NamedTuple):
    """What a worker is asked to run: a scenario by name, a controller, a number of seeds, noise.

    Also the physics step [s], None for that of `simulate_mujoco`.
    """

    scenario: str
    controller: str
    seeds: int
    noise: Imperfections = NOISE
    timestep: float | None = None


def run_case(unit: Unit) -> Runs:
    """Return the runs on one schedule, the force held over each physics step, with costs."""
    scenario, controller, seeds, noise, step = SCENARIOS[unit.scenario], *unit[1:]
    estimating = require_study(controller, (unit.scenario,), seeds)
    noisy = [
        replace(scenario, imperfections=replace(noise, seed=noise.seed + seed))
        for seed in range(seeds)
    ]
    runs = [simulate_estimated(one, estimating, timestep=step) for one in noisy]
    quiet = simulate_estimated(scenario, estimating, timestep=step).run
    oracle = simulate_mujoco(scenario, estimating.controller, "sampled", timestep=step)
    jittery = [
        simulate_mujoco(one, estimating.controller, "sampled", timestep=step) for one in noisy
    ]
    loops = [
        _loop(TRUE, scenario, estimating.controller, [oracle]),
        _loop(TRUE, noisy[0], estimating.controller, jittery),
        _loop(ESTIMATED, scenario, estimating, [quiet]),
        _loop(ESTIMATED, noisy[0], estimating, [found.run for found in runs]),
    ]
    if (nominal := CONTROLLERS.get(f"{controller}-nominal")) is not None:
        run = simulate_mujoco(scenario, nominal, "sampled", timestep=step)
        loops.append(_loop(NOMINAL, scenario, nominal, [run]))
    return Runs(
        scenario=scenario,
        controller=controller,
        cart_mass=tuple(tracking(scenario.cart_mass, r.time, r.cart_mass) for r in runs),
        half_length=tuple(tracking(scenario.half_length, r.time, r.half_length) for r in runs),
        noise=noise,
        loops=tuple(loops),
        oracle=oracle,
        estimated=runs[0],
    )


@functools.cache
def _scales() -> ObjectiveScales:
    """Return the scales of the objective (O1)."""
    return nominal_scales(1e-3)


def _loop(
    parameters: str, scenario: Scenario, controller: Controller, runs: Sequence[Trajectory]
) -> Loop:
    """Return the cost of one loop over its runs."""
    each = [with_objective(metrics(scenario, controller, run), _scales()) for run in runs]
    known = {name: [x for one in each if (x := one[name]) is not None] for name in METRICS}
    whole = all(len(values) == len(runs) for values in known.values())
    return Loop(
        parameters=parameters,
        noise=scenario.imperfections != IDEAL,
        runs=len(runs),
        completed=sum(run.outcome.kind == COMPLETED for run in runs),
        metrics={n: statistics.median(x) if whole else None for n, x in known.items()},
        largest_force=max(known["max_force"]) if whole else None,
    )
