"""The closed loop in MuJoCo: exact, continuous and sampled mode."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from afl_mujoco.compiled import borrowing_kernel, kernel
from afl_mujoco.control.catalogue import as_controller, require_stateless
from afl_mujoco.control.controller import Controller, compiled_force
from afl_mujoco.errors import InvalidValueError, UnknownNameError
from afl_mujoco.scenario.files import as_scenario
from afl_mujoco.scenario.parameters import QUASI_STATIC, VELOCITIES, ParameterChange
from afl_mujoco.scenario.sampling import time_grid
from afl_mujoco.scenario.scenario import Scenario, Segment
from afl_mujoco.simulation import integrator as dop853
from afl_mujoco.simulation.integrator import (
    ATOL,
    NONE,
    RTOL,
    Derivative,
    Solver,
    Transition,
    compiled_solver,
    integrate,
    limit_margin,
    python_rk4,
    scipy_solver,
    segment_numbers,
)
from afl_mujoco.simulation.mujoco_model import (
    CartPoleModel,
    forward,
    impulse_jump,
    mujoco,
    write_parameters,
)
from afl_mujoco.simulation.sampled.runs import simulate_sampled, ticks_of
from afl_mujoco.simulation.trajectory import (
    COMPLETED,
    FELL,
    OUTCOMES,
    STATE_LIMIT,
    Trajectory,
    assemble,
    controller_inputs,
)

if TYPE_CHECKING:
    import mujoco

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
        # (D9): Coriolis force of the growing rod on the cart, and its torque about the hinge
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
def solve_segment(at, numbers, assumed, compiled, start, end, state, times, options, work, found):
    """Integrate the compiled loop over a segment by `dop853.solve`."""
    return dop853.solve(
        loop_rates, (at, numbers, assumed, compiled), limit_margin, start, end, state, times,
        options, work, found,
    )  # fmt: skip


@borrowing_kernel
def step_segment(at, numbers, assumed, compiled, start, end, state, times, options, work, found):
    """Integrate the compiled loop over a segment by `dop853.solve_rk4`."""
    return dop853.solve_rk4(
        loop_rates, (at, numbers, assumed, compiled), limit_margin, start, end, state, times,
        options, work, found,
    )  # fmt: skip


def solver(
    model: CartPoleModel,
    scenario: Scenario,
    controller: Controller,
    change: ParameterChange,
    mode: str,
) -> Solver:
    """Return the solver of the closed loop of MuJoCo's forward dynamics and the controller."""
    if controller.interpreted:
        loop = closed_loop(model, scenario, controller, change)
        if mode == "continuous":
            return python_rk4(loop)
        return scipy_solver(loop, controller=controller.name)
    compiled, assumed = (
        tuple(controller.compiled_for(scenario.plants)),
        controller.assumed_parameters(*[np.nan] * 4),
    )
    integrated = step_segment if mode == "continuous" else solve_segment

    def solve(segment: Segment, *rest: Any) -> Any:
        numbers = segment_numbers(scenario, segment, change)
        return integrated(
            model.addresses, numbers, assumed, compiled, segment.start, segment.end, *rest
        )

    return compiled_solver(solve)


def closed_loop(
    model: CartPoleModel, scenario: Scenario, controller: Controller, change: ParameterChange
) -> Derivative:
    """Return the right-hand side of the same loop, called from Python; arguments as in `solver`."""
    at, pole_mass, gravity = model.addresses, scenario.pole_mass, scenario.gravity

    def derivative(time: float, state: NDArray[np.float64], segment: Segment) -> tuple[float, ...]:
        mass, length = segment.parameters_at(time)
        true = (mass, pole_mass, length, gravity)
        force = controller.command(time, state[:4], np.array(controller.assumed_parameters(*true)))
        rate = segment.half_length[1] if change.stretching else 0.0
        result: tuple[float, ...] = forced_derivative(at, state, true, force, segment.push, rate)
        return result

    return derivative


def transition(model: CartPoleModel, scenario: Scenario, change: ParameterChange) -> Transition:
    """Return the effect of a breakpoint on the state, from MuJoCo's own mass matrix."""

    def enter(segment: Segment, time: float) -> None:
        mass, length = segment.parameters_at(time)
        write_parameters(model.addresses, mass, scenario.pole_mass, length, scenario.gravity)

    def arrive(
        state: NDArray[np.float64], before: Segment | None, after: Segment
    ) -> NDArray[np.float64]:
        at, state = model.addresses, state.copy()
        impulse = after.impulse
        if before is not None and change.stretching:
            kink = after.half_length[1] - before.half_length[1]
            impulse += scenario.pole_mass * kink * float(np.sin(state[1]))
        if before is not None and change.keeps_momenta:
            enter(before, before.end)
            kept = momenta(model, state)
            enter(after, after.start)
            state[2:4] = velocities(model, state, kept)
        if impulse != 0.0:
            enter(after, after.start)
            state[2:4] += impulse_jump(at, *state[:4].tolist(), impulse)
        return state

    return arrive


def momenta(model: CartPoleModel, state: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the generalised momenta of (z, phi), MuJoCo's mass matrix times the velocities."""
    forward(model.addresses, *state[:4].tolist(), 0.0, 0.0)
    result = np.empty(2)
    mujoco.mj_mulM(model.mj_model, model.mj_data, result, state[2:4])
    return result


def velocities(
    model: CartPoleModel, state: NDArray[np.float64], momentum: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the (z_dot, phi_dot) of generalised momenta, the inverse of `momenta`.

    momentum: Momenta of (z, phi), shape (2,).
    """
    forward(model.addresses, *state[:4].tolist(), 0.0, 0.0)
    result = np.empty((1, 2))
    mujoco.mj_solveM(model.mj_model, model.mj_data, result, momentum[None])
    velocity: NDArray[np.float64] = result[0]
    return velocity


MODES = ("exact", "continuous", "sampled")


def simulate_mujoco(
    scenario: Scenario | str | Path,
    controller: Any,
    mode: str = "sampled",
    *,
    timestep: float | None = None,
    control_period: float | None = None,
    integrator: str = "RK4",
    dynamics: str = QUASI_STATIC,
    jumps: str = VELOCITIES,
    edit: Callable[[mujoco.MjSpec], None] | None = None,
) -> Trajectory:
    """Simulate the MuJoCo cart-pole under the controller, its parameters changed while it runs.

    Parameters
    ----------
    scenario
        What happens: a scenario, a name of the catalogue, or the path of a file.
    controller
        The controller: a name, ``module:attribute``, a function, a class or factory, or a
        `Controller`.
    mode
        ``"sampled"``: as deployed, `mj_step` with the control held for `control_period`, the
        parameters of the middle of each step, and the scenario's imperfections, which no other mode
        supports; ``"exact"``: MuJoCo's forward dynamics with the integrator of `simulate_ode`;
        ``"continuous"``: RK4 around MuJoCo's forward dynamics, controller and parameters in every
        stage, steps that end on every breakpoint.
    timestep
        Physics step [s], in exact mode the spacing of the reported instants; by default the longest
        up to 1 ms that divides the control period. Where the damping of a joint is too fast for
        RK4, sampled mode takes a finer one, which the provenance and a remark say.
    control_period
        How long sampled mode holds the force [s], a multiple of `timestep` (default: that of the
        scenario's imperfections, else one step).
    integrator
        MuJoCo's integrator in sampled mode: ``"RK4"``, ``"Euler"``, ``"implicit"`` or
        ``"implicitfast"``.
    edit
        Called with the `mujoco.MjSpec` before it is compiled, to add what the paper leaves out.
    dynamics, jumps
        What a change of M and l does, as in `ParameterChange`; sampled mode supports only the
        paper's.

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
    scenario, controller = as_scenario(scenario), as_controller(controller)
    if mode != "sampled":
        scenario.require_ideal()
        require_stateless(controller, f"{mode} mode")
    ticks = ticks_of(scenario, timestep, control_period)
    model = CartPoleModel(
        scenario.parameters_at(0.0),
        timestep=ticks.timestep,
        integrator=integrator,
        edit=edit,
        imperfections=scenario.imperfections,
    )
    if edit is None:  # an edit may have added what would be left out
        model.compute_only(scenario.imperfections)
    change = ParameterChange(dynamics=dynamics, jumps=jumps)
    if mode == "sampled":
        if not change.is_the_papers:
            raise InvalidValueError("dynamics and jumps", "must be the paper's in sampled mode")
        return simulate_sampled(
            scenario,
            controller,
            timestep=timestep,
            control_period=control_period,
            integrator=integrator,
            model=model,
        )
    times = time_grid(scenario, ticks.timestep)
    controller_inputs(
        scenario, controller, times
    )  # raises before the run if a gain is not positive
    settings = {"timestep": ticks.timestep, **change.describe()}
    nodes = (NONE, NONE)  # a fixed step crosses them
    if mode == "exact":
        settings |= {"method": "DOP853", "rtol": RTOL, "atol": ATOL}
        nodes = controller.nodes(scenario.plants)
    states, outcome = integrate(
        scenario,
        solver(model, scenario, controller, change, mode),
        transition(model, scenario, change),
        times,
        nodes=nodes,
    )
    return assemble(scenario, controller, f"mujoco {mode}", settings, times, states, outcome)
