"""The loop that is told M and l by the estimator, against the one that is told the truth."""

from __future__ import annotations

import functools
import statistics
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from afl_mujoco.control.controllers import CONTROLLERS, ESTIMATED, find_controller
from afl_mujoco.control.estimation.estimated_law import EstimatedLaw
from afl_mujoco.control.law import Law
from afl_mujoco.control.user_law.python_law import PythonLaw
from afl_mujoco.errors import InvalidValueError, UnknownNameError
from afl_mujoco.scenario.catalogue import SCENARIOS
from afl_mujoco.scenario.parameters import require_distinct
from afl_mujoco.scenario.realism import IDEAL, Realism
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.ensemble.objective import ObjectiveScales
from afl_mujoco.simulation.mujoco_rollout import simulate_mujoco
from afl_mujoco.simulation.sampled.estimated import EstimatedRun, simulate_estimated
from afl_mujoco.simulation.trajectory import COMPLETED, Trajectory
from afl_mujoco.validation.estimation.tracking import FOUND, WINDOWS, Tracking, tracking
from afl_mujoco.validation.metrics import Metrics, metrics, nominal_scales, with_objective

CASES = ("step-step", "step-trapezoid", "trapezoid-step", "trapezoid-trapezoid")
"""The paper's four schedules."""

NOISE = Realism(noise_z=1e-4, noise_phi=5e-4)
"""The usual noise: 0.1 mm and 0.5 mrad, as of encoders of 0.35 mm and 3600 counts a turn."""

FIGURES = ("objective", "iae_z", "iae_phi", "max_force")
"""What is reported of a loop."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Loop:
    """What one loop costs.

    Attributes
    ----------
    told
        What tells the law M and l: ``"truth"``, ``"nominal plant"`` or ``"estimator"``.
    noise
        Whether the sensors are noisy.
    runs, completed
        How many there were, and how many of them kept the pole up.
    figures
        Median over the runs of each of `FIGURES`; ``None`` if a run did not complete.
    largest_force
        The largest of any run [N]; ``None`` if a run did not complete.
    """

    told: str
    noise: bool
    runs: int
    completed: int
    figures: Metrics
    largest_force: float | None

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data."""
        return asdict(self)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Case:
    """What was found on one schedule.

    Attributes
    ----------
    scenario, controller
        What was simulated; the law by the name that it has when it is told the truth.
    cart_mass, half_length
        How M and l were tracked under noise, one for each seed.
    noise
        What the sensors do in the noisy runs.
    loops
        What each loop costs.
    oracle, estimated
        Runs to draw: told the truth without noise, and told by the estimator under the first noise.
    """

    scenario: Scenario
    controller: str
    cart_mass: tuple[Tracking, ...]
    half_length: tuple[Tracking, ...]
    noise: Realism
    loops: tuple[Loop, ...]
    oracle: Trajectory
    estimated: EstimatedRun

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data, without the runs."""
        return {
            "scenario": self.scenario.name,
            "controller": self.controller,
            "cart_mass": [one.to_dict() for one in self.cart_mass],
            "half_length": [one.to_dict() for one in self.half_length],
            "loops": [loop.to_dict() for loop in self.loops],
        }


def require_study(controller: str, cases: Sequence[str], seeds: int) -> EstimatedLaw:
    """Return the law that is told by the estimator, or raise before anything is run.

    Parameters
    ----------
    controller, cases, seeds
        As of `study_estimation`.

    Raises
    ------
    AflMujocoError
        If there is no such law or scenario, or a setting breaks its rule.
    """
    if seeds < 1:
        raise InvalidValueError("seeds", "must be at least 1", seeds)
    law = find_controller(controller)
    if isinstance(law, EstimatedLaw | PythonLaw) or law.belief is not None:
        rule = "must be a compiled law that is told M and l: the study lets the estimator tell it"
        raise InvalidValueError(f"controller {controller!r}", rule)
    for name in cases:
        if name not in SCENARIOS:
            raise UnknownNameError.among("scenario", name, SCENARIOS)
    require_distinct("scenario", cases)
    return EstimatedLaw(name=f"{controller}{ESTIMATED}", law=law)


def study_estimation(
    controller: str = "adaptive",
    cases: Sequence[str] = CASES,
    *,
    seeds: int = 8,
    noise: Realism = NOISE,
    progress: Callable[[int], None] = lambda done: None,
) -> tuple[Case, ...]:
    """Measure tracking and closed loop on the paper's schedules, as deployed at 1 kHz.

    Parameters
    ----------
    controller
        A law that has a twin told by the estimator.
    cases
        Scenarios by name.
    seeds
        How many runs there are under noise.
    noise
        What the sensors do; its seed counts from here.
    progress
        Called with the number of cases done.

    Returns
    -------
    tuple of Case
        In the order of `cases`.

    Raises
    ------
    AflMujocoError
        If there is no such law or scenario.
    """
    told = require_study(controller, cases, seeds)
    found = []
    for name in cases:
        found.append(_case(SCENARIOS[name], controller, told, seeds, noise))
        progress(len(found))
    return tuple(found)


def _case(
    scenario: Scenario, controller: str, told: EstimatedLaw, seeds: int, noise: Realism
) -> Case:
    """Return what is found on one schedule."""
    noisy = [
        replace(scenario, realism=replace(noise, seed=noise.seed + seed)) for seed in range(seeds)
    ]
    runs = [simulate_estimated(one, told) for one in noisy]
    quiet = simulate_estimated(scenario, told).run
    oracle = simulate_mujoco(scenario, told.law, "sampled")
    jittery = [simulate_mujoco(one, told.law, "sampled") for one in noisy]
    loops = [
        _loop("truth", scenario, told.law, [oracle]),
        _loop("truth", noisy[0], told.law, jittery),
        _loop("estimator", scenario, told, [quiet]),
        _loop("estimator", noisy[0], told, [found.run for found in runs]),
    ]
    if (nominal := CONTROLLERS.get(f"{controller}-nominal")) is not None:
        run = simulate_mujoco(scenario, nominal, "sampled")
        loops.append(_loop("nominal plant", scenario, nominal, [run]))
    return Case(
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


def _loop(told: str, scenario: Scenario, law: Law, runs: Sequence[Trajectory]) -> Loop:
    """Return what some runs of one loop cost."""
    each = [with_objective(metrics(scenario, law, run), _scales()) for run in runs]
    known = {name: [x for one in each if (x := one[name]) is not None] for name in FIGURES}
    whole = all(len(values) == len(runs) for values in known.values())
    return Loop(
        told=told,
        noise=scenario.realism != IDEAL,
        runs=len(runs),
        completed=sum(run.outcome.kind == COMPLETED for run in runs),
        figures={n: statistics.median(x) if whole else None for n, x in known.items()},
        largest_force=max(known["max_force"]) if whole else None,
    )


def describe(cases: Sequence[Case]) -> dict[str, Any]:
    """Return a study as plain data: its cases, the windows of the errors, the bound of a find.

    Parameters
    ----------
    cases
        From `study_estimation`.
    """
    return {
        "controller": cases[0].controller,
        "windows": list(WINDOWS),
        "found_within": FOUND,
        "noise": {"z": cases[0].noise.noise_z, "phi": cases[0].noise.noise_phi},
        "cases": [case.to_dict() for case in cases],
    }
