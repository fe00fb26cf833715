"""A run of a controller with the estimator, and the estimates along the way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.estimation.estimated_controller import EstimatedController
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.sampled.runs import simulate_sampled, ticks_of
from afl_mujoco.simulation.trajectory import Trajectory


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EstimatedRun:
    """A run and its estimates."""

    run: Trajectory  # the run
    time: NDArray[np.float64]  # control ticks that the run reached [s], shape (T,)
    # M [kg] and l [m] that the command of each tick assumed, shape (T,)
    cart_mass: NDArray[np.float64]
    half_length: NDArray[np.float64]


def simulate_estimated(
    scenario: Scenario,
    controller: EstimatedController,
    *,
    timestep: float | None = None,
    control_period: float | None = None,
    integrator: str = "RK4",
) -> EstimatedRun:
    """Simulate a scenario as `simulate_mujoco` does in sampled mode, and keep the estimates."""
    period = ticks_of(scenario, timestep, control_period).period
    estimates = np.full((int(scenario.duration / period) + 2, 2), np.nan)
    run = simulate_sampled(
        scenario,
        controller,
        timestep=timestep,
        control_period=control_period,
        integrator=integrator,
        estimates=estimates,
    )
    assumed = estimates[~np.isnan(estimates[:, 0])]
    time = np.asarray(np.arange(len(assumed)) * period, dtype=np.float64)
    return EstimatedRun(run=run, time=time, cart_mass=assumed[:, 0], half_length=assumed[:, 1])
