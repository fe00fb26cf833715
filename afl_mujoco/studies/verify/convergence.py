"""Refinement studies: observed orders, and whether an error vanishes or stays (A4, B2, B4, B6)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
from scipy.integrate import solve_ivp

from afl_mujoco.control.controller import Controller
from afl_mujoco.plants.cartpole_equations import acceleration
from afl_mujoco.plants.plant import Floats
from afl_mujoco.scenario.parameters import CartPoleParameters
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.schedules import Schedule
from afl_mujoco.simulation.mujoco_model import CartPoleModel, write_state
from afl_mujoco.simulation.mujoco_rollout import simulate_mujoco
from afl_mujoco.simulation.ode_fixed_step import Holds, simulate_ode_held
from afl_mujoco.simulation.trajectory import Trajectory

STEPS = (2e-3, 1e-3, 5e-4, 2.5e-4)  # steps of the closed-loop studies [s]
SCHEDULE_STEPS = (4e-3, 2e-3, 1e-3, 5e-4)  # steps over which the schedule alone is held [s]
AFTERMATH = 0.5
"""Time for which a study continues after the last breakpoint [s]: nothing happens later."""


@dataclass(frozen=True, slots=True)
class Study:
    """The largest error of any state at ever smaller steps [s]."""

    steps: tuple[float, ...]
    errors: tuple[float, ...]

    @property
    def reduction(self) -> float:
        """Error at the fourth step over that at the second; infinite if there is none to reduce."""
        return self.errors[3] / self.errors[1] if self.errors[1] else math.inf

    def deviation(self, expected: float) -> float:
        """Return how far the logarithmic slope is from an order; NaN where there is none."""
        if not all(math.isfinite(error) and error > 0.0 for error in self.errors):
            return math.nan
        return abs(float(np.polyfit(np.log(self.steps), np.log(self.errors), 1)[0]) - expected)


def studied(scenario: Scenario) -> Scenario:
    """Return the scenario cut to half a second after its last breakpoint, at least 2 s.

    Knots of its schedules are moved to the nearest of the longest steps: inside a step a jump acts
    at its nearest end, an error that no order describes.
    """
    moved = {name: _on_steps(one) for name, one in scenario.schedule.items()}
    scenario = replace(scenario, schedule=moved)
    last = max((*scenario.breakpoints, 1.5))
    duration = np.ceil((last + AFTERMATH) / STEPS[0] - 1e-9) * STEPS[0]
    if duration >= scenario.duration:
        return scenario
    asked = replace(scenario.requirements, settling_time=None, recover_within=None)
    return replace(scenario, duration=float(duration), requirements=asked)


def _on_steps(one: Schedule) -> Schedule:
    """Return a schedule with its knots on `SCHEDULE_STEPS`, as it is where some would meet."""
    times = np.round(np.array(one.times) / SCHEDULE_STEPS[0]) * SCHEDULE_STEPS[0]
    if ((np.diff(times) > 0.0) != (np.diff(one.times) > 0.0)).any():
        return one
    return replace(one, times=tuple(times.tolist()))


def difference(run: Trajectory, reference: Trajectory) -> float:
    """Return the largest difference of any state at the instants of the reference."""
    index = np.searchsorted(run.time, reference.time - 1e-9)
    if len(run.time) < len(reference.time) or index[-1] >= len(run.time):
        return float("inf")
    return float(np.abs(run.state[index] - reference.state).max())


def continuous_study(
    scenario: Scenario, controller: Controller, reference: Trajectory, **how: Any
) -> Study:
    """Return the error of continuous mode, over `STEPS`, from the ODE reported every STEPS[0]."""
    runs = (simulate_mujoco(scenario, controller, "continuous", timestep=h, **how) for h in STEPS)
    return Study(STEPS, tuple(difference(run, reference) for run in runs))


def sampled_study(
    scenario: Scenario,
    controller: Controller,
    reference: Trajectory,
    steps: tuple[float, ...] = STEPS,
) -> tuple[Study, float]:
    """Return the error of sampled mode over steps, and of extrapolation from the last two."""
    on_grid = np.isin(np.round(reference.time / STEPS[0], 6) % 1.0, (0.0, 1.0))
    wanted = reference.time[on_grid]
    states = []
    for h in steps:
        run = simulate_mujoco(scenario, controller, "sampled", timestep=h)
        states.append(run.state[np.searchsorted(run.time, wanted - 1e-9)])
    truth = reference.state[on_grid]
    errors = tuple(float(np.abs(state - truth).max()) for state in states)
    extrapolated = 2.0 * states[-1] - states[-2]
    return Study(steps, errors), float(np.abs(extrapolated - truth).max())


def schedule_study(scenario: Scenario, controller: Controller) -> Study | None:
    """Return the error of holding the schedule alone, over `SCHEDULE_STEPS`; None without ramps."""
    if not any(rate for segment in scenario.segments for _, rate in segment.lines):
        return None
    errors = []
    for h in SCHEDULE_STEPS:
        held = simulate_ode_held(
            scenario, controller, timestep=h, holds=Holds(schedule=True), substeps=4
        )
        followed = simulate_ode_held(scenario, controller, timestep=h, holds=Holds(), substeps=4)
        errors.append(difference(held, followed))
    return Study(SCHEDULE_STEPS, tuple(errors))


def free_swing_study(integrator: str, steps: Sequence[float]) -> Study:
    """Return the error of `mj_step` without force, from -60 degrees, against (P3), (P4)."""
    p = CartPoleParameters(cart_mass=0.7, pole_mass=0.2, half_length=0.4, gravity=9.7)
    start = np.array([0.1, -np.pi / 3, 0.2, 0.3])

    def rate(_: float, state: Floats) -> Floats:
        return np.concatenate([state[2:], acceleration(state, 0.0, p)])

    truth = last_state(rate, start, 1.0)
    errors = []
    for h in steps:
        model = CartPoleModel(p, timestep=h, integrator=integrator)
        write_state(model.addresses, start)
        mujoco.mj_step(model.mj_model, model.mj_data, round(1.0 / h))
        state = np.concatenate([model.mj_data.qpos, model.mj_data.qvel])
        errors.append(float(np.abs(state - truth).max()))
    return Study(tuple(steps), tuple(errors))


def last_state(rate: Callable[[float, Floats], Floats], start: Floats, duration: float) -> Floats:
    """Return the state at the end of a smooth problem, by DOP853 to near round-off."""
    solution = solve_ivp(rate, (0.0, duration), start, method="DOP853", rtol=1e-13, atol=1e-14)
    return np.asarray(solution.y[:, -1])
