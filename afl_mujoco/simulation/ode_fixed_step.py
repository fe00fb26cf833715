"""The analytic equations integrated by RK4: twins of MuJoCo's continuous and sampled modes.

What a deployed loop holds over a step can be switched on one by one: the control, the parameters,
the disturbances. So the error of each can be separated from that of the others.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from afl_mujoco.compiled import borrowing_kernel
from afl_mujoco.control.catalogue import as_controller, require_stateless
from afl_mujoco.control.controller import Controller
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.plant.dynamics import cart_acceleration, pole_acceleration
from afl_mujoco.scenario.files import as_scenario
from afl_mujoco.scenario.parameters import ParameterChange
from afl_mujoco.scenario.sampling import cut_period, held_disturbances, step_times, time_grid
from afl_mujoco.scenario.scenario import Scenario, Segment
from afl_mujoco.simulation.integrator import along_z, rk4_step, segment_numbers, work_space
from afl_mujoco.simulation.ode import compiled_command, plant_at, plant_loop, write_rates
from afl_mujoco.simulation.trajectory import (
    COMPLETED,
    FELL,
    OUTCOMES,
    STATE_LIMIT,
    Outcome,
    Trajectory,
    assemble,
    controller_inputs,
    criterion_of,
    ending_of,
    has_ended,
    within_limits,
)

SUBSTEPS = 8
"""RK4 steps within each held step: their error is some 4000 times below that of a single one."""

_COMPLETED, _FELL, _RUNNING = OUTCOMES.index(COMPLETED), OUTCOMES.index(FELL), -1
_PAPER = ParameterChange()


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
    scenario, controller = as_scenario(scenario), as_controller(controller)
    scenario.require_ideal()
    require_stateless(controller, "the ODE")
    times = time_grid(scenario, timestep)
    states, _, outcome = _run(scenario, controller, times, Holds(), times)
    settings = {"timestep": timestep}
    return assemble(scenario, controller, "ode RK4", settings, times, states, outcome)


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
    fine, times = time_grid(scenario, timestep / substeps), step_times(scenario.duration, timestep)
    states, forces, outcome = _run(scenario, controller, fine, holds, times, hold)
    kept = _starts(fine, times)
    kept = kept[kept < len(states)]
    settings = {"timestep": timestep, "control_period": holds.control_period, "substeps": substeps}
    settings |= {"hold_schedule": holds.schedule, "hold_disturbance": holds.disturbance}
    run = (scenario, controller, "ode held", settings, times, states[kept], outcome, forces[kept])
    return assemble(*run)


def _starts(fine: NDArray[np.float64], times: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the instants of a fine grid that are those of a coarse one."""
    found: NDArray[np.intp] = np.searchsorted(fine, times - 1e-9 * (times[1] - times[0]))
    return found


def _steps_of(fine: NDArray[np.float64], times: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the step of a coarse grid in which each step of a fine one lies."""
    starts = _starts(fine, times)
    found = np.searchsorted(starts, np.arange(len(fine) - 1), side="right") - 1
    return np.minimum(found, len(starts) - 2)  # a breakpoint may round to the horizon


def _run(
    scenario: Scenario,
    controller: Controller,
    fine: NDArray[np.float64],
    holds: Holds,
    times: NDArray[np.float64],
    hold: int = 0,
) -> tuple[NDArray[np.float64], NDArray[np.float64], Outcome]:
    """Return states, forces and outcome of a run on a fine grid.

    times: The grid over whose steps parameters and disturbances are held [s].
    hold: For how many of these the force is held; 0 for one that is evaluated in every stage.
    """
    controller_inputs(scenario, controller, fine)  # raises before the run if a gain is not positive
    if not scenario.is_cart_pole:
        return _run_plant(scenario, controller, fine, holds, times, hold)
    numbers, told, impulse = _numbers(scenario, fine, holds, times)
    count = len(impulse)
    ticks = _starts(fine, times)[:-1:hold] if hold else np.arange(count)
    states, forces, work = np.empty((count + 1, 4)), np.zeros(count + 1), work_space(4)
    states[0] = scenario.initial_state
    limits = criterion_of(scenario)
    status, last = _arrive(states, 0, impulse, numbers, fine, limits), 0
    profile = (numbers, told, impulse, fine, states, forces, work, limits)
    if controller.interpreted or controller.stateful:
        own = controller.start()

        def command(control: Any, told: Any, time: float, state: NDArray[np.float64]) -> float:
            assumed = own.assumed_parameters(*plant_at(told, time))
            return own.command(time, state, np.array(assumed))

        def follow(arguments: Any, time: float, state: Any, slopes: Any) -> None:
            numbers, told, control = arguments
            write_rates(numbers, time, state, command(control, told, time, state), slopes)

        for first, until in pairwise([*ticks.tolist(), count]):
            if status != _RUNNING:
                break
            if hold:
                force = command(None, told[first], float(fine[first]), states[first])
                last, status = _hold(*profile, first, until, force)
            else:
                last, status = _advance(follow, command, None, *profile, first, until)
    elif status == _RUNNING:
        update = np.zeros(count, dtype=np.bool_)
        update[ticks] = True
        assumed = controller.assumed_parameters(*[np.nan] * 4)
        compiled = tuple(controller.compiled_for(scenario.plants))
        run = _run_held if hold else _run_followed
        last, status = run(update, assumed, compiled, *profile)
    return _ended(states, forces[:, None], fine, last, status)


class _Steps:
    """The segments of a fine grid of any plant: as they are, and as the plant holds them."""

    def __init__(
        self,
        scenario: Scenario,
        fine: NDArray[np.float64],
        holds: Holds,
        times: NDArray[np.float64],
    ) -> None:
        self.segments, self.starts = scenario.segments, _starts(fine, times)
        first = np.array([segment.start for segment in self.segments])
        self.of = np.searchsorted(first, fine[:-1], side="right") - 1
        self.step = _steps_of(fine, times)
        held = scenario.values(0.5 * (times[:-1] + times[1:]))
        self.values = held if holds.schedule else None
        self.push = held_disturbances(scenario, times).push if holds.disturbance else None

    def true(self, k: int) -> Segment:
        """Return the segment in which a step lies."""
        found: Segment = self.segments[self.of[k]]
        return found

    def acting(self, k: int) -> Segment:
        """Return it with what is held."""
        found, step = self.true(k), self.step[k]
        if self.values is not None:
            found = replace(found, lines=tuple((x, 0.0) for x in self.values[step].tolist()))
        if self.push is not None:
            found = replace(found, push=tuple(self.push[step].tolist()))
        return found


def _run_plant(
    scenario: Scenario,
    controller: Controller,
    fine: NDArray[np.float64],
    holds: Holds,
    times: NDArray[np.float64],
    hold: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64], Outcome]:
    """Do the same for any plant by its own equations, called from Python."""
    own, limits, count = controller.start(), criterion_of(scenario), len(fine) - 1
    law: Any = SimpleNamespace(assumed_values=lambda values: values)
    derivative, arrive = plant_loop(scenario, law, _PAPER)
    steps = _Steps(scenario, fine, holds, times)
    ticks = {*steps.starts[:-1:hold].tolist()} if hold else set()
    forces = np.zeros((count + 1, len(scenario.plant.inputs)))
    states = np.empty((count + 1, len(scenario.initial_state)))
    states[0] = arrive(np.array(scenario.initial_state), None, steps.true(0))
    work = work_space(states.shape[1])

    def rates(segment: Segment, time: float, state: Any, slopes: Any) -> None:
        slopes[:] = derivative(time, state, segment)

    def follow(time: float, state: Any, _: Any) -> Any:
        return own.command(time, state, own.assumed_values(law.now.values_at(time)))

    for k in range(count):
        law.now, law.command = steps.true(k), follow
        forces[k] = forces[max(k - 1, 0)]
        if not hold or k in ticks:
            forces[k] = follow(float(fine[k]), states[k], None)
        if hold:
            law.command = partial(_kept, forces[k])
        forces[k + 1], step = forces[k], float(fine[k + 1] - fine[k])
        if (np.abs(forces[k]) < STATE_LIMIT).all():
            rk4_step(rates, steps.acting(k), float(fine[k]), step, states[k], work, states[k + 1])
        else:
            states[k + 1] = np.nan
        if not within_limits(states[k + 1]):
            return _ended(states, forces, fine, k, ending_of(limits, states[k]))
        if k + 1 < count and steps.of[k + 1] != steps.of[k]:
            states[k + 1] = arrive(states[k + 1], law.now, steps.true(k + 1))
        if has_ended(limits, states[k + 1]):
            return _ended(states, forces, fine, k + 1, _FELL)
    return _ended(states, forces, fine, count, _COMPLETED)


def _kept(force: NDArray[np.float64], *_: Any) -> NDArray[np.float64]:
    """Return inputs that are held."""
    return force


def _ended(
    states: NDArray[np.float64],
    forces: NDArray[np.float64],
    fine: NDArray[np.float64],
    last: int,
    status: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64], Outcome]:
    """Return what a run reached."""
    kept = forces[: last + 1]
    outcome = Outcome(OUTCOMES[status], float(fine[last]))
    return states[: last + 1], kept[:, 0] if kept.shape[1] == 1 else kept, outcome


def _numbers(
    scenario: Scenario, fine: NDArray[np.float64], holds: Holds, times: NDArray[np.float64]
) -> tuple[NDArray[np.float64], ...]:
    """Return the numbers of each step, as of `segment_numbers`, and the impulse at its start.

    Twice: as the plant holds them, and as a controller is told them, which are never held.
    """
    segments = scenario.segments
    starts = np.array([segment.start for segment in segments])
    table = np.array([segment_numbers(scenario, segment, _PAPER) for segment in segments])
    told = table[np.searchsorted(starts, fine[:-1], side="right") - 1]
    numbers, impulse = told.copy(), np.zeros(len(told))
    impulse[np.searchsorted(fine, starts)] = [along_z(segment.impulse) for segment in segments]
    start_of, step_of = _starts(fine, times), _steps_of(fine, times)
    if holds.schedule:
        middles = 0.5 * (times[:-1] + times[1:])
        inside = table[np.searchsorted(starts, middles, side="right") - 1]
        for value in (1, 3):
            held = inside[:, value] + inside[:, value + 1] * (middles - inside[:, 0])
            numbers[:, value], numbers[:, value + 1] = held[step_of], 0.0
    if holds.disturbance:
        push = held_disturbances(scenario, fine[start_of]).push
        numbers[:, 7] = push[step_of, 0] + push[step_of, 1]
    return numbers, told, impulse


@register_jitable
def row_of(numbers, k):
    """Return the numbers of a step as a tuple."""
    n = numbers[k]
    return n[0], n[1], n[2], n[3], n[4], n[5], n[6], n[7], n[8]


@register_jitable
def held_rates(arguments, time, state, slopes):
    """Write the rates of the plant under a force that is held."""
    write_rates(arguments[0], time, state, arguments[2], slopes)


@register_jitable
def _followed_rates(arguments, time, state, slopes):
    """Write the rates of the loop of plant and compiled controller."""
    numbers, told, control = arguments
    write_rates(numbers, time, state, _command(control, told, time, state), slopes)


@register_jitable
def _command(control, told, time, state):
    """Return the force [N] of a compiled controller."""
    assumed, compiled = control
    return compiled_command(told, assumed, compiled, time, state)


@register_jitable
def _held(force, told, time, state):
    """Return a force that is held."""
    return force


@register_jitable
def _advance(
    rates, command, control, numbers, told, impulse, times, states, forces, work, limits,
    first, until,
):  # fmt: skip
    """Step from an instant to another; return where it ended, and how."""
    for k in range(first, until):
        believed = row_of(told, k)
        force = command(control, believed, times[k], states[k])
        forces[k] = forces[k + 1] = force
        if not abs(force) < STATE_LIMIT:
            return k, ending_of(limits, states[k])
        arguments, step = (row_of(numbers, k), believed, control), times[k + 1] - times[k]
        rk4_step(rates, arguments, times[k], step, states[k], work, states[k + 1])
        if not within_limits(states[k + 1]):
            return k, ending_of(limits, states[k])
        status = _arrive(states, k + 1, impulse, numbers, times, limits)
        if status != _RUNNING:
            return k + 1, status
    return until, _RUNNING


@borrowing_kernel
def _hold(numbers, told, impulse, times, states, forces, work, limits, first, until, force):
    """Step from an instant to another under one force; return where it ended, and how."""
    return _advance(
        held_rates,
        _held,
        force,
        numbers,
        told,
        impulse,
        times,
        states,
        forces,
        work,
        limits,
        first,
        until,
    )


@borrowing_kernel
def _run_held(
    update, assumed, compiled, numbers, told, impulse, times, states, forces, work, limits
):
    """Run a compiled controller to the end, its force held from each update to the next."""
    first, status = 0, _RUNNING
    while status == _RUNNING:
        believed = row_of(told, first)
        force = _command((assumed, compiled), believed, times[first], states[first])
        until = first + 1
        while until < len(update) and not update[until]:
            until += 1
        first, status = _hold(
            numbers, told, impulse, times, states, forces, work, limits, first, until, force
        )
    return first, status


@borrowing_kernel
def _run_followed(
    update, assumed, compiled, numbers, told, impulse, times, states, forces, work, limits
):
    """Run a compiled controller to the end, its force evaluated in every stage."""
    return _advance(
        _followed_rates, _command, (assumed, compiled), numbers, told, impulse, times, states,
        forces, work, limits, 0, len(update),
    )  # fmt: skip


@borrowing_kernel
def _arrive(states, k, impulse, numbers, times, limits):
    """Reach instant k, apply the impulse there, and return the status."""
    if has_ended(limits, states[k]):
        return _FELL
    if k == len(impulse):
        return _COMPLETED
    if impulse[k] != 0.0:  # accelerations are linear in the force
        plant = plant_at(numbers[k], times[k])
        phi, phi_dot = states[k, 1], states[k, 3]
        free, hit = (
            cart_acceleration(phi, phi_dot, 0.0, *plant),
            cart_acceleration(phi, phi_dot, impulse[k], *plant),
        )
        states[k, 2] += hit - free
        free, hit = (
            pole_acceleration(phi, phi_dot, 0.0, *plant),
            pole_acceleration(phi, phi_dot, impulse[k], *plant),
        )
        states[k, 3] += hit - free
    return _RUNNING
