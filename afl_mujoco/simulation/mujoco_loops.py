"""The compiled loops around MuJoCo's library: no interpreter between one step and the next."""

from __future__ import annotations

import numpy as np
from numba.extending import register_jitable

from afl_mujoco.compiled import borrowing_kernel, kernel
from afl_mujoco.control.compiled_controller import compiled_force, force_from_inputs
from afl_mujoco.simulation import dop853
from afl_mujoco.simulation.integrator import limit_margin
from afl_mujoco.simulation.mujoco_model import (
    forward,
    write_parameters,
)
from afl_mujoco.simulation.trajectory import (
    COMPLETED,
    FALL_ANGLE,
    FELL,
    OUTCOMES,
    STATE_LIMIT,
    ending_of,
    within_limits,
)

_COMPLETED, _FELL = OUTCOMES.index(COMPLETED), OUTCOMES.index(FELL)


@kernel
def _derivative(at, state, force, push, pole_mass, half_length, rate):
    """Return (z_dot, phi_dot, z'', phi'') by MuJoCo; NaN where the controller has no force.

    A rod that stretches at `rate` [m/s] acts on both joints (decision D9).
    """
    if not abs(force) < STATE_LIMIT:
        return np.nan, np.nan, np.nan, np.nan
    z, phi, z_dot, phi_dot = state[0], state[1], state[2], state[3]
    torque = 0.0
    if rate != 0.0:
        push += 2.0 * pole_mass * rate * phi_dot * np.cos(phi)
        torque = -8.0 / 3.0 * pole_mass * half_length * rate * phi_dot
    z_ddot, phi_ddot = forward(at, z, phi, z_dot, phi_dot, force, push, torque)
    return z_dot, phi_dot, z_ddot, phi_ddot


@kernel
def forced_derivative(at, state, true, force, push, rate):
    """Return (z_dot, phi_dot, z'', phi'') under a force.

    state: (z, phi, z_dot, phi_dot), shape (4,) or longer.
    force: Force of the controller [N]; NaN where it has none.
    push: Disturbing force [N].
    rate: Rate of the half-length that acts on the rod [m/s].
    """
    write_parameters(at, true[0], true[1], true[2], true[3])
    return _derivative(at, state, force, push, true[1], true[2], rate)


@register_jitable
def loop_rates(arguments, time, state, slopes):
    """Write (z_dot, phi_dot, z'', phi'') under the controller, as `dop853` needs them.

    `arguments` are `CartPoleModel.addresses`, the numbers of the segment from
    `integrator.segment_numbers`, the assumed (M, m, l, g), NaN for the true values, and the
    controller as a `CompiledController`.
    """
    at, numbers, assumed, compiled = arguments
    start, mass, mass_rate, length, length_rate, pole_mass, gravity, push, rate = numbers
    kind, table, masses, lengths = compiled
    true = (
        mass + mass_rate * (time - start), pole_mass, length + length_rate * (time - start),
        gravity,
    )  # fmt: skip
    if np.isnan(assumed[0]):
        assumed = true
    z, phi, z_dot, phi_dot = state[0], state[1], state[2], state[3]
    force = compiled_force(kind, table, masses, lengths, z, phi, z_dot, phi_dot, assumed)
    found = forced_derivative(at, state, true, force, push, rate)
    slopes[0], slopes[1], slopes[2], slopes[3] = found


@borrowing_kernel
def solve(at, numbers, assumed, compiled, start, end, state, times, options, work, found):
    """Integrate the compiled loop over a segment by `dop853.solve`."""
    return dop853.solve(
        loop_rates, (at, numbers, assumed, compiled), limit_margin, start, end, state, times,
        options, work, found,
    )  # fmt: skip


@kernel
def integrate_continuous(
    at, initial_state, times, cart_mass, half_length, constants, acting, kind, inputs
):
    """Integrate one segment by RK4, controller and parameters evaluated in every stage.

    times: Ends of the steps [s], shape (N + 1,).
    cart_mass, half_length: M, l at the start, the middle and the end of each step, shape (N, 3).
    acting: Disturbing force [N] and acting rate of the half-length [m/s].
    inputs: Inputs of the controller in each stage, shape (N, 3, 7) or (N, 3, 8).
    Returns tuple: The states reached, shape (K, 4), and the index of the outcome.
    """
    pole_mass, gravity = constants
    push, rate = acting
    count = len(times) - 1
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
            state = states[k] + (share[i] * dt) * slopes[i - 1] if i else states[k]
            force = force_from_inputs(kind, state, inputs[k, stage])
            z1, p1, z2, p2 = _derivative(at, state, force, push, pole_mass, wanted[1], rate)
            slopes[i, 0], slopes[i, 1], slopes[i, 2], slopes[i, 3] = z1, p1, z2, p2
        after = states[k] + (dt / 6.0) * (slopes[0] + 2.0 * slopes[1] + 2.0 * slopes[2] + slopes[3])
        if not within_limits(after):
            return states[: k + 1], ending_of(states[k])
        states[k + 1] = after
    return states, _COMPLETED
