"""The analytic reference: (P3), (P4) under the law, integrated to tight tolerance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.compiled import kernel
from afl_mujoco.control.compiled_law import law_force
from afl_mujoco.control.law import Law
from afl_mujoco.control.user_law.python_law import PythonLaw
from afl_mujoco.errors import UnknownNameError
from afl_mujoco.plant.dynamics import (
    cart_acceleration,
    mass_matrix,
    pole_acceleration,
    velocity_jump,
)
from afl_mujoco.plant.stretching_rod import stretching_accelerations
from afl_mujoco.scenario.parameter_change import QUASI_STATIC, VELOCITIES, ParameterChange
from afl_mujoco.scenario.parameters import CartPoleParameters
from afl_mujoco.scenario.sampling import time_grid
from afl_mujoco.scenario.scenario import Scenario, Segment
from afl_mujoco.simulation.integrator import (
    ATOL,
    METHODS,
    RTOL,
    Derivative,
    Transition,
    integrate,
)
from afl_mujoco.simulation.trajectory import STATE_LIMIT, Trajectory, assemble, law_along

SAMPLE_PERIOD = 1e-3
"""Spacing of the reported instants [s]."""


def simulate_ode(
    scenario: Scenario,
    controller: Law,
    *,
    sample_period: float = SAMPLE_PERIOD,
    method: str = "DOP853",
    rtol: float = RTOL,
    atol: float = ATOL,
    dynamics: str = QUASI_STATIC,
    jumps: str = VELOCITIES,
) -> Trajectory:
    """Simulate the paper's ideal equations, restarted at every breakpoint.

    Parameters
    ----------
    scenario
        What happens.
    controller
        What is commanded, continuously in time.
    sample_period
        Spacing of the reported instants [s]; breakpoints are reported as well.
    method, rtol, atol
        Method and tolerances of `scipy.integrate.solve_ivp`.
    dynamics
        ``"quasi-static"``: M and l are frozen at each instant, as in the paper;
        ``"stretching-rod"``: with the terms of the rate of l (decision D9).
    jumps
        What a step of M or l keeps: ``"velocities"``, as in the paper, or ``"momenta"``.

    Returns
    -------
    Trajectory
        The run; one in which the pole falls ends there, with the outcome recorded.

    Raises
    ------
    AflMujocoError
        If a setting breaks its rule.
    """
    if method not in METHODS:
        raise UnknownNameError.among("method", method, METHODS)
    scenario.require_ideal()
    change = ParameterChange(dynamics=dynamics, jumps=jumps)
    times = time_grid(scenario, sample_period)
    law_along(scenario, controller, times)  # raises before the run if a gain is not positive
    states, outcome = integrate(
        scenario,
        closed_loop(scenario, controller, change),
        transition(scenario, change),
        times,
        method=method,
        rtol=rtol,
        atol=atol,
    )
    settings = {"method": method, "rtol": rtol, "atol": atol, "sample_period": sample_period}
    settings |= change.describe()
    return assemble(scenario, controller, "ode", settings, times, states, outcome)


@kernel
def _acting(force, push):
    """Return the force on the cart; NaN beyond `STATE_LIMIT`, where a run ends."""
    return force + push if abs(force) < STATE_LIMIT else np.nan


@kernel
def _commanded(state, believed, law):
    """Return the force of a compiled law [N]."""
    kind, table, masses, lengths = law
    return law_force(kind, table, masses, lengths, state[0], state[1], state[2], state[3], believed)


@kernel
def _quasi_static(state, cart_mass, pole_mass, half_length, gravity, push, force):
    """Return (z_dot, phi_dot, z'', phi'') under a force of the law, NaN where it has none."""
    phi, phi_dot = state[1], state[3]
    force = _acting(force, push)
    return (
        state[2],
        phi_dot,
        cart_acceleration(phi, phi_dot, force, cart_mass, pole_mass, half_length, gravity),
        pole_acceleration(phi, phi_dot, force, cart_mass, pole_mass, half_length, gravity),
    )


@kernel
def _stretching(state, cart_mass, pole_mass, half_length, gravity, push, force, rate):
    """Return the same for a rod whose half-length grows at `rate` [m/s]."""
    z_ddot, phi_ddot = stretching_accelerations(
        state[1], state[3], _acting(force, push), cart_mass, pole_mass, half_length, gravity, rate
    )
    return state[2], state[3], z_ddot, phi_ddot


@kernel
def _loop(state, cart_mass, pole_mass, half_length, gravity, push, believed, law):
    """Return the rates of the quasi-static loop of plant and compiled law."""
    force = _commanded(state, believed, law)
    return _quasi_static(state, cart_mass, pole_mass, half_length, gravity, push, force)


@kernel
def _stretching_loop(state, cart_mass, pole_mass, half_length, gravity, push, believed, law, rate):
    """Return the same for a rod whose half-length grows at `rate` [m/s]."""
    force = _commanded(state, believed, law)
    return _stretching(state, cart_mass, pole_mass, half_length, gravity, push, force, rate)


def closed_loop(scenario: Scenario, controller: Law, change: ParameterChange) -> Derivative:
    """Return the right-hand side of the closed loop of plant and law.

    Parameters
    ----------
    scenario
        Gives m and g.
    controller
        The law.
    change
        What a change of M and l does.
    """
    if isinstance(controller, PythonLaw):
        return _interpreted(scenario, controller, change)
    pole_mass, gravity = scenario.pole_mass, scenario.gravity
    law = tuple(controller.compiled)

    def derivative(time: float, state: NDArray[np.float64], segment: Segment) -> tuple[float, ...]:
        mass, length = segment.parameters_at(time)
        believed = controller.believed(mass, pole_mass, length, gravity)
        plant = (mass, pole_mass, length, gravity, segment.push, believed, law)
        result: tuple[float, ...] = (
            _stretching_loop(state, *plant, segment.half_length[1])
            if change.stretching
            else _loop(state, *plant)
        )
        return result

    return derivative


def _interpreted(scenario: Scenario, controller: PythonLaw, change: ParameterChange) -> Derivative:
    """Return the right-hand side under a law in Python; arguments as of `closed_loop`."""
    pole_mass, gravity = scenario.pole_mass, scenario.gravity

    def derivative(time: float, state: NDArray[np.float64], segment: Segment) -> tuple[float, ...]:
        mass, length = segment.parameters_at(time)
        told = np.array(controller.believed(mass, pole_mass, length, gravity))
        force = controller.command(time, state[:4], told)
        plant = (mass, pole_mass, length, gravity, segment.push, force)
        result: tuple[float, ...] = (
            _stretching(state, *plant, segment.half_length[1])
            if change.stretching
            else _quasi_static(state, *plant)
        )
        return result

    return derivative


def transition(scenario: Scenario, change: ParameterChange) -> Transition:
    """Return what a breakpoint does to the state, from the analytic mass matrix.

    Parameters
    ----------
    scenario
        Gives m and g.
    change
        What a change of M and l does.
    """

    def parameters(segment: Segment, time: float) -> CartPoleParameters:
        mass, length = segment.parameters_at(time)
        return CartPoleParameters(
            cart_mass=mass,
            pole_mass=scenario.pole_mass,
            half_length=length,
            gravity=scenario.gravity,
        )

    def arrive(
        state: NDArray[np.float64], before: Segment | None, after: Segment
    ) -> NDArray[np.float64]:
        p = parameters(after, after.start)
        impulse = after.impulse
        state = state.copy()
        if before is not None and change.stretching:
            kink = after.half_length[1] - before.half_length[1]
            impulse += scenario.pole_mass * kink * float(np.sin(state[1]))
        if before is not None and change.keeps_momenta:
            kept = mass_matrix(state, parameters(before, before.end)) @ state[2:4]
            state[2:4] = np.linalg.solve(mass_matrix(state, p), kept)
        if impulse != 0.0:
            state[2:4] += velocity_jump(state[:4], impulse, p)
        return state

    return arrive
