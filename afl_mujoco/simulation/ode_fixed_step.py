"""The analytic equations integrated by RK4: twins of MuJoCo's continuous and sampled modes.

What a deployed loop holds over a step can be switched on one by one: the control, the parameters,
the disturbances. So the error of each can be separated from that of the others.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from afl_mujoco.compiled import kernel
from afl_mujoco.control.catalogue import as_controller, require_stateless
from afl_mujoco.control.controller import force_from_inputs
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.plant.dynamics import cart_acceleration, pole_acceleration
from afl_mujoco.scenario.files import as_scenario
from afl_mujoco.scenario.sampling import (
    Steps,
    cut_period,
    held_disturbances,
    parameters_in,
    step_times,
    steps,
)
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.integrator import integrate_python_controller
from afl_mujoco.simulation.trajectory import (
    COMPLETED,
    FALL_ANGLE,
    FELL,
    OUTCOMES,
    STATE_LIMIT,
    Outcome,
    Trajectory,
    assemble,
    ending_of,
    within_limits,
)

SUBSTEPS = 8
"""RK4 steps within each held step: their error is some 4000 times below that of a single one."""

_COMPLETED, _FELL, _RUNNING = OUTCOMES.index(COMPLETED), OUTCOMES.index(FELL), -1


@dataclass(frozen=True, slots=True)
class Holds:
    """What is held over a step instead of followed continuously."""

    # how long the force is held [s], a multiple of the timestep; ``None`` for a force that is
    # evaluated in every stage
    control_period: float | None = None
    schedule: bool = False  # whether M and l keep, over each timestep, their values at its middle
    disturbance: bool = False  # whether the push has its mean over each timestep


def simulate_ode_rk4(
    scenario: Scenario | str | Path, controller: Any, *, timestep: float = 1e-3
) -> Trajectory:
    """Integrate the closed loop by textbook RK4, with a step ending at every breakpoint.

    Parameters
    ----------
    scenario, controller
        Both as `simulate_mujoco` takes them.
    timestep
        The longest step [s].

    Returns
    -------
    Trajectory
        The run.
    """
    scenario = as_scenario(scenario)
    scenario.require_ideal()
    require_stateless(controller := as_controller(controller), "the ODE")
    grid = steps(scenario, timestep)
    inputs = controller.inputs_along_run(
        grid.cart_mass, grid.half_length, scenario.pole_mass, scenario.gravity
    )
    plant = _plants(grid.cart_mass, grid.half_length, scenario)
    profile = (np.array(scenario.initial_state), grid.times, plant, grid.push, grid.impulse)
    states, _, status = _run(controller, *profile, inputs, np.empty(0, dtype=np.bool_))
    outcome = Outcome(OUTCOMES[status], float(grid.times[len(states) - 1]))
    settings = {"timestep": timestep}
    return assemble(scenario, controller, "ode RK4", settings, grid.times, states, outcome)


def simulate_ode_held(
    scenario: Scenario | str | Path,
    controller: Any,
    *,
    timestep: float = 1e-3,
    control_period: float | None = None,
    holds: Holds | None = None,
    substeps: int = SUBSTEPS,
) -> Trajectory:
    """Solve the closed loop as deployed, or with only some of its holds, nearly to round-off.

    Parameters
    ----------
    scenario, controller
        Both as `simulate_mujoco` takes them.
    timestep
        Physics step, over which parameters and disturbances are held [s].
    control_period
        How long the force is held [s], a multiple of `timestep` (default: one step).
    holds
        What is held (default: everything); if given, its `control_period` replaces the argument.
    substeps
        RK4 steps within each `timestep`.

    Returns
    -------
    Trajectory
        The run, reported at every multiple of `timestep`.

    Raises
    ------
    InvalidValueError
        If a setting breaks its rule.
    """
    scenario, controller = as_scenario(scenario), as_controller(controller)
    scenario.require_ideal()
    if substeps < 1:
        raise InvalidValueError("substeps", "must be at least 1", substeps)
    if holds is None:
        period = timestep if control_period is None else control_period
        holds = Holds(control_period=period, schedule=True, disturbance=True)
    hold = 0
    if holds.control_period is None:
        require_stateless(controller, "a force that is not held")
    else:
        timestep, hold = cut_period(holds.control_period, timestep)
    fine = steps(scenario, timestep / substeps)
    times = step_times(scenario.duration, timestep)
    start_of = np.searchsorted(fine.times, times - 1e-9 * timestep)
    update = np.zeros(len(fine.push) if hold else 0, dtype=np.bool_)
    if hold:
        update[start_of[:-1:hold]] = True
    looked_up = update if hold else np.s_[:]  # a held force needs gains only where it is updated
    stages = np.s_[:1] if hold else np.s_[:]
    inputs = controller.inputs_along_run(
        fine.cart_mass[looked_up][:, stages],
        fine.half_length[looked_up][:, stages],
        scenario.pole_mass,
        scenario.gravity,
    )
    if hold:
        inputs = inputs[np.cumsum(update) - 1]
    mass, length, push, impulse = _held_inputs(scenario, fine, start_of, timestep, holds)
    plant = _plants(mass, length, scenario)
    profile = (np.array(scenario.initial_state), fine.times, plant, push, impulse)
    states, forces, status = _run(controller, *profile, inputs, update)
    outcome = Outcome(OUTCOMES[status], float(fine.times[len(states) - 1]))
    kept = start_of[start_of < len(states)]
    settings = {"timestep": timestep, "control_period": holds.control_period, "substeps": substeps}
    settings |= {"hold_schedule": holds.schedule, "hold_disturbance": holds.disturbance}
    run = (scenario, controller, "ode held", settings, times, states[kept], outcome, forces[kept])
    return assemble(*run)


def _held_inputs(
    scenario: Scenario, fine: Steps, start_of: NDArray[np.intp], timestep: float, holds: Holds
) -> tuple[NDArray[np.float64], ...]:
    """Return M and l, shape (N, 3), push and impulse, shape (N,), held as `holds` requires."""
    mass, length, push, impulse = fine.cart_mass, fine.half_length, fine.push, fine.impulse
    step_of = np.searchsorted(start_of, np.arange(len(push)), side="right") - 1
    step_of = np.minimum(step_of, len(start_of) - 2)  # a breakpoint may round to the horizon
    edges = step_times(scenario.duration, timestep)
    middles = 0.5 * (edges[:-1] + edges[1:])
    segments = scenario.segments
    inside = np.searchsorted([s.start for s in segments], middles, side="right") - 1
    if holds.schedule:
        mass, length = (
            np.repeat(frozen[step_of, None], 3, axis=1)
            for frozen in parameters_in(segments, inside, middles)
        )
    if holds.disturbance:
        push = held_disturbances(scenario, fine.times[start_of]).push[step_of]
    return mass, length, push, impulse


def _plants(
    cart_mass: NDArray[np.float64], half_length: NDArray[np.float64], scenario: Scenario
) -> NDArray[np.float64]:
    """Return (M, m, l, g) for arrays of M and l, shape (..., 4)."""
    plant = np.empty((*cart_mass.shape, 4))
    plant[..., 0], plant[..., 1] = cart_mass, scenario.pole_mass
    plant[..., 2], plant[..., 3] = half_length, scenario.gravity
    return plant


def _run(controller, initial_state, times, plant, push, impulse, inputs, update):
    """Return states, forces and status of a run, the force held from each `update` to the next.

    With no `update` the controller is evaluated in every stage.
    """
    if not controller.interpreted:
        kind = controller.kind
        profile = (initial_state, times, plant, push, impulse, kind, inputs)
        return _run_held(*profile, update) if len(update) else _run_followed(*profile)
    if len(update):
        return _run_held_by(controller, initial_state, times, plant, push, impulse, inputs, update)

    def slope(k, stage, x, force):
        return _slope(x, force + push[k], plant[k, stage])

    def arrive(k, x):
        return np.array(_after_impulse(tuple(x.tolist()), impulse[k], plant[k, 0]))

    return integrate_python_controller(controller, initial_state, times, inputs, arrive, slope)


def _run_held_by(controller, initial_state, times, plant, push, impulse, inputs, update):
    """Return the same as `_run_held`, under a Python controller."""
    ticks = [*np.flatnonzero(update).tolist(), len(push)]
    states, forces = np.empty((len(push) + 1, 4)), np.zeros(len(push) + 1)
    states[0] = initial_state
    last, status = 0, _arrive(states, 0, impulse, plant)
    own = controller.start()
    for first, next_ in pairwise(ticks):
        if status != _RUNNING:
            break
        force = own.command(times[first], states[first], inputs[first, 0])
        forces[first : next_ + 1] = force
        last, status = _hold(states, times, plant, push, impulse, force, first, next_)
    return states[: last + 1], forces[: last + 1], status


@register_jitable
def _slope(x, force, plant):
    """Return the right-hand side (z_dot, phi_dot, z'', phi'') by (P3), (P4); `x` is a tuple."""
    phi, phi_dot = x[1], x[3]
    mass, pole, length, gravity = plant[0], plant[1], plant[2], plant[3]
    return (
        x[2],
        phi_dot,
        cart_acceleration(phi, phi_dot, force, mass, pole, length, gravity),
        pole_acceleration(phi, phi_dot, force, mass, pole, length, gravity),
    )


@register_jitable
def _moved(x, h, k):
    """Return x + h k as a tuple, because an array would be allocated in every stage."""
    return x[0] + h * k[0], x[1] + h * k[1], x[2] + h * k[2], x[3] + h * k[3]


@register_jitable
def _combined(x, dt, k1, k2, k3, k4):
    """Return the state after a step, from the slopes of its stages."""
    sixth = dt / 6.0
    return (
        x[0] + sixth * (k1[0] + 2.0 * k2[0] + 2.0 * k3[0] + k4[0]),
        x[1] + sixth * (k1[1] + 2.0 * k2[1] + 2.0 * k3[1] + k4[1]),
        x[2] + sixth * (k1[2] + 2.0 * k2[2] + 2.0 * k3[2] + k4[2]),
        x[3] + sixth * (k1[3] + 2.0 * k2[3] + 2.0 * k3[3] + k4[3]),
    )


@kernel
def rk4_step(state, force, plant, dt):
    """Return the state (four numbers) after one textbook RK4 step under a constant force.

    force: Force on the cart [N].
    plant: (M, m, l, g) at the start, the middle and the end of the step, shape (3, 4).
    dt: The step [s].
    """
    x = (state[0], state[1], state[2], state[3])
    k1 = _slope(x, force, plant[0])
    k2 = _slope(_moved(x, 0.5 * dt, k1), force, plant[1])
    k3 = _slope(_moved(x, 0.5 * dt, k2), force, plant[1])
    k4 = _slope(_moved(x, dt, k3), force, plant[2])
    return _combined(x, dt, k1, k2, k3, k4)


@kernel
def _followed_step(x, dt, plant, push, kind, inputs):
    """Return the state after a textbook RK4 step, controller and parameters in every stage."""
    k1 = _slope(x, force_from_inputs(kind, x, inputs[0]) + push, plant[0])
    x2 = _moved(x, 0.5 * dt, k1)
    k2 = _slope(x2, force_from_inputs(kind, x2, inputs[1]) + push, plant[1])
    x3 = _moved(x, 0.5 * dt, k2)
    k3 = _slope(x3, force_from_inputs(kind, x3, inputs[1]) + push, plant[1])
    x4 = _moved(x, dt, k3)
    k4 = _slope(x4, force_from_inputs(kind, x4, inputs[2]) + push, plant[2])
    return _combined(x, dt, k1, k2, k3, k4)


@kernel
def _after_impulse(x, impulse, plant):
    """Return the state after an impulse [N s]: accelerations are linear in the force."""
    if impulse == 0.0:
        return x
    hit, free = _slope(x, impulse, plant), _slope(x, 0.0, plant)
    return x[0], x[1], x[2] + (hit[2] - free[2]), x[3] + (hit[3] - free[3])


@kernel
def _run_followed(initial_state, times, plant, push, impulse, kind, inputs):
    """Return states, forces and status of a run by RK4, the controller evaluated in every stage."""
    count = len(push)
    states, forces = np.empty((count + 1, 4)), np.empty(count + 1)
    states[0] = initial_state
    force = 0.0
    for k in range(count + 1):
        status = _arrive(states, k, impulse, plant)
        forces[k] = force
        if status != _RUNNING:
            return states[: k + 1], forces[: k + 1], status
        x = (states[k, 0], states[k, 1], states[k, 2], states[k, 3])
        force = force_from_inputs(kind, x, inputs[k, 0])
        forces[k] = force
        if not abs(force) < STATE_LIMIT:
            return states[: k + 1], forces[: k + 1], ending_of(x)
        after = _followed_step(x, times[k + 1] - times[k], plant[k], push[k], kind, inputs[k])
        if not within_limits(after):
            return states[: k + 1], forces[: k + 1], ending_of(x)
        states[k + 1, 0], states[k + 1, 1], states[k + 1, 2], states[k + 1, 3] = after
    return states, forces, _COMPLETED


@kernel
def _run_held(initial_state, times, plant, push, impulse, kind, inputs, update):
    """Return the same as `_run_followed`, with the force updated only where `update` is true."""
    count = len(push)
    states, forces = np.empty((count + 1, 4)), np.empty(count + 1)
    states[0] = initial_state
    force, last, status = 0.0, 0, _arrive(states, 0, impulse, plant)
    forces[0] = force
    while status == _RUNNING:
        first = last
        force = force_from_inputs(kind, states[first], inputs[first, 0])
        last = first + 1
        while last < count and not update[last]:
            last += 1
        last, status = _hold(states, times, plant, push, impulse, force, first, last)
        forces[first : last + 1] = force
    return states[: last + 1], forces[: last + 1], status


@kernel
def _hold(states, times, plant, push, impulse, force, first, last):
    """Step from instant `first` to `last` under one force; return where it ended, and how."""
    for k in range(first, last):
        x = (states[k, 0], states[k, 1], states[k, 2], states[k, 3])
        if not abs(force) < STATE_LIMIT:
            return k, ending_of(x)
        after = rk4_step(x, force + push[k], plant[k], times[k + 1] - times[k])
        if not within_limits(after):
            return k, ending_of(x)
        states[k + 1, 0], states[k + 1, 1], states[k + 1, 2], states[k + 1, 3] = after
        status = _arrive(states, k + 1, impulse, plant)
        if status != _RUNNING:
            return k + 1, status
    return last, _RUNNING


@kernel
def _arrive(states, k, impulse, plant):
    """Reach instant k, apply the impulse there, and return the status."""
    if abs(states[k, 1]) >= FALL_ANGLE:
        return _FELL
    if k == len(impulse):
        return _COMPLETED
    x = _after_impulse(
        (states[k, 0], states[k, 1], states[k, 2], states[k, 3]), impulse[k], plant[k, 0]
    )
    states[k, 0], states[k, 1], states[k, 2], states[k, 3] = x
    return _RUNNING
