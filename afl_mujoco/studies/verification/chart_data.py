"""The curves of a scenario as the page's script reads them: 32-bit floats in base64."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.studies.verification.curves import REFERENCE, Curves

STATES = ("z", "phi", "z_dot", "phi_dot")
QUANTITIES = (
    ("z", "z", "cart position"),
    ("phi", "φ", "pole angle"),
    ("z_dot", "z′", "cart velocity"),
    ("phi_dot", "φ′", "pole rate"),
    ("force", "F", "force"),
    ("plant", "M, l", "mass and half-length"),
)
"""Key, symbol and name of the quantities that a chart shows."""

PRESCRIBED = ("cart_mass", "half_length", "push")

FIRST_MOMENTS = 0.05
"""Length of the first shortcut [s], which shows the controller's first, fast response."""

BEFORE, AFTER = 0.1, 0.9
"""Time before and after a breakpoint that the other shortcuts show [s]."""

MOST = 5
"""Largest number of shortcuts."""


def chart_data(curves: Sequence[Curves], scenario: Scenario) -> dict[str, Any]:
    """Return the curves of one scenario, those of all controllers on the union of their instants.

    An instant that a run does not have is NaN. Differences from the ODE are computed here, in
    double precision: in single precision they would be lost in round-off.
    """
    time = np.unique(np.concatenate([one.time for one in curves]))
    first = curves[0]
    return {
        "time": encode(time),
        "prescribed": {
            name: encode(spread(time, first.time, getattr(first, name))) for name in PRESCRIBED
        },
        "runs": [_run(time, one) for one in curves],
        "shortcuts": shortcuts(scenario),
    }


def _run(time: NDArray[np.float64], one: Curves) -> dict[str, Any]:
    """Return the curves of one controller: the reference, and differences of the others from it."""
    signals = {name: _signals(time, one, name) for name in one.states}
    reference = signals.pop(REFERENCE)
    return {
        "controller": one.controller,
        "reference": {name: encode(values) for name, values in reference.items()},
        "differences": {
            simulator: {name: encode(x - reference[name]) for name, x in found.items()}
            for simulator, found in signals.items()
        },
    }


def _signals(
    time: NDArray[np.float64], one: Curves, simulator: str
) -> dict[str, NDArray[np.float64]]:
    """Return states and force of one simulator by name."""
    columns = dict(zip(STATES, one.states[simulator].T, strict=True))
    columns["force"] = one.forces[simulator]
    return {name: spread(time, one.time, values) for name, values in columns.items()}


def spread(
    time: NDArray[np.float64], instants: NDArray[np.float64], values: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return values at the instants that have one, NaN elsewhere, shape (N,).

    Parameters
    ----------
    time
        Instants wanted [s], shape (N,).
    values
        Values at the first K of the instants, shape (K,).
    """
    wide = np.full(len(time), np.nan)
    wide[np.searchsorted(time, instants[: len(values)])] = values
    return wide


def shortcuts(scenario: Scenario) -> list[dict[str, Any]]:
    """Return stretches of time worth a look, each with a label and two times [s]."""
    end = scenario.duration
    found = [{"label": "start", "from": 0.0, "to": min(FIRST_MOMENTS, end)}]
    for time in scenario.breakpoints:
        if 0.0 < time < end and len(found) < MOST:
            label = f"{time:.4g} s"
            found.append(
                {"label": label, "from": max(0.0, time - BEFORE), "to": min(end, time + AFTER)}
            )
    return found


def encode(values: NDArray[np.float64]) -> str:
    """Return values as little-endian 32-bit floats in base64.

    Parameters
    ----------
    values
        The values, shape (N,).
    """
    return base64.b64encode(values.astype("<f4").tobytes()).decode()
