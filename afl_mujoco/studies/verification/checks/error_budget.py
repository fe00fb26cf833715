"""The error budget (B5): why a run as deployed differs from the ideal ODE by as much as it does."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.controller import Controller
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.metrics import STATES
from afl_mujoco.simulation.ode_fixed_step import Holds, simulate_ode_held
from afl_mujoco.simulation.trajectory import COMPLETED, Trajectory

SUBSTEPS = 4
"""RK4 steps in each held step of the parts: their errors cancel in the differences."""

SOURCES = (
    "model_form",
    "integrator",
    "control_hold",
    "schedule_sampling",
    "disturbance_timing",
)
"""The sources of the difference."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AtWorst:
    """The signed difference where it is largest: there the parts and the residual add to the total.

    Attributes
    ----------
    state
        Which state: one of `metrics.STATES`.
    time
        Time [s].
    total, model_form, integrator, control_hold, schedule_sampling, disturbance_timing, residual
        As in `ErrorBudget`, signed, for that state at that time.
    """

    state: str
    time: float
    total: float
    model_form: float
    integrator: float
    control_hold: float
    schedule_sampling: float
    disturbance_timing: float
    residual: float

    def __post_init__(self) -> None:
        """Raise if there is no such state."""
        if self.state not in STATES:
            raise ValueError(f"state must be one of {', '.join(STATES)}, got {self.state!r}")


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorBudget:
    """The largest difference from the ideal ODE, and what each source alone contributes.

    Every value is the largest of any state at any instant [m, rad, m/s, rad/s].

    Attributes
    ----------
    scenario, controller
        What was simulated.
    total
        Sampled mode against the ODE.
    model_form
        MuJoCo's dynamics against the analytic ones, under one integrator.
    integrator
        MuJoCo's steps against the exact solution with the same holds.
    control_hold
        The force held over each control period.
    schedule_sampling
        M and l frozen over each step at the values of its middle.
    disturbance_timing
        Pulses and impulses moved to the steps.
    residual
        The total minus the sum of the parts, as curves.
    at_worst
        The same, signed, for the state and at the instant of the total, where they add up.
    """

    scenario: str
    controller: str
    total: float
    model_form: float
    integrator: float
    control_hold: float
    schedule_sampling: float
    disturbance_timing: float
    residual: float
    at_worst: AtWorst

    @property
    def residual_share(self) -> float:
        """The residual as a share of the total; 0 if there is no difference at all."""
        return self.residual / self.total if self.total else 0.0


def budget_curves(
    scenario: Scenario, controller: Controller, runs: Mapping[str, Trajectory]
) -> dict[str, NDArray[np.float64]]:
    """Return total, parts and residual as curves, shape (N, 4) each, at each step."""
    if any(run.outcome.kind != COMPLETED for run in runs.values()):
        return {}
    settings = runs["mujoco sampled"].provenance["settings"]
    timestep, period = settings["timestep"], settings["control_period"]
    grid = runs["mujoco sampled"].time

    def part(holds: Holds) -> NDArray[np.float64] | None:
        run = simulate_ode_held(
            scenario, controller, timestep=timestep, holds=holds, substeps=SUBSTEPS
        )
        return _at(run, grid)

    curves = {name: _at(run, grid) for name, run in runs.items()}
    followed = part(Holds())
    held = {
        "control_hold": part(Holds(control_period=period)),
        "schedule_sampling": part(Holds(schedule=True)),
        "disturbance_timing": part(Holds(disturbance=True)),
    }
    if any(curve is None for curve in (followed, *curves.values(), *held.values())):
        return {}
    total = curves["mujoco sampled"] - curves["ode"]  # type: ignore[operator]
    parts = {
        "model_form": curves["mujoco exact"] - curves["ode"],  # type: ignore[operator]
        "integrator": curves["mujoco sampled"] - curves["ode held"],  # type: ignore[operator]
        **{name: curve - followed for name, curve in held.items()},  # type: ignore[operator]
    }
    return {"total": total, **parts, "residual": total - sum(parts.values())}


def error_budget(
    scenario: Scenario,
    controller: Controller,
    times: NDArray[np.float64],
    curves: Mapping[str, NDArray[np.float64]],
) -> ErrorBudget:
    """Return the budget of a scenario and controller.

    Parameters
    ----------
    times
        Instants of the curves [s], shape (N,).
    """
    row, column = np.unravel_index(np.abs(curves["total"]).argmax(), curves["total"].shape)
    signed = {name: float(curve[row, column]) for name, curve in curves.items()}
    return ErrorBudget(
        scenario=scenario.name,
        controller=controller.name,
        at_worst=AtWorst(state=STATES[column], time=float(times[row]), **signed),
        **{name: float(np.abs(curve).max()) for name, curve in curves.items()},
    )


def _at(run: Trajectory, grid: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return the states at the instants of the grid; None if the run did not reach its end."""
    index = np.searchsorted(run.time, grid - 1e-9)
    return run.state[index] if index[-1] < len(run.time) else None
