"""Control performance of a run (Tier C): integrals, peaks, settling, the paper's objective (O1)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.catalogue import CONTROLLERS
from afl_mujoco.control.controller import Controller
from afl_mujoco.scenario.catalogue import SCENARIOS
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.batch.objective import ObjectiveScales, objective
from afl_mujoco.simulation.ode import simulate_ode, solve_ode
from afl_mujoco.simulation.trajectory import COMPLETED, Trajectory, controller_inputs

Metrics = dict[str, float | None]
"""Figures by name; ``None`` where a run has no such figure (never settled, never completed,
not finite, or its controller has no boundary layer)."""

TERMS = ("iae_z", "iae_phi", "max_force")
"""The metrics that the objective (O1) adds up."""

STATES = ("z", "phi", "z_dot", "phi_dot")
SYMBOLS = dict(zip(STATES, ("z", "φ", "z′", "φ′"), strict=True))
STATE_UNITS = dict(zip(STATES, ("m", "rad", "m/s", "rad/s"), strict=True))
"""The states as a report writes them, and in what."""

BANDS = {"2pc": 0.02, "5pc": 0.05}
"""Settling bands as a share of the peak of the state."""

COARSE: Any = {"sample_period": 2e-3, "rtol": 1e-9, "atol": 1e-11, "longest_step": 0.1}
"""How `ideal_objective` solves the equations."""

UNITS: Mapping[str, str] = {
    "objective": "1",
    "iae_z": "m s",
    "iae_phi": "rad s",
    "itae_z": "m s^2",
    "itae_phi": "rad s^2",
    "max_force": "N",
    "force_squared": "N^2 s",
    "force_variation": "N",
    "saturated_share": "1",
    **{f"peak_{x}": u for x, u in STATE_UNITS.items()},
    **{f"overshoot_{x}": u for x, u in STATE_UNITS.items()},
    **{f"settling_{b}_{x}": "s" for b in BANDS for x in STATES},
    "end_time": "s",
}
"""Unit of every metric."""


def metrics(scenario: Scenario, controller: Controller, run: Trajectory) -> Metrics:
    """Return every metric of a run but the objective, which needs `with_objective`."""
    time, state, force = run.time, run.state, run.force
    inputs = controller_inputs(scenario, controller, time)
    ratio = controller.saturation_ratio(state, inputs)
    figures: Metrics = {
        "iae_z": _integral(np.abs(state[:, 0]), time),
        "iae_phi": _integral(np.abs(state[:, 1]), time),
        "itae_z": _integral(time * np.abs(state[:, 0]), time),
        "itae_phi": _integral(time * np.abs(state[:, 1]), time),
        "max_force": float(np.abs(force).max()),
        "force_squared": _integral(force**2, time),
        "force_variation": float(np.abs(np.diff(force)).sum()),
        "saturated_share": None if ratio is None else _saturated_share(ratio, time),
        "end_time": run.outcome.time,
    }
    for column, name in enumerate(STATES):
        figures[f"peak_{name}"] = float(np.abs(state[:, column]).max())
        figures[f"overshoot_{name}"] = _overshoot(state[:, column])
        for label, share in BANDS.items():
            settled = run.outcome.kind == COMPLETED
            figures[f"settling_{label}_{name}"] = (
                _settling_time(time, state[:, column], share) if settled else None
            )
    if run.outcome.kind != COMPLETED:  # an integral over part of the horizon compares with nothing
        figures |= dict.fromkeys(("iae_z", "iae_phi", "itae_z", "itae_phi", "force_squared"))
    return {name: _known(value) for name, value in figures.items()}


def with_objective(figures: Metrics, scales: ObjectiveScales) -> Metrics:
    """Return the metrics with the objective (O1) before them."""
    iae_z, iae_phi, max_force = (figures[name] for name in TERMS)
    known = None not in (iae_z, iae_phi, max_force)
    return {"objective": objective(iae_z, iae_phi, max_force, scales) if known else None, **figures}


def ideal_objective(
    scenario: Scenario, controller: Controller, scales: ObjectiveScales
) -> float | None:
    """Return the objective (O1) on the ideal equations, for thousands of runs; None if it fell.

    It is that of `simulate_ode` to 1e-6, relatively, without the run itself.
    """
    times, states, outcome = solve_ode(scenario, controller, **COARSE)
    if outcome.kind != COMPLETED:
        return None
    forces = controller.forces(states, controller_inputs(scenario, controller, times), times)
    iae_z, iae_phi = (_integral(np.abs(states[:, column]), times) for column in (0, 1))
    return float(objective(iae_z, iae_phi, np.abs(forces).max(), scales))


def nominal_scales(sample_period: float) -> ObjectiveScales:
    """Return the scales of the objective: the fixed gains on the nominal plant (decision D4).

    Parameters
    ----------
    sample_period
        Of the grid on which the integrals are taken [s].
    """
    scenario, controller = SCENARIOS["nominal"], CONTROLLERS["fixed"]
    run = simulate_ode(scenario, controller, sample_period=sample_period)
    return objective_scales(metrics(scenario, controller, run))


def objective_scales(figures: Metrics) -> ObjectiveScales:
    """Return the scales that make the objective of these metrics 3.

    Parameters
    ----------
    figures
        Metrics of the fixed gains on the nominal plant (decision D4).
    """
    return ObjectiveScales(
        **{name: figures[name] for name in TERMS}  # type: ignore[arg-type]
    )


def _known(value: float | None) -> float | None:
    """Return a figure, or None if it is not finite: beyond its domain a controller has no force."""
    return value if value is not None and math.isfinite(value) else None


def _integral(values: NDArray[np.float64], time: NDArray[np.float64]) -> float:
    """Return the integral over time by the trapezoidal rule."""
    return float(np.trapezoid(values, time))


def _saturated_share(ratio: NDArray[np.float64], time: NDArray[np.float64]) -> float:
    """Return the share of the time that the switching term is saturated."""
    saturated = (np.abs(ratio) >= 1.0).astype(float)
    return _integral(saturated, time) / float(max(time[-1], 1e-300))


def _overshoot(x: NDArray[np.float64]) -> float:
    """Return how far a state passes its target 0; from rest at 0, how far it strays from it."""
    start = x[0]
    return float(max(0.0, (-np.sign(start) * x).max())) if start else float(np.abs(x).max())


def _settling_time(time: NDArray[np.float64], x: NDArray[np.float64], share: float) -> float | None:
    """Return when the state enters the band around 0 for good; None if it ends outside."""
    outside = np.flatnonzero(np.abs(x) > share * np.abs(x).max())
    if not len(outside):
        return 0.0
    return float(time[outside[-1] + 1]) if outside[-1] + 1 < len(time) else None
