"""The closed loop in MuJoCo: exact, continuous and sampled mode."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.compiled import kernel, load, store
from afl_mujoco.control.afl import force_given
from afl_mujoco.control.controllers import Controller, scheduled_force
from afl_mujoco.errors import UnknownNameError
from afl_mujoco.scenario.sampling import SNAP, steps, time_grid, whole_steps
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.integrator import ATOL, RTOL, integrate
from afl_mujoco.simulation.mujoco_model import (
    CONTROL,
    DATA,
    INTEGRATORS,
    MODEL,
    PHI,
    PHI_DOT,
    PUSH,
    Z_DOT,
    CartPoleModel,
    Z,
    forward,
    mj_step,
    strike,
    write_parameters,
    write_state,
)
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
    law_along,
    within_limits,
)

MODES = ("exact", "continuous", "sampled")
_COMPLETED, _FELL = OUTCOMES.index(COMPLETED), OUTCOMES.index(FELL)


def simulate_mujoco(
    scenario: Scenario,
    controller: Controller,
    mode: str = "exact",
    *,
    timestep: float = 1e-3,
    control_period: float | None = None,
    integrator: str = "RK4",
) -> Trajectory:
    """Simulate the MuJoCo cart-pole under the law, its parameters changed while it runs.

    Parameters
    ----------
    scenario
        What happens.
    controller
        What is commanded.
    mode
        ``"exact"``: MuJoCo's forward dynamics under the integrator of `simulate_ode`;
        ``"continuous"``: RK4 around MuJoCo's forward dynamics, law and parameters in every stage,
        steps that end on every breakpoint; ``"sampled"``: as deployed, `mj_step` with the control
        held for `control_period` and the parameters of the middle of each step.
    timestep
        Physics step [s]; in exact mode the spacing of the reported instants.
    control_period
        How long sampled mode holds the force [s], a multiple of `timestep` (default: one step).
    integrator
        MuJoCo's integrator in sampled mode: ``"RK4"``, ``"Euler"``, ``"implicit"`` or
        ``"implicitfast"``.

    Returns
    -------
    Trajectory
        The run; one in which the pole falls ends there, with the outcome recorded.

    Raises
    ------
    AflMujocoError
        If a setting breaks its rule.
    """
    if mode not in MODES:
        raise UnknownNameError.among("mode", mode, MODES)
    if integrator not in INTEGRATORS:
        raise UnknownNameError.among("integrator", integrator, INTEGRATORS)
    settings: dict[str, Any] = {"timestep": timestep}
    if mode == "sampled":
        period = timestep if control_period is None else control_period
        settings |= {"control_period": period, "integrator": integrator}
        return _sampled(scenario, controller, settings)
    if mode == "continuous":
        return _continuous(scenario, controller, settings)
    return _exact(scenario, controller, settings)


def _exact(scenario: Scenario, controller: Controller, settings: dict[str, Any]) -> Trajectory:
    """MuJoCo's forward dynamics as the right-hand side of the reference integrator."""
    times = time_grid(scenario, settings["timestep"])
    law_along(scenario, controller, times)  # raises before the run if a gain is not positive
    model = CartPoleModel(scenario.parameters_at(0.0))
    at, coefficients = model.addresses, controller.gain_function.coefficients
    pole_mass, gravity = scenario.pole_mass, scenario.gravity

    def derivative(
        state: NDArray[np.float64], cart_mass: float, half_length: float, push: float
    ) -> tuple[float, ...]:
        true = (cart_mass, pole_mass, half_length, gravity)
        result: tuple[float, ...] = _exact_derivative(
            at, state, true, controller.believed(*true), coefficients, push
        )
        return result

    def jump(
        state: NDArray[np.float64], cart_mass: float, half_length: float, impulse: float
    ) -> NDArray[np.float64]:
        write_parameters(at, cart_mass, pole_mass, half_length, gravity)
        return np.array(strike(at, *state.tolist(), impulse))

    states, outcome = integrate(scenario, derivative, jump, times)
    settings = settings | {"method": "DOP853", "rtol": RTOL, "atol": ATOL}
    return assemble(scenario, controller, "mujoco exact", settings, times, states, outcome)


def _continuous(scenario: Scenario, controller: Controller, settings: dict[str, Any]) -> Trajectory:
    """RK4 around MuJoCo's forward dynamics, everything prescribed in every stage."""
    march = steps(scenario, settings["timestep"])
    law = controller.law_inputs(
        march.cart_mass, march.half_length, scenario.pole_mass, scenario.gravity
    )
    model = CartPoleModel(scenario.parameters_at(0.0))
    states, status = _march_continuous(
        model.addresses,
        np.array(scenario.initial_state),
        march.times,
        march.cart_mass,
        march.half_length,
        (scenario.pole_mass, scenario.gravity),
        march.push,
        march.impulse,
        law,
    )
    outcome = Outcome(OUTCOMES[status], float(march.times[len(states) - 1]))
    return assemble(
        scenario, controller, "mujoco continuous", settings, march.times, states, outcome
    )


def _sampled(scenario: Scenario, controller: Controller, settings: dict[str, Any]) -> Trajectory:
    """As deployed: `mj_step`, the control held, the parameters of each step's middle."""
    timestep, period = settings["timestep"], settings["control_period"]
    hold = whole_steps("control_period", period, "timestep", timestep)
    count = whole_steps("duration", scenario.duration, "timestep", timestep)
    index = np.arange(count + 1)
    starts, middles = index * timestep, (index[:-1] + 0.5) * timestep
    model = CartPoleModel(
        scenario.parameters_at(0.0), timestep=timestep, integrator=settings["integrator"]
    )
    states, forces, status = _march_sampled(
        model.addresses,
        np.array(scenario.initial_state),
        hold,
        scenario.cart_mass(middles),
        scenario.half_length(middles),
        (scenario.pole_mass, scenario.gravity),
        scenario.pushes(middles),
        impulses_by_step(scenario, starts),
        law_along(scenario, controller, starts),
    )
    outcome = Outcome(OUTCOMES[status], float(starts[len(states) - 1]))
    return assemble(
        scenario, controller, "mujoco sampled", settings, starts, states, outcome, forces
    )


def impulses_by_step(scenario: Scenario, starts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the ideal impulse [N s] that strikes at the start of each step, shape (N,).

    An impulse strikes at the first step that starts at its time or after it.

    Parameters
    ----------
    scenario
        Gives the impulses.
    starts
        Starts of the steps and the horizon [s], shape (N + 1,).
    """
    edges = np.concatenate([[-np.inf], starts[:-1]]) + SNAP * (starts[1] - starts[0])
    edges[-1] = np.inf  # one that comes after the last start strikes there
    return np.array([scenario.impulse_within(a, b) for a, b in itertools.pairwise(edges)])


@kernel
def _derivative(at, state, force, push):
    """Return (z_dot, phi_dot, z'', phi'') by MuJoCo; NaN where the law had no value."""
    if not abs(force) < STATE_LIMIT:
        return np.nan, np.nan, np.nan, np.nan
    z_ddot, phi_ddot = forward(at, state[0], state[1], state[2], state[3], force, push)
    return state[2], state[3], z_ddot, phi_ddot


@kernel
def _exact_derivative(at, state, true, believed, coefficients, push):
    """Return (z_dot, phi_dot, z'', phi'') under the law, for parameters `true` (M, m, l, g)."""
    force = scheduled_force(state[0], state[1], state[2], state[3], believed, coefficients)
    write_parameters(at, true[0], true[1], true[2], true[3])
    return _derivative(at, state, force, push)


@kernel
def _struck(at, state, impulse):
    """Return the state after an ideal impulse."""
    jump = strike(at, state[0], state[1], state[2], state[3], impulse)
    return np.array([state[0], state[1], state[2] + jump[0], state[3] + jump[1]])


@kernel
def _march_continuous(
    at, initial_state, times, cart_mass, half_length, constants, push, impulse, law
):
    """March by RK4 and return the states reached, shape (K, 4), and the status."""
    pole_mass, gravity = constants
    count = len(push)
    states, slopes = np.empty((count + 1, 4)), np.empty((4, 4))
    states[0] = initial_state
    share = (0.0, 0.5, 0.5, 1.0)
    written = (np.nan, np.nan)
    for k in range(count + 1):
        if abs(states[k, 1]) >= FALL_ANGLE:
            return states[: k + 1], _FELL
        if k == count:
            break
        dt = times[k + 1] - times[k]
        for i in range(4):
            stage = (i + 1) // 2
            wanted = (cart_mass[k, stage], half_length[k, stage])
            if wanted != written:
                write_parameters(at, wanted[0], pole_mass, wanted[1], gravity)
                written = wanted
            if i == 0 and impulse[k] != 0.0:
                states[k] = _struck(at, states[k], impulse[k])
            state = states[k] + (share[i] * dt) * slopes[i - 1] if i else states[k]
            z1, p1, z2, p2 = _derivative(at, state, force_given(state, law[k, stage]), push[k])
            slopes[i, 0], slopes[i, 1], slopes[i, 2], slopes[i, 3] = z1, p1, z2, p2
        after = states[k] + (dt / 6.0) * (slopes[0] + 2.0 * slopes[1] + 2.0 * slopes[2] + slopes[3])
        if not within_limits(after):
            return states[: k + 1], ending_of(states[k])
        states[k + 1] = after
    return states, _COMPLETED


@kernel
def _march_sampled(at, initial_state, hold, cart_mass, half_length, constants, push, impulse, law):
    """March by `mj_step` and return states, shape (K, 4), held forces, shape (K,), and status."""
    pole_mass, gravity = constants
    count = len(push)
    states, forces = np.empty((count + 1, 4)), np.empty(count + 1)
    states[0] = initial_state
    written = (np.nan, np.nan)
    force = 0.0
    write_state(at, initial_state[0], initial_state[1], initial_state[2], initial_state[3])
    for k in range(count + 1):
        s = states[k]
        forces[k] = force
        if abs(s[1]) >= FALL_ANGLE:
            return states[: k + 1], forces[: k + 1], _FELL
        if k == count:
            break
        wanted = (cart_mass[k], half_length[k])
        if wanted != written:
            write_parameters(at, wanted[0], pole_mass, wanted[1], gravity)
            written = wanted
        if impulse[k] != 0.0:
            s[:] = _struck(at, s, impulse[k])
            write_state(at, s[0], s[1], s[2], s[3])
        if k % hold == 0:
            force = force_given(s, law[k])
        forces[k] = force
        if not abs(force) < STATE_LIMIT:
            return states[: k + 1], forces[: k + 1], ending_of(s)
        store(at[CONTROL], force)
        store(at[PUSH], push[k])
        mj_step(at[MODEL], at[DATA])
        after = states[k + 1]
        after[0], after[1] = load(at[Z]), load(at[PHI])
        after[2], after[3] = load(at[Z_DOT]), load(at[PHI_DOT])
        if not within_limits(after):
            return states[: k + 1], forces[: k + 1], ending_of(s)
    return states, forces, _COMPLETED
