"""Checks of the references and methods, run once: A4, A8 and A10."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from hashlib import sha256

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.catalogue import CONTROLLERS
from afl_mujoco.scenario.catalogue import SCENARIOS
from afl_mujoco.scenario.parameters import NOMINAL
from afl_mujoco.scenario.schedules import staircase
from afl_mujoco.simulation.mujoco_model import CartPoleModel, forward, write_parameters
from afl_mujoco.simulation.mujoco_rollout import MODES, simulate_mujoco
from afl_mujoco.simulation.ode import simulate_ode
from afl_mujoco.studies.verification.check import Check
from afl_mujoco.studies.verification.checks.convergence import (
    Refinement,
    Study,
    difference,
    free_swing_study,
    last_state,
)
from afl_mujoco.studies.verification.criteria import CRITERIA

RK4_STEPS = (8e-3, 4e-3, 2e-3, 1e-3)
EULER_STEPS = (4e-3, 2e-3, 1e-3, 5e-4)
MANUFACTURED_STEPS = (2e-2, 1e-2, 5e-3, 2.5e-3)
MANUFACTURED_DURATION = 2.0
SHORT_DURATION = 0.6

_SHORT = replace(
    SCENARIOS["step-trapezoid"], cart_mass=staircase((0.3,), (0.5, 1.0)), duration=SHORT_DURATION
)


def reference_checks(swings: tuple[Refinement, Refinement]) -> tuple[Check, ...]:
    """Run A4, A8 and A10."""
    study, exactness = manufactured_study()
    rk4, euler = swings
    return (
        CRITERIA["A4"].judge(rk4.deviation),
        CRITERIA["A4e"].judge(euler.deviation),
        CRITERIA["A8"].judge(second_method_difference()),
        CRITERIA["A8m"].judge(abs(study.order - 4.0)),
        CRITERIA["A8x"].judge(exactness),
        CRITERIA["A10"].judge(differing_runs()),
    )


def free_swings() -> tuple[Refinement, Refinement]:
    """Return the studies of A4: MuJoCo's RK4 and its Euler without force."""
    return (
        Refinement.of(free_swing_study("RK4", RK4_STEPS), study="free swing RK4", expected=4.0),
        Refinement.of(
            free_swing_study("Euler", EULER_STEPS), study="free swing Euler", expected=1.0
        ),
    )


def second_method_difference() -> float:
    """Return the largest difference between DOP853 and Radau on a closed loop with a jump."""
    controller = CONTROLLERS["adaptive"]
    explicit = simulate_ode(_SHORT, controller, sample_period=0.05)
    implicit = simulate_ode(
        _SHORT, controller, sample_period=0.05, method="Radau", rtol=1e-11, atol=1e-13
    )
    return difference(explicit, implicit)


def differing_runs() -> int:
    """Return how many runs differ in any bit when repeated here and in a fresh process."""
    path = f"import sys; sys.path[:] = {sys.path!r}"  # no other module than here
    script = f"{path}; from {__name__} import run_digests; print(*run_digests())"
    command = [sys.executable, "-P", "-c", script]
    fresh = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    repeats = zip(run_digests(), run_digests(), fresh, strict=True)
    return sum(len(set(digests)) > 1 for digests in repeats)


def run_digests() -> tuple[str, ...]:
    """Return the SHA-256 of states and forces of one run in each simulator."""
    controller = CONTROLLERS["adaptive"]
    runs = [simulate_mujoco(_SHORT, controller, mode) for mode in MODES]
    return tuple(
        sha256(run.state.tobytes() + run.force.tobytes()).hexdigest()
        for run in (simulate_ode(_SHORT, controller), *runs)
    )


def manufactured(
    time: float,
) -> tuple[NDArray[np.float64], tuple[float, float], NDArray[np.float64]]:
    """Return the manufactured motion: state, (M, l) and (z'', phi'') at a time.

    Parameters
    ----------
    time
        Time [s].
    """
    z, phi = 0.3 * np.sin(time), 0.5 * np.cos(1.3 * time)
    z_dot, phi_dot = 0.3 * np.cos(time), -0.65 * np.sin(1.3 * time)
    plant = 1.0 + 0.5 * np.sin(time), 0.5 + 0.2 * np.sin(0.7 * time)
    second = np.array([-z, -1.69 * phi])
    return np.array([z, phi, z_dot, phi_dot]), plant, second


def required_forces(time: float) -> tuple[float, float]:
    """Return the forces on z [N] and phi [N m] that (P2) and (P1) need for the manufactured motion.

    Parameters
    ----------
    time
        Time [s].
    """
    (_, phi, _, phi_dot), (mass, length), (z_ddot, phi_ddot) = manufactured(time)
    m, g, sin, cos = NOMINAL.pole_mass, NOMINAL.gravity, np.sin(phi), np.cos(phi)
    force = (mass + m) * z_ddot - m * length * (phi_ddot * cos - phi_dot**2 * sin)
    inertia = 4.0 / 3.0 * m * length**2 * phi_ddot
    torque = inertia - m * length * z_ddot * cos - m * g * length * sin
    return float(force), float(torque)


def manufactured_study() -> tuple[Study, float]:
    """Return RK4's and DOP853's errors around MuJoCo's dynamics on the manufactured motion."""
    at = (model := CartPoleModel(NOMINAL)).addresses

    def rate(time: float, state: NDArray[np.float64]) -> NDArray[np.float64]:
        _, (mass, length), _ = manufactured(time)
        write_parameters(at, mass, NOMINAL.pole_mass, length, NOMINAL.gravity)
        force, torque = required_forces(time)
        return np.array([*state[2:], *forward(at, *state.tolist(), force, 0.0, torque)])

    start, end = manufactured(0.0)[0], manufactured(MANUFACTURED_DURATION)[0]
    errors = []
    for h in MANUFACTURED_STEPS:
        state = start
        for k in range(round(MANUFACTURED_DURATION / h)):
            k1 = rate(k * h, state)
            k2 = rate((k + 0.5) * h, state + 0.5 * h * k1)
            k3 = rate((k + 0.5) * h, state + 0.5 * h * k2)
            k4 = rate((k + 1.0) * h, state + h * k3)
            state = state + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        errors.append(float(np.abs(state - end).max()))
    exactness = float(np.abs(last_state(rate, start, MANUFACTURED_DURATION) - end).max())
    del model  # its addresses must outlive every call of rate
    return Study(MANUFACTURED_STEPS, tuple(errors)), exactness
