"""A case, a scenario with a controller: its runs in every simulator, and their metrics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from afl_mujoco.control.catalogue import require_stateless
from afl_mujoco.control.controller import Controller
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.time_steps import DEFAULT, ticks_of
from afl_mujoco.simulation.bound_controllers import bound
from afl_mujoco.simulation.metrics import Metrics, metrics
from afl_mujoco.simulation.mujoco_rollout import simulate_mujoco
from afl_mujoco.simulation.ode import simulate_ode
from afl_mujoco.simulation.ode_fixed_step import simulate_ode_held, simulate_ode_rk4
from afl_mujoco.simulation.trajectory import Trajectory, criterion_of, has_ended
from afl_mujoco.studies.shared.robustness import require_runs

REPORTED = ("ode", "mujoco exact", "mujoco continuous", "mujoco sampled")
"""Simulators whose metrics the report gives; the others are references of checks."""

DEPLOYED = "mujoco sampled"  # the simulator in which requirements are judged
DECISIVE = "mujoco continuous"
"""The simulator whose metrics count: the controller as published, in MuJoCo."""


@dataclass(frozen=True, slots=True)
class Settings:
    """Step sizes [s], and whether the refinement studies are run as well."""

    timestep: float = 1e-3
    control_period: float = 1e-3
    full: bool = False


Case = tuple[Scenario, Controller, Settings]


@dataclass(frozen=True, slots=True, kw_only=True)
class Simulated:
    """One case in one simulator: how it ended, and its metrics."""

    scenario: str
    controller: str
    simulator: str
    outcome: str
    metrics: Metrics


def closed_loop_runs(
    scenario: Scenario, controller: Controller, settings: Settings
) -> dict[str, Trajectory]:
    """Simulate a scenario in every simulator that the checks compare, by name."""
    h, period = settings.timestep, settings.control_period
    runs = (
        simulate_ode(scenario, controller, sample_period=h),
        simulate_mujoco(scenario, controller, "exact", timestep=h),
        simulate_mujoco(scenario, controller, "continuous", timestep=h),
        simulate_mujoco(scenario, controller, "sampled", timestep=h, control_period=period),
        simulate_ode_rk4(scenario, controller, timestep=h),
        simulate_ode_held(scenario, controller, timestep=h, control_period=period),
    )
    return {run.simulator: run for run in runs}


def reported_runs(
    scenario: Scenario, controller: Controller, runs: Mapping[str, Trajectory]
) -> tuple[Simulated, ...]:
    """Return the runs of `REPORTED` with their metrics, except the objective."""
    return tuple(
        Simulated(
            scenario=scenario.name,
            controller=controller.name,
            simulator=name,
            outcome=str(runs[name].outcome),
            metrics=metrics(scenario, controller, runs[name]),
        )
        for name in REPORTED
        if name in runs
    )


def require_runnable(
    scenarios: Sequence[Scenario], controllers: Sequence[Controller], settings: Settings
) -> None:
    """Raise if some scenarios cannot be run with some controllers in every simulator."""
    require_runs(controllers, scenarios, DEFAULT)
    for controller in controllers:
        if controller.estimates:
            raise InvalidValueError(f"controller {controller.name!r}", controller.not_compiled)
    if len({(s.plant.name, s.plant.origin) for s in scenarios}) > 1:
        known = ", ".join(dict.fromkeys(s.plant.name for s in scenarios))
        raise InvalidValueError("scenarios", "must be of one plant in a comparison", known)
    for scenario in scenarios:
        ticks_of(scenario.ideal, settings.timestep, settings.control_period)
        start = np.array(scenario.initial_state)
        place = f"scenario {scenario.name!r}: initial_state"
        told = scenario.told_values(np.zeros(1))[0]
        if has_ended(criterion_of(scenario), start):
            rule = "must not be where a run ends: that leaves nothing to compare"
            raise InvalidValueError(place, rule)
        for controller in controllers:
            require_stateless(controller, "this comparison")
            own = bound(controller, scenario)
            if own.interpreted:  # a run shows what it does
                continue
            if not np.isfinite(own.command(0.0, start, own.assumed(told))).all():
                raise InvalidValueError(place, f"must be one at which {own.name} has an input")
