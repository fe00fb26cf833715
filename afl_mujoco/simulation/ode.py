"""The analytic reference: (P3), (P4) under the controller, integrated to tight tolerance."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from afl_mujoco.compiled import borrowing_kernel, kernel
from afl_mujoco.control.catalogue import as_controller, require_stateless
from afl_mujoco.control.controller import Controller, compiled_force
from afl_mujoco.plant.dynamics import (
    cart_acceleration,
    mass_matrix,
    pole_acceleration,
    velocity_jump,
)
from afl_mujoco.plant.stretching_rod import stretching_accelerations
from afl_mujoco.scenario.files import as_scenario
from afl_mujoco.scenario.parameters import (
    QUASI_STATIC,
    VELOCITIES,
    CartPoleParameters,
    ParameterChange,
)
from afl_mujoco.scenario.sampling import time_grid
from afl_mujoco.scenario.scenario import Scenario, Segment
from afl_mujoco.simulation import integrator as dop853
from afl_mujoco.simulation.integrator import (
    ATOL,
    MAX_STEP,
    RTOL,
    Derivative,
    Transition,
    compiled_solver,
    integrate,
    limit_margin,
    require_tolerances,
    scipy_solver,
    segment_numbers,
)
from afl_mujoco.simulation.trajectory import (
    STATE_LIMIT,
    Outcome,
    Trajectory,
    assemble,
    controller_inputs,
)

SAMPLE_PERIOD = 1e-3
"""Spacing of the reported instants [s]."""


def simulate_ode(
    scenario: Scenario | str | Path,
    controller: Any,
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
        What happens: a scenario, a name of the catalogue, or the path of a file.
    controller
        The controller, evaluated continuously in time; as `simulate_mujoco` takes it.
    sample_period
        Spacing of the reported instants [s]; breakpoints are reported as well.
    method, rtol, atol
        Method and tolerances of `scipy.integrate.solve_ivp`.
    dynamics
        ``"quasi-static"``: M and l are frozen at each instant, as in the paper;
        ``"stretching-rod"``: the equations have the terms with the rate of l (decision D9).
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
    change, controller = ParameterChange(dynamics=dynamics, jumps=jumps), as_controller(controller)
    scenario = as_scenario(scenario)
    times, states, outcome = solve_ode(
        scenario,
        controller,
        sample_period=sample_period,
        method=method,
        rtol=rtol,
        atol=atol,
        change=change,
    )
    settings = {"method": method, "rtol": rtol, "atol": atol, "sample_period": sample_period}
    settings |= change.describe()
    return assemble(scenario, controller, "ode", settings, times, states, outcome)


def solve_ode(
    scenario: Scenario,
    controller: Controller,
    *,
    sample_period: float,
    method: str = "DOP853",
    rtol: float = RTOL,
    atol: float = ATOL,
    longest_step: float = MAX_STEP,
    change: ParameterChange | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64], Outcome]:
    """Return only the times [s], the states reached and the outcome of `simulate_ode`.

    longest_step: Longest step of the compiled method [s].
    """
    scenario.require_ideal()
    require_stateless(controller, "the ODE")
    change = ParameterChange() if change is None else change
    times = time_grid(scenario, sample_period)
    controller_inputs(
        scenario, controller, times
    )  # raises before the run if a gain is not positive
    if method != "DOP853" or controller.interpreted:
        loop = closed_loop(scenario, controller, change)
        solver = scipy_solver(loop, method, rtol, atol, controller=controller.name)
    else:
        require_tolerances(method, rtol, atol)
        solver = compiled_solver(
            compiled_loop(scenario, controller, change), rtol, atol, longest_step
        )
    nodes = controller.nodes(scenario.plants)
    states, outcome = integrate(scenario, solver, transition(scenario, change), times, nodes=nodes)
    return times[: len(states)], states, outcome


@register_jitable
def plant_at(numbers, time):
    """Return (M, m, l, g) at a time of a segment, from the numbers of `segment_numbers`."""
    elapsed = time - numbers[0]
    mass, length = numbers[1] + numbers[2] * elapsed, numbers[3] + numbers[4] * elapsed
    return mass, numbers[5], length, numbers[6]


@kernel
def write_rates(numbers, time, state, force, slopes):
    """Write (z_dot, phi_dot, z'', phi'') under a force of the controller, NaN where it has none.

    The rod stretches at the last of the numbers [m/s], zero for the frozen l of the paper.
    """
    mass, pole, length, gravity = plant_at(numbers, time)
    phi, phi_dot, push, rate = state[1], state[3], numbers[7], numbers[8]
    force = force + push if abs(force) < STATE_LIMIT else np.nan  # the run ends there
    slopes[0], slopes[1] = state[2], phi_dot
    if rate != 0.0:
        slopes[2], slopes[3] = stretching_accelerations(
            phi, phi_dot, force, mass, pole, length, gravity, rate
        )
    else:
        slopes[2] = cart_acceleration(phi, phi_dot, force, mass, pole, length, gravity)
        slopes[3] = pole_acceleration(phi, phi_dot, force, mass, pole, length, gravity)


@register_jitable
def compiled_command(numbers, assumed, compiled, time, state):
    """Return the force [N] of a compiled controller; NaN for what it assumes means the truth."""
    kind, table, masses, lengths = compiled
    if np.isnan(assumed[0]):  # (D7): the controller knows M(t) and l(t)
        assumed = plant_at(numbers, time)
    return compiled_force(
        kind, table, masses, lengths, state[0], state[1], state[2], state[3], assumed
    )


@register_jitable
def loop_rates(arguments, time, state, slopes):
    """Write the rates of the loop of plant and compiled controller, as the integrators need them.

    `arguments` are the numbers of the segment, the assumed (M, m, l, g) and the controller.
    """
    numbers, assumed, compiled = arguments
    force = compiled_command(numbers, assumed, compiled, time, state)
    write_rates(numbers, time, state, force, slopes)


@borrowing_kernel
def _solve(plant, assumed, compiled, start, end, state, times, options, work, found):
    """Integrate the compiled loop over a segment."""
    return dop853.solve(
        loop_rates, (plant, assumed, compiled), limit_margin, start, end, state, times, options,
        work, found,
    )  # fmt: skip


def compiled_loop(
    scenario: Scenario, controller: Controller, change: ParameterChange
) -> Callable[..., tuple[int, float, int]]:
    """Return the solver of the closed loop over a segment, as `compiled_solver` takes it."""
    compiled, assumed = (
        tuple(controller.compiled_for(scenario.plants)),
        controller.assumed_parameters(*[np.nan] * 4),
    )

    def solve(segment: Segment, *rest: Any) -> Any:
        plant = segment_numbers(scenario, segment, change)
        return _solve(plant, assumed, compiled, segment.start, segment.end, *rest)

    return solve


def closed_loop(scenario: Scenario, controller: Controller, change: ParameterChange) -> Derivative:
    """Return the right-hand side of the closed loop of plant and controller, called from Python."""

    def derivative(time: float, state: NDArray[np.float64], segment: Segment) -> Any:
        numbers, slopes = segment_numbers(scenario, segment, change), np.empty(4)
        assumed = controller.assumed_parameters(*plant_at(numbers, time))
        force = controller.command(time, state[:4], np.array(assumed))
        write_rates(numbers, time, state, force, slopes)
        return slopes

    return derivative


def transition(scenario: Scenario, change: ParameterChange) -> Transition:
    """Return the effect of a breakpoint on the state, from the analytic mass matrix."""

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
