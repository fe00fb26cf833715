"""Checks of the closed loop, MuJoCo against the analytic model: A5, B1, B2, B2b and B3."""

from __future__ import annotations

import math

import numpy as np

from afl_mujoco.compiled import kernel
from afl_mujoco.control.controller import Controller
from afl_mujoco.scenario.disturbances import Impulse
from afl_mujoco.scenario.sampling import held_disturbances
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.ode_fixed_step import rk4_step
from afl_mujoco.simulation.trajectory import COMPLETED, TIPPED, Trajectory
from afl_mujoco.studies.verification.check import Check
from afl_mujoco.studies.verification.criteria import CRITERIA

B2_CONTROLLERS, B2_TIMESTEP = ("fixed", "adaptive"), 1e-3
"""Where B2 is judged: its limit is for RK4's error at 1 ms under the paper's two controllers."""

SLACK = 1e-12
"""How much an instant of the grid may be off by round-off [s]."""


def closed_loop_checks(
    scenario: Scenario, controller: Controller, runs: dict[str, Trajectory]
) -> tuple[Check, ...]:
    """Judge the runs of one scenario and controller."""
    values = {
        "A5": one_step_difference(scenario, runs["mujoco sampled"]),
        "B1": state_difference(runs["mujoco exact"], runs["ode"]),
        "B2b": state_difference(runs["mujoco continuous"], runs["ode RK4"]),
        "B3": state_difference(runs["mujoco sampled"], runs["ode held"]),
    }
    if controller.name in B2_CONTROLLERS and _timestep(runs["mujoco continuous"]) == B2_TIMESTEP:
        values["B2"] = state_difference(runs["mujoco continuous"], runs["ode"])
    return tuple(
        CRITERIA[id].judge(values[id], scenario.name, controller.name)
        for id in CRITERIA
        if id in values
    )


def _timestep(run: Trajectory) -> float:
    """Return the timestep of a run [s]."""
    return float(run.provenance["settings"]["timestep"])


def state_difference(one: Trajectory, other: Trajectory) -> float:
    """Return the largest difference of any state at any instant that both runs report.

    The difference is infinite if the runs did not end the same way, or leave nothing to compare.
    If both fell, they are compared up to `TIPPED`: beyond it the controller amplifies round-off.
    """
    if one.outcome.kind != other.outcome.kind:
        return math.inf
    count = min(len(one.time), len(other.time))
    if one.outcome.kind == COMPLETED and len(one.time) != len(other.time):
        return math.inf
    if not np.allclose(one.time[:count], other.time[:count], rtol=0.0, atol=1e-9):
        return math.inf
    difference = np.abs(one.state[:count] - other.state[:count])
    if one.outcome.kind != COMPLETED:
        steep = np.abs(one.state[:count, 1]) > TIPPED
        difference = difference[: int(np.argmax(steep)) if steep.any() else count]
    return float(difference.max()) if difference.size else math.inf


def one_step_difference(scenario: Scenario, run: Trajectory) -> float:
    """Return the largest difference between a MuJoCo step of a sampled run and a textbook RK4 step.

    Parameters
    ----------
    run
        A run of sampled mode with MuJoCo's RK4.
    """
    timestep = _timestep(run)
    middles = 0.5 * (run.time[:-1] + run.time[1:])
    plants = np.empty((len(middles), 3, 4))
    plants[..., 0], plants[..., 1] = scenario.cart_mass(middles)[:, None], scenario.pole_mass
    plants[..., 2], plants[..., 3] = scenario.half_length(middles)[:, None], scenario.gravity
    forces = run.force[:-1] + held_disturbances(scenario, run.time).push
    jumped = np.zeros(len(forces), dtype=np.bool_)
    for disturbance in scenario.disturbances:
        if isinstance(disturbance, Impulse):
            ends = run.time[1:] + SLACK
            jumped |= (ends - timestep <= disturbance.time) & (disturbance.time < ends)
    return float(_one_step_difference(run.state, forces, plants, timestep, jumped))


@kernel
def _one_step_difference(states, forces, plants, timestep, jumped):
    """Return the largest difference between each state and an RK4 step from the one before.

    A state that an impulse has just changed is left out.
    """
    worst = 0.0
    for k in range(len(forces)):
        if jumped[k]:
            continue
        after = rk4_step(states[k], forces[k], plants[k], timestep)
        for i in range(4):
            difference = abs(states[k + 1, i] - after[i])
            if not difference <= worst:
                worst = difference
    return worst
