"""The analytic reference: (P3), (P4) under the controller, integrated to tight tolerance."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from afl_mujoco.compiled import borrowing_kernel, kernel
from afl_mujoco.control.catalogue import as_controller, require_stateless
from afl_mujoco.control.controller import Controller, compiled_force
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.plant.dynamics import (
    cart_acceleration,
    mass_matrix,
    pole_acceleration,
    velocity_jump,
)
from afl_mujoco.plant.stretching_rod import stretching_accelerations
from afl_mujoco.plants.equations import POINTS, Points, load_equations, split
from afl_mujoco.plants.tree import Tree, terms_of
from afl_mujoco.scenario.disturbances import Impulse
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
    along_z,
    compiled_solver,
    integrate,
    longest_step_of,
    require_tolerances,
    scipy_solver,
    segment_numbers,
)
from afl_mujoco.simulation.trajectory import (
    STATE_LIMIT,
    Criterion,
    Outcome,
    Trajectory,
    assemble,
    controller_inputs,
    criterion_of,
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
    trees: Trees | None = None,
) -> Trajectory:
    """Simulate the equations of a plant, by default the paper's, restarted at every breakpoint.

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
    trees
        The plant as a tree of bodies, for parameters whose rates enter: what
        `afl_mujoco.simulate_ode` gives.

    Returns
    -------
    Trajectory
        The run; one in which the pole falls ends there, with the outcome recorded.

    Raises
    ------
    AflMujocoError
        If a setting breaks its rule.
    """
    change, scenario = ParameterChange(dynamics=dynamics, jumps=jumps), as_scenario(scenario)
    controller = as_controller(controller)
    times, states, outcome = solve_ode(
        scenario,
        controller,
        sample_period=sample_period,
        method=method,
        rtol=rtol,
        atol=atol,
        change=change,
        trees=trees,
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
    trees: Trees | None = None,
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
    criterion = criterion_of(scenario)
    if not scenario.is_cart_pole:
        loop, arrive = plant_loop(scenario, controller, change, trees)
    else:
        loop, arrive = closed_loop(scenario, controller, change), transition(scenario, change)
    if method != "DOP853" or controller.interpreted or not scenario.is_cart_pole:
        solver = scipy_solver(
            loop,
            method,
            rtol,
            atol,
            controller=controller.name,
            criterion=criterion,
            longest=longest_step_of(scenario),
        )
    else:
        require_tolerances(method, rtol, atol)
        compiled = compiled_loop(scenario, controller, change, criterion)
        solver = compiled_solver(compiled, criterion, rtol, atol, longest_step)
    nodes = controller.nodes_within(scenario.spans)
    states, outcome = integrate(scenario, solver, arrive, times, nodes=nodes)
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
def _solve(plant, assumed, compiled, limits, start, end, state, times, options, work, found):
    """Integrate the compiled loop over a segment."""
    return dop853.solve(
        loop_rates, (plant, assumed, compiled), limits, start, end, state, times, options,
        work, found,
    )  # fmt: skip


def compiled_loop(
    scenario: Scenario, controller: Controller, change: ParameterChange, criterion: Criterion
) -> Callable[..., tuple[int, float, int]]:
    """Return the solver of the closed loop over a segment, as `compiled_solver` takes it."""
    compiled, assumed = (
        tuple(controller.compiled_for(scenario.plants)),
        controller.assumed_parameters(*[np.nan] * 4),
    )

    def solve(segment: Segment, *rest: Any) -> Any:
        plant = segment_numbers(scenario, segment, change)
        return _solve(plant, assumed, compiled, criterion, segment.start, segment.end, *rest)

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
        values = segment.values_at(time).tolist()
        return CartPoleParameters(**dict(zip(scenario.schedule, values, strict=True)))

    def arrive(
        state: NDArray[np.float64], before: Segment | None, after: Segment
    ) -> NDArray[np.float64]:
        p = parameters(after, after.start)
        impulse = along_z(after.impulse)
        state = state.copy()
        if before is not None and change.stretching:
            kink = after.lines[2][1] - before.lines[2][1]
            impulse += scenario.pole_mass * kink * float(np.sin(state[1]))
        if before is not None and change.keeps_momenta:
            kept = mass_matrix(state, parameters(before, before.end)) @ state[2:4]
            state[2:4] = np.linalg.solve(mass_matrix(state, p), kept)
        if impulse != 0.0:
            state[2:4] += velocity_jump(state[:4], impulse, p)
        return state

    return arrive


class Trees(Protocol):
    """The tree of a plant at rest, and as it moves under rates of parameters."""

    def at(self, values: NDArray[np.float64], rates: NDArray[np.float64]) -> tuple[Tree, Tree]:
        """Return both with some parameters and rates."""

    def along(self, segment: Segment, time: float) -> tuple[Tree, Tree]:
        """Return both at a time of a segment."""


def plant_loop(
    scenario: Scenario,
    controller: Controller,
    change: ParameterChange,
    trees: Trees | None = None,
) -> tuple[Derivative, Transition]:
    """Return the loop of any plant's own equations and its controller, called from Python.

    Equations say nothing of the rates of parameters: where these act, a tree says what they do.
    """
    plant = scenario.plant
    n, k = len(plant.coordinates), len(plant.inputs)
    require_equations(scenario, change)
    enters = plant.entering
    low, high = plant.limits.T
    equations = load_equations(plant, _points(scenario))
    size = n * (n + 1 + k) if plant.terms else n

    def terms(q: NDArray[np.float64], v: NDArray[np.float64], p: NDArray[np.float64]) -> Any:
        found = np.empty(size)
        equations.fill(q, v, np.zeros(k), p, found)
        return split(plant, found[None])

    def derivative(time: float, state: NDArray[np.float64], segment: Segment) -> Any:
        p, x = segment.values_at(time), np.ascontiguousarray(state[: 2 * n])
        u = np.atleast_1d(controller.command(time, x, controller.assumed_values(p)))
        if not (np.abs(u) < STATE_LIMIT).all():
            return np.full(2 * n, np.nan)
        push = np.array(segment.push)
        u = np.minimum(np.maximum(u, low), high) + push[:k]
        found = np.empty(size)
        equations.fill(x[:n], x[n:], u, p, found)
        if plant.terms:
            mass, bias, inputs = split(plant, found[None])
            found = np.linalg.solve(mass[0], inputs[0] @ u + push[k:] - bias[0])
        if enters.any():
            found = found - _drag(trees, enters, segment, time, x)
        return np.concatenate([x[n:], found])

    def arrive(
        state: NDArray[np.float64], before: Segment | None, after: Segment
    ) -> NDArray[np.float64]:
        impulse, state = np.array(after.impulse), state.copy()
        p, joins = after.values_at(after.start), after.start in scenario.joins
        rates = [
            np.where(enters, [rate for _, rate in one.lines], 0.0)
            for one in (before or after, after)
        ]
        if joins or impulse.any():
            mass, _, inputs = terms(state[:n].copy(), state[n:].copy(), p)
            if joins and before is not None:  # M v + N p' stays, as M changes
                old, _, _ = terms(state[:n].copy(), state[n:].copy(), before.values_at(before.end))
                kept = old[0] @ state[n:]
                kept += _carried(trees, before.values_at(before.end), rates[0], state[:n])[0]
                kept -= _carried(trees, p, rates[1], state[:n])[0]
                state[n:] = np.linalg.solve(mass[0], kept)
            state[n:] += np.linalg.solve(mass[0], inputs[0] @ impulse[:k] + impulse[k:])
        if not joins and (kink := rates[1] - rates[0]).any():
            momenta, inertia = _carried(trees, p, kink, state[:n])
            state[n:] -= np.linalg.solve(inertia, momenta)
        return state

    return derivative, arrive


def _drag(
    trees: Trees | None,
    enters: NDArray[np.bool_],
    segment: Segment,
    time: float,
    state: NDArray[np.float64],
) -> Any:
    """Return by how much rates of parameters lower the accelerations."""
    if not any(rate for enter, (_, rate) in zip(enters, segment.lines, strict=True) if enter):
        return 0.0
    n = len(state) // 2
    needed, inertia = _needed(*_given(trees).along(segment, time), state[:n], state[n:])
    return np.linalg.solve(inertia, needed)


def _carried(
    trees: Trees | None, values: NDArray[np.float64], rates: NDArray[np.float64], q: Any
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the momenta that rates give a plant at rest, N p', and its mass matrix."""
    if not rates.any():
        return np.zeros(len(q)), np.eye(len(q))
    still, moving = _given(trees).at(values, rates)
    drift = np.zeros_like(moving.drift)  # a jump of d' is an impulse of d''
    drift[:, [1, 3]] = moving.drift[:, [0, 2]]
    return _needed(still, moving._replace(drift=drift), q, np.zeros(len(q)))


def _given(trees: Trees | None) -> Trees:
    """Return trees, or raise if there are none."""
    if trees is None:
        raise InvalidValueError("trees", "must be given where the rate of a parameter enters")
    return trees


def _needed(
    still: Tree, moving: Tree, q: Any, v: Any
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the forces that motion under rates needs besides, and the mass matrix."""
    q, v = np.array(q), np.array(v)
    without = terms_of(still, q, v)
    return terms_of(moving, q, v).bias - without.bias, without.mass


def require_equations(scenario: Scenario, change: ParameterChange | None = None) -> None:
    """Raise unless the equations of a plant can say what happens in a scenario."""
    plant = scenario.plant
    if not plant.has_equations:
        rule = "must have accelerations or terms, its equations, to be integrated"
        raise InvalidValueError(f"plant {plant.name!r}", rule)
    if change is not None and not change.is_the_papers:
        rule = "are of the cart-pole: another plant says them for each parameter"
        raise InvalidValueError("dynamics and jumps", rule)
    asked = ["an impulse" for one in scenario.disturbances if isinstance(one, Impulse)]
    asked += [f"a force along {one.coordinate}" for one in scenario.disturbances if one.coordinate]
    asked += [f"what joins at rest at {time:g} s" for time in scenario.joins]
    if asked and plant.terms is None:
        rule = "needs equations as terms: accelerations do not say what momenta do"
        raise InvalidValueError(f"plant {plant.name!r}, {asked[0]}", rule)


def _points(scenario: Scenario) -> Points:
    """Return random states, inputs and parameters of a scenario, as `load_equations` takes them."""
    plant = scenario.plant
    n, k = len(plant.coordinates), len(plant.inputs)
    rng = np.random.default_rng(0)
    low, high = np.array([*scenario.spans.values()]).reshape(-1, 2).T
    about = np.array(scenario.target)
    return Points(
        q=about + rng.uniform(-0.5, 0.5, (POINTS, n)),
        v=rng.uniform(-1.0, 1.0, (POINTS, n)),
        u=rng.uniform(-1.0, 1.0, (POINTS, k)),
        p=rng.uniform(low, high, (POINTS, len(low))),
    )
