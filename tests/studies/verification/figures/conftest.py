"""A small report with everything in it: plain data, and curves that no simulator has to make."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.simulation.ode_fixed_step import simulate_ode_rk4
from afl_mujoco.studies.cases import REPORTED
from afl_mujoco.studies.verification.checks.error_budget import SOURCES
from afl_mujoco.studies.verification.curves import Curves, select_curves

SCENARIOS = ("step-step", "trapezoid-step", "step-step-impulse")
ERRORS = dict(zip(REPORTED, (0.0, 1e-12, 1e-6, 1e-2), strict=True))
STEPS = (2e-3, 1e-3, 5e-4, 2.5e-4)


def made_curves(scenario: afl.Scenario, controller: str) -> Curves:
    """Curves of the ODE marched by RK4, and the same with an error added for each simulator."""
    run = simulate_ode_rk4(scenario, afl.CONTROLLERS[controller], timestep=1e-3)
    error = np.linspace(1.0, 0.0, len(run.time))[:, None] * (0.1, 0.2, 0.5, 1.0)
    runs = {
        name: type(run)(
            time=run.time,
            state=run.state + size * error,
            force=run.force + size,
            cart_mass=run.cart_mass,
            half_length=run.half_length,
            outcome=run.outcome,
        )
        for name, size in ERRORS.items()
    }
    time = np.arange(0.0, 3.05, 0.1)
    energy = {"time": time, "gained": np.sin(time), "work": np.sin(time) - 0.5}
    energy |= {"ramps": 0.0 * time, "jumps": 0.0 * time + 0.5, "residual": 1e-14 * time}
    return select_curves(
        scenario,
        afl.CONTROLLERS[controller],
        runs,
        timestep=1e-3,
        parts={"total": 0.01 * error},
        energy=energy,
    )


def made_budget(scenario: str, controller: str, total: float) -> dict[str, Any]:
    parts = dict.fromkeys(SOURCES, 0.0) | {"control_hold": 0.9 * total, "integrator": 2e-10}
    signed = {name: -value for name, value in parts.items()}
    residual = -total - sum(signed.values())
    at_worst = {"state": "phi_dot", "time": 0.005, "total": -total, **signed, "residual": residual}
    return {
        "scenario": scenario,
        "controller": controller,
        "total": total,
        **parts,
        "residual": abs(residual),
        "at_worst": at_worst,
        "residual_share": abs(residual) / total,
    }


def made_study(name: str, order: float, scenario: str = "any", controller: str = "any"):
    return {
        "scenario": scenario,
        "controller": controller,
        "study": name,
        "steps": list(STEPS),
        "errors": [3.0 * step**order for step in STEPS],
        "order": order,
        "expected": order,
    }


def made_claim(id: str, figure: str, paper: float | None, here: float | None, verdict: str):
    return {
        "id": id, "claim": "gains lower it", "figure": figure, "paper": paper, "here": here,
        "verdict": verdict, "why": "so",
    }  # fmt: skip


@pytest.fixture(scope="session")
def curves() -> tuple[Curves, ...]:
    return tuple(
        made_curves(afl.SCENARIOS[name], controller)
        for name in SCENARIOS
        for controller in ("fixed", "adaptive")
    )


@pytest.fixture(scope="session")
def report() -> dict[str, Any]:
    pairs = [(name, controller) for name in SCENARIOS for controller in ("fixed", "adaptive")]
    return {
        "settings": {"timestep": 1e-3, "control_period": 1e-3, "full": True},
        "error_budgets": [made_budget(*pair, 0.01 * (k + 1)) for k, pair in enumerate(pairs)],
        "studies": [
            made_study("free swing RK4", 4.0),
            made_study("free swing Euler", 1.0),
            *(made_study("continuous", 4.0, *pair) for pair in pairs),
            *(made_study("sampled", 1.0, *pair) for pair in pairs),
        ],
        "claims": [
            made_claim("C2", "settling [s]", None, 7.76, "reproduced"),
            made_claim("C3", "improvement [%]", 38.03, -118.4, "not reproduced"),
            made_claim("C9", "share [%]", 100.0, 50.4, "reproduced in part"),
            made_claim("C11", "RMSE [1/s]", 0.155, 0.31, "cannot be determined"),
        ],
        "random_schedules": {"published": {"interval": [0.47, 0.53]}},
    }
