"""Control performance of a run (Tier C): integrals, peaks, settling."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.controller import Controller
from afl_mujoco.scenario.parameters import STATE, SYMBOLS
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.trajectory import COMPLETED, Trajectory, controller_inputs

Metrics = dict[str, float | None]
"""Figures by name; ``None`` where a run has no such figure (never settled, never completed,
not finite, or its controller has no boundary layer)."""

STATES = tuple(STATE)

BANDS = {"2pc": 0.02, "5pc": 0.05}
"""Settling bands as a share of the peak of the state."""

UNITS: Mapping[str, str] = {
    "objective": "1",
    "iae_z": "m s",
    "iae_phi": "rad s",
    "itae_z": "m s^2",
    "itae_phi": "rad s^2",
    "max_command": "N",
    "max_force": "N",
    "limited_share": "1",
    "force_squared": "N^2 s",
    "force_variation": "N",
    "saturated_share": "1",
    **{f"peak_{x}": u for x, u in STATE.items()},
    **{f"overshoot_{x}": u for x, u in STATE.items()},
    **{f"settling_{b}_{x}": "s" for b in BANDS for x in STATES},
    "end_time": "s",
}
"""Unit of every metric."""

LABELS: Mapping[str, str] = {
    "objective": "objective OF",
    "iae_z": "∫|z| dt",
    "iae_phi": "∫|φ| dt",
    "itae_z": "∫t|z| dt",
    "itae_phi": "∫t|φ| dt",
    "max_command": "largest command",
    "max_force": "max |F| exerted",
    "limited_share": "share of time at the force limit",
    "force_squared": "∫F² dt",
    "force_variation": "total variation of F",
    "saturated_share": "share of time outside the boundary layer",
    "end_time": "end",
    **{f"peak_{x}": f"max |{s}|" for x, s in SYMBOLS.items()},
    **{f"overshoot_{x}": f"overshoot of {s}" for x, s in SYMBOLS.items()},
    **{
        f"settling_{band}_{x}": f"|{s}| stays below {100.0 * share:g} % of its peak from"
        for band, share in BANDS.items()
        for x, s in SYMBOLS.items()
    },  # not "settling": that is what a requirement asks for, by its own bands
}
"""Name of every metric in a report."""


def unit_of(key: str) -> str:
    """Return the unit of a metric as a report writes it; nothing for a pure number."""
    unit = UNITS.get(key, "").replace("^2", "²")
    return "" if unit == "1" else unit


def metrics(scenario: Scenario, controller: Controller, run: Trajectory) -> Metrics:
    """Return every metric of a run except the objective, which needs `with_objective`."""
    inputs = controller_inputs(scenario, controller, run.time)
    ratio = controller.saturation_ratio(run.state, inputs)
    share = None if ratio is None else _saturated_share(ratio, run.time)
    return metrics_of(run) | {"saturated_share": share and _known(share)}


def metrics_of(run: Trajectory) -> Metrics:
    """Return the metrics that need the run alone, without its controller."""
    time, state, force = run.time, run.state, run.force
    figures: Metrics = {
        "iae_z": integral(np.abs(state[:, 0]), time),
        "iae_phi": integral(np.abs(state[:, 1]), time),
        "itae_z": integral(time * np.abs(state[:, 0]), time),
        "itae_phi": integral(time * np.abs(state[:, 1]), time),
        "max_command": float(np.abs(run.command).max()),
        "max_force": float(np.abs(force).max()),
        "limited_share": 0.0,
        "force_squared": (integral if run.control_period is None else _staircase)(force**2, time),
        "force_variation": float(np.abs(np.diff(force, prepend=0.0)).sum()),  # at rest before t = 0
        "end_time": run.outcome.time,
        **run.effort,
    }
    for column, name in enumerate(STATES):
        figures[f"peak_{name}"] = float(np.abs(state[:, column]).max())
        figures[f"overshoot_{name}"] = _overshoot(state[:, column])
        for label, share in BANDS.items():
            settled = run.outcome.kind == COMPLETED
            figures[f"settling_{label}_{name}"] = (
                _settling_time(time, state[:, column], share) if settled else None
            )
    if run.outcome.kind != COMPLETED:  # an integral over part of the horizon cannot be compared
        figures |= dict.fromkeys(("iae_z", "iae_phi", "itae_z", "itae_phi", "force_squared"))
    return {name: _known(value) for name, value in figures.items()}


def _known(value: float | None) -> float | None:
    """Return a figure, None if not finite: outside its domain a controller has no force."""
    return value if value is not None and math.isfinite(value) else None


def integral(values: NDArray[np.float64], time: NDArray[np.float64]) -> float:
    """Return the integral over time by the trapezoidal rule."""
    return float(np.trapezoid(values, time))


def _staircase(values: NDArray[np.float64], time: NDArray[np.float64]) -> float:
    """Return the integral over time of values that are each held until the next instant."""
    return float(values[:-1] @ np.diff(time))


def _saturated_share(ratio: NDArray[np.float64], time: NDArray[np.float64]) -> float:
    """Return the share of the time in which the switching term is saturated."""
    saturated = (np.abs(ratio) >= 1.0).astype(float)
    return integral(saturated, time) / float(max(time[-1], 1e-300))


def _overshoot(x: NDArray[np.float64]) -> float:
    """Return how far a state passes its target 0, or leaves it if it starts there."""
    start = x[0]
    return float(max(0.0, (-np.sign(start) * x).max())) if start else float(np.abs(x).max())


def _settling_time(time: NDArray[np.float64], x: NDArray[np.float64], share: float) -> float | None:
    """Return when the state enters the band around 0 for good; None if it ends outside."""
    outside = np.flatnonzero(np.abs(x) > share * np.abs(x).max())
    if not len(outside):
        return 0.0
    return float(time[outside[-1] + 1]) if outside[-1] + 1 < len(time) else None
