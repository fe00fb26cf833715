"""The analytic equations in fixed steps: the twins of MuJoCo's continuous and sampled modes.

`simulate_ode_rk4` is the textbook RK4 of the closed loop. `simulate_ode_held` solves the closed
loop whose control is held and whose parameters are frozen in each step, as when it is deployed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.compiled import kernel
from afl_mujoco.control.afl import force_given
from afl_mujoco.control.controllers import Controller
from afl_mujoco.plant.dynamics import cart_acceleration, pole_acceleration
from afl_mujoco.scenario.sampling import steps, whole_steps
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.trajectory import (
    OUTCOMES,
    STATE_LIMIT,
    Outcome,
    Trajectory,
    assemble,
    law_along,
    status_of,
)

SUBSTEPS = 8
"""RK4 steps within each held step: they leave an error some 4000 times below RK4 at the step."""

_COMPLETED, _FELL, _DIVERGED = range(len(OUTCOMES))


def simulate_ode_rk4(
    scenario: Scenario, controller: Controller, *, timestep: float = 1e-3
) -> Trajectory:
    """March the closed loop by textbook RK4, steps ending on every breakpoint.

    Parameters
    ----------
    scenario, controller
        What happens and what is commanded.
    timestep
        The longest step [s].

    Returns
    -------
    Trajectory
        The run.
    """
    march = steps(scenario, timestep)
    law = controller.law_inputs(
        march.cart_mass, march.half_length, scenario.pole_mass, scenario.gravity
    )
    plant = _plants(march.cart_mass, march.half_length, scenario)
    states, status = _march_rk4(
        np.array(scenario.initial_state), march.times, plant, march.push, march.impulse, law
    )
    outcome = Outcome(OUTCOMES[status], float(march.times[len(states) - 1]))
    settings = {"timestep": timestep}
    return assemble(scenario, controller, "ode RK4", settings, march.times, states, outcome)


def simulate_ode_held(
    scenario: Scenario,
    controller: Controller,
    *,
    timestep: float = 1e-3,
    control_period: float | None = None,
    substeps: int = SUBSTEPS,
) -> Trajectory:
    """Solve the closed loop with control and schedule held, to far below the step's own error.

    Parameters
    ----------
    scenario, controller
        What happens and what is commanded.
    timestep
        Over which the parameters keep the value they have in its middle [s].
    control_period
        Over which the force is held [s], a multiple of `timestep` (default: one step).
    substeps
        RK4 steps within each `timestep`.

    Returns
    -------
    Trajectory
        The run, reported at every multiple of `timestep`.
    """
    hold = whole_steps("control_period", control_period or timestep, "timestep", timestep)
    count = whole_steps("duration", scenario.duration, "timestep", timestep)
    times = np.linspace(0.0, count * timestep, count + 1)
    middles = times[:-1] + 0.5 * timestep
    segments = scenario.segments
    inside = np.searchsorted([s.start for s in segments], middles, side="right") - 1
    frozen = np.array(
        [segments[i].parameters_at(t) for i, t in zip(inside, middles.tolist(), strict=True)]
    )
    impulse = np.zeros(count)
    for segment in segments:
        if segment.impulse != 0.0:  # strikes at the first step that starts at its time or after it
            impulse[np.searchsorted(times, segment.start - 1e-9 * timestep)] += segment.impulse
    states, forces, status = _march_held(
        np.array(scenario.initial_state),
        (timestep, hold, substeps),
        _plants(frozen[:, 0], frozen[:, 1], scenario),
        np.array([segments[i].push for i in inside]),
        impulse,
        law_along(scenario, controller, times),
    )
    outcome = Outcome(OUTCOMES[status], float(times[len(states) - 1]))
    settings = {
        "timestep": timestep,
        "control_period": control_period or timestep,
        "substeps": substeps,
    }
    return assemble(scenario, controller, "ode held", settings, times, states, outcome, forces)


def _plants(
    cart_mass: NDArray[np.float64], half_length: NDArray[np.float64], scenario: Scenario
) -> NDArray[np.float64]:
    """Return (M, m, l, g) for given M and l, shape (..., 4)."""
    plant = np.empty((*cart_mass.shape, 4))
    plant[..., 0], plant[..., 1] = cart_mass, scenario.pole_mass
    plant[..., 2], plant[..., 3] = half_length, scenario.gravity
    return plant


@kernel
def acceleration_of(state, force, plant):
    """Return (z'', phi'') by (P3), (P4), for `plant` (M, m, l, g)."""
    phi, phi_dot = state[1], state[3]
    mass, pole, length, gravity = plant[0], plant[1], plant[2], plant[3]
    return (
        cart_acceleration(phi, phi_dot, force, mass, pole, length, gravity),
        pole_acceleration(phi, phi_dot, force, mass, pole, length, gravity),
    )


@kernel
def _slope(state, force, plant):
    """Return the right-hand side (z_dot, phi_dot, z'', phi'')."""
    cart, pole = acceleration_of(state, force, plant)
    return np.array([state[2], state[3], cart, pole])


@kernel
def _struck(state, impulse, plant):
    """Return the state after an ideal impulse: accelerations are linear in the force."""
    with_it, without = acceleration_of(state, impulse, plant), acceleration_of(state, 0.0, plant)
    jump = np.array([0.0, 0.0, with_it[0] - without[0], with_it[1] - without[1]])
    return state + jump


@kernel
def rk4_step(state, force, plant, dt):
    """Return the state after one textbook RK4 step under a constant force and constant parameters.

    Parameters
    ----------
    state
        Shape (4,).
    force
        Force on the cart [N].
    plant
        (M, m, l, g).
    dt
        The step [s].
    """
    k1 = _slope(state, force, plant)
    k2 = _slope(state + 0.5 * dt * k1, force, plant)
    k3 = _slope(state + 0.5 * dt * k2, force, plant)
    k4 = _slope(state + dt * k3, force, plant)
    return state + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


@kernel
def _march_rk4(initial_state, times, plant, push, impulse, law):
    """March by RK4, law and parameters in every stage; return states reached and status."""
    count = len(times) - 1
    states = np.empty((count + 1, 4))
    states[0] = initial_state
    for k in range(count):
        status = status_of(states[k])
        if status != _COMPLETED:
            return states[: k + 1], status
        if impulse[k] != 0.0:
            states[k] = _struck(states[k], impulse[k], plant[k, 0])
        x, dt, d = states[k], times[k + 1] - times[k], push[k]
        k1 = _slope(x, force_given(x, law[k, 0]) + d, plant[k, 0])
        x2 = x + 0.5 * dt * k1
        k2 = _slope(x2, force_given(x2, law[k, 1]) + d, plant[k, 1])
        x3 = x + 0.5 * dt * k2
        k3 = _slope(x3, force_given(x3, law[k, 1]) + d, plant[k, 1])
        x4 = x + dt * k3
        k4 = _slope(x4, force_given(x4, law[k, 2]) + d, plant[k, 2])
        after = x + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        if not np.isfinite(after).all():
            return states[: k + 1], _FELL
        states[k + 1] = after
    return states, status_of(states[count])


@kernel
def _march_held(initial_state, timing, plant, push, impulse, law):
    """March with held control and frozen parameters; return states, held forces and status."""
    timestep, hold, substeps = timing
    count = len(push)
    states, forces = np.empty((count + 1, 4)), np.empty(count + 1)
    states[0] = initial_state
    force = 0.0
    for k in range(count + 1):
        status = status_of(states[k])
        if status != _COMPLETED:
            forces[k] = force
            return states[: k + 1], forces[: k + 1], status
        if k < count and impulse[k] != 0.0:
            states[k] = _struck(states[k], impulse[k], plant[k])
        if k % hold == 0:
            force = force_given(states[k], law[k])
        forces[k] = force
        if not abs(force) < STATE_LIMIT:
            return states[: k + 1], forces[: k + 1], _DIVERGED
        if k < count:
            state = states[k]
            for _ in range(substeps):
                state = rk4_step(state, force + push[k], plant[k], timestep / substeps)
            states[k + 1] = state
    return states, forces, _COMPLETED
