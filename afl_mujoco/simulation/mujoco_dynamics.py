"""MuJoCo as a right-hand side, and the effect of a breakpoint on the state by its mass matrix."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.controller import Controller
from afl_mujoco.scenario.parameter_change import ParameterChange
from afl_mujoco.scenario.scenario import Scenario, Segment
from afl_mujoco.simulation import mujoco_loops as loops
from afl_mujoco.simulation.integrator import (
    Derivative,
    Solver,
    Transition,
    compiled_solver,
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
from afl_mujoco.simulation.python_controller_rk4 import integrate_python_controller


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
        return loops.solve(
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
        result: tuple[float, ...] = loops.forced_derivative(
            at, state, true, force, segment.push, rate
        )
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
        reached: tuple[NDArray[np.float64], int] = loops.integrate_continuous(
            *arguments, controller.kind, inputs
        )
        return reached
    pole_mass, gravity = constants

    def slope(k: int, stage: int, x: NDArray[np.float64], force: float) -> tuple[float, ...]:
        true = (cart_mass[k, stage], pole_mass, half_length[k, stage], gravity)
        rate: tuple[float, ...] = loops.forced_derivative(at, x, true, force, *acting)
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
