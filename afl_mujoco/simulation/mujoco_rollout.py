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
from afl_mujoco.control.controller import Controller, compiled_force, force_from_inputs
from afl_mujoco.errors import InvalidValueError, UnknownNameError
from afl_mujoco.scenario.files import as_scenario
from afl_mujoco.scenario.parameters import QUASI_STATIC, VELOCITIES, ParameterChange
from afl_mujoco.scenario.sampling import steps, time_grid
from afl_mujoco.scenario.scenario import Scenario, Segment
from afl_mujoco.simulation import integrator as dop853
from afl_mujoco.simulation.integrator import (
    ATOL,
    RTOL,
    Derivative,
    Solver,
    Transition,
    compiled_solver,
    integrate,
    integrate_python_controller,
    limit_margin,
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
    FALL_ANGLE,
    FELL,
    OUTCOMES,
    STATE_LIMIT,
    Outcome,
    Trajectory,
    assemble,
    controller_inputs,
    ending_of,
    within_limits,
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


def solver(
    model: CartPoleModel, scenario: Scenario, controller: Controller, change: ParameterChange
) -> Solver:
    """Return the solver of the closed loop of MuJoCo's forward dynamics and the controller."""
    if controller.interpreted:
        loop = closed_loop(model, scenario, controller, change)
        return scipy_solver(loop, controller=controller.name)
    compiled, assumed = (
        tuple(controller.compiled_for(scenario.plants)),
        controller.assumed_parameters(*[np.nan] * 4),
    )

    def solve(segment: Segment, *rest: Any) -> Any:
        numbers = segment_numbers(scenario, segment, change)
        return solve_segment(
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


def integrate_segment_rk4(
    at: Any,
    state: NDArray[np.float64],
    times: NDArray[np.float64],
    cart_mass: NDArray[np.float64],
    half_length: NDArray[np.float64],
    constants: tuple[float, float],
    acting: tuple[float, float],
    controller: Controller,
    inputs: NDArray[np.float64],
) -> tuple[NDArray[np.float64], int]:
    """Integrate a segment as `mujoco_loops.integrate_continuous` does, under any controller."""
    arguments = (at, state, times, cart_mass, half_length, constants, acting)
    if not controller.interpreted:
        reached: tuple[NDArray[np.float64], int] = integrate_continuous(
            *arguments, controller.kind, inputs
        )
        return reached
    pole_mass, gravity = constants

    def slope(k: int, stage: int, x: NDArray[np.float64], force: float) -> tuple[float, ...]:
        true = (cart_mass[k, stage], pole_mass, half_length[k, stage], gravity)
        rate: tuple[float, ...] = forced_derivative(at, x, true, force, *acting)
        return rate

    states, _, status = integrate_python_controller(
        controller, state, times, inputs, lambda k, x: x, slope
    )
    return states, status


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
    settings = {"timestep": ticks.timestep, **change.describe()}
    if mode == "continuous":
        return _continuous(model, scenario, controller, change, settings)
    return _exact(model, scenario, controller, change, settings)


def _exact(
    model: CartPoleModel,
    scenario: Scenario,
    controller: Controller,
    change: ParameterChange,
    settings: dict[str, Any],
) -> Trajectory:
    """Simulate MuJoCo's forward dynamics with the reference integrator."""
    times = time_grid(scenario, settings["timestep"])
    controller_inputs(
        scenario, controller, times
    )  # raises before the run if a gain is not positive
    states, outcome = integrate(
        scenario,
        solver(model, scenario, controller, change),
        transition(model, scenario, change),
        times,
        nodes=controller.nodes(scenario.plants),
    )
    settings = settings | {"method": "DOP853", "rtol": RTOL, "atol": ATOL}
    return assemble(scenario, controller, "mujoco exact", settings, times, states, outcome)


def _continuous(
    model: CartPoleModel,
    scenario: Scenario,
    controller: Controller,
    change: ParameterChange,
    settings: dict[str, Any],
) -> Trajectory:
    """Simulate by RK4 around MuJoCo's forward dynamics, with all inputs updated in every stage."""
    grid = steps(scenario, settings["timestep"])
    inputs = controller.inputs_along_run(
        grid.cart_mass, grid.half_length, scenario.pole_mass, scenario.gravity
    )
    arrive = transition(model, scenario, change)
    state, reached, status = np.array(scenario.initial_state), [], COMPLETED
    before: Segment | None = None
    for segment in scenario.segments:
        state = arrive(state, before, segment)
        before = segment
        first, last = np.searchsorted(grid.times, (segment.start, segment.end))
        part = slice(first, last)
        states, code = integrate_segment_rk4(
            model.addresses,
            state,
            grid.times[first : last + 1],
            grid.cart_mass[part],
            grid.half_length[part],
            (scenario.pole_mass, scenario.gravity),
            (segment.push, segment.half_length[1] if change.stretching else 0.0),
            controller,
            inputs[part],
        )
        state, status = states[-1], OUTCOMES[code]
        reached.append(states[:-1])
        if status != COMPLETED:
            break
    all_states = np.concatenate([*reached, state[None]])
    outcome = Outcome(status, float(grid.times[len(all_states) - 1]))
    return assemble(
        scenario, controller, "mujoco continuous", settings, grid.times, all_states, outcome
    )
