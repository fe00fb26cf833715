"""The paper's objective (O1) of a run, and the scales of its terms."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

from afl_mujoco.control.catalogue import CONTROLLERS
from afl_mujoco.scenario.catalogue import SCENARIOS
from afl_mujoco.simulation.metrics import Metrics, metrics
from afl_mujoco.simulation.ode import simulate_ode

TERMS = ("iae_z", "iae_phi", "max_force")  # the metrics that the objective (O1) adds up


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectiveScales:
    """The scales by which the terms of (O1) are divided (decision D4)."""

    iae_z: float  # integral of abs(z) [m s]
    iae_phi: float  # integral of abs(phi) [rad s]
    max_force: float  # largest abs(F) [N]


def objective(iae_z: Any, iae_phi: Any, max_force: Any, scales: ObjectiveScales) -> Any:
    """Return the objective of Eq. (O1), of floats or arrays."""
    return iae_z / scales.iae_z + iae_phi / scales.iae_phi + max_force / scales.max_force


def with_objective(figures: Metrics, scales: ObjectiveScales) -> Metrics:
    """Return the metrics with the objective (O1) in front."""
    iae_z, iae_phi, max_force = (figures[name] for name in TERMS)
    known = None not in (iae_z, iae_phi, max_force)
    return {"objective": objective(iae_z, iae_phi, max_force, scales) if known else None, **figures}


@cache
def nominal_scales(sample_period: float) -> ObjectiveScales:
    """Return the scales of the objective: the fixed gains on the nominal plant (D4)."""
    scenario, controller = SCENARIOS["nominal"], CONTROLLERS["fixed"]
    run = simulate_ode(scenario, controller, sample_period=sample_period)
    return objective_scales(metrics(scenario, controller, run))


def objective_scales(figures: Metrics) -> ObjectiveScales:
    """Return the scales that make the objective of these metrics 3."""
    return ObjectiveScales(
        **{name: figures[name] for name in TERMS}  # type: ignore[arg-type]
    )
