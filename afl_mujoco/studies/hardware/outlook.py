"""What controllers would do on the identified cart-pole, and what would have to change."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from afl_mujoco.control.catalogue import find_controller
from afl_mujoco.control.controller import Controller
from afl_mujoco.identification.export import draws as drawn_scenarios
from afl_mujoco.identification.export import with_values
from afl_mujoco.identification.identify import Identified
from afl_mujoco.scenario.requirements import NONE
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.sampled.rollouts import Rollouts, run_rollouts
from afl_mujoco.studies.hardware.result import Survival

CONTROLLERS = ("adaptive", "adaptive-retuned", "lqr")
"""The paper's controller, the same with gains found here, and a baseline."""

ANGLES = (1, 2, 3, 5, 7, 10, 15, 20, 25, 30, 35, 40, 45, 50, 55, 60, 65, 70, 75, 80)
"""Starting angles that are tried, to either side [deg]."""

AS_IT_IS = "as it is"

TIMESTEP = 1e-3
"""Longest physics step [s]; the step that is used divides the control period."""


def changes(scenario: Scenario) -> dict[str, Scenario]:
    """Return a cart-pole as it is, and with its limits relaxed, by the name of the change."""
    r = scenario.imperfections
    rail, force = r.rail_half_length, r.force_limit
    longer = {} if rail is None else {"rail_half_length": 4.0 * rail}
    stronger = {} if force is None else {"force_limit": 4.0 * force}
    period = 0.1 * (r.control_period or TIMESTEP)
    exact = {"encoder_step_z": 0.0, "encoder_step_phi": 0.0, "differentiated": False}
    found: dict[str, dict[str, Any]] = {
        AS_IT_IS: {},
        "rail x4": longer,
        "force x4": stronger,
        "rail and force x4": {**longer, **stronger},
        "ten times the control rate, no delay": {"control_period": period, "delay": 0.0},
        "exact sensors": exact,
        "drive makes up for rail damping": {"rail_damping": 0.0},
        "drive makes up for rail damping, rail and force x4": {
            "rail_damping": 0.0,
            **longer,
            **stronger,
        },
    }
    return {
        name: _with(scenario, **changed)
        for name, changed in found.items()
        if name == AS_IT_IS or changed
    }


def outlook(
    identified: Identified, count: int, seed: int, workers: int = 1
) -> tuple[Survival, ...]:
    """Return what each controller survives.

    Parameters
    ----------
    count, seed
        Number of cart-poles drawn from the distribution of the estimates, and the seed for it.
    workers
        Number of threads; the results do not depend on it.
    """
    base = with_values(identified, identified.values)
    drawn = drawn_scenarios(identified, count, seed)
    found = []
    for name in CONTROLLERS:
        controller = find_controller(name)
        runs = run_rollouts(drawn, controller, threads=workers)
        found.append(
            Survival(
                controller=name,
                angles={
                    what: _largest_angle(changed, controller, workers)
                    for what, changed in changes(base).items()
                },
                runs=count,
                survived=sum(_survives(runs, i) for i in range(count)),
            )
        )
    return tuple(found)


def _largest_angle(scenario: Scenario, controller: Controller, workers: int) -> float:
    """Return the largest starting angle that is survived, as are all smaller ones [rad]."""
    starts = [
        replace(scenario, initial_state=(0.0, sign * math.radians(angle), 0.0, 0.0))
        for angle in ANGLES
        for sign in (-1.0, 1.0)
    ]
    runs = run_rollouts(starts, controller, threads=workers)
    largest = 0
    for i, angle in enumerate(ANGLES):
        if not (_survives(runs, 2 * i) and _survives(runs, 2 * i + 1)):
            break
        largest = angle
    return math.radians(largest)


def _survives(runs: Rollouts, index: int) -> bool:
    """Return whether a run ends upright and the cart never reaches the end of its rail."""
    return not runs.failure(index)


def _with(scenario: Scenario, **changed: Any) -> Scenario:
    """Return a scenario with some imperfections changed, without requirements of its own."""
    return replace(
        scenario, imperfections=replace(scenario.imperfections, **changed), requirements=NONE
    )
