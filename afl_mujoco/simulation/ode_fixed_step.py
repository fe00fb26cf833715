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
from numpy.typing import NDArray

from afl_mujoco.compiled import borrowing_kernel, jitable, kernel
from afl_mujoco.control.catalogue import as_controller, require_stateless
from afl_mujoco.control.controller import Controller, command
from afl_mujoco.errors import require_count
from afl_mujoco.plants.plant import Floats
from afl_mujoco.scenario.files import as_scenario
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.time_steps import cut_period, held_disturbances, step_times, time_grid
from afl_mujoco.simulation.integrator import rk4_step, work_space
from afl_mujoco.simulation.ode import Loop, held_rates, line_of, loop_rates, values_at
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

SUBSTEPS, MOST_SUBSTEPS = 8, 10_000
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
    scenario, controller = as_scenario(scenario), as_controller(controller)
    scenario.require_ideal()
    require_stateless(controller, "the ODE")
    times = time_grid(scenario, timestep)
    states, _, outcome = _run(scenario, controller, times, Holds(), times)
    return assemble(scenario, controller, "ode RK4", {"timestep": timestep}, times, states, outcome)


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
        If the scenario has imperfections or parameters whose rate enters, `substeps` is no number
        of steps, the step is not positive or does not divide the control period, or the force is
        not held and the controller has a memory.
    """
    scenario, controller = as_scenario(scenario), as_controller(controller)
    scenario.require_ideal()
    substeps = require_count("substeps", substeps, 1, MOST_SUBSTEPS)
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


def _starts(fine: Floats, times: Floats) -> NDArray[np.intp]:
    """Return the instants of a fine grid that are those of a coarse one."""
    found: NDArray[np.intp] = np.searchsorted(fine, times - 1e-9 * (times[1] - times[0]))
    return found


def _steps_of(fine: Floats, times: Floats) -> NDArray[np.intp]:
    """Return the step of a coarse grid in which each step of a fine one lies."""
    starts = _starts(fine, times)
    found = np.searchsorted(starts, np.arange(len(fine) - 1), side="right") - 1
    return np.minimum(found, len(starts) - 2)  # a breakpoint may round to the horizon


def _run(
    scenario: Scenario,
    controller: Controller,
    fine: Floats,
    holds: Holds,
    times: Floats,
    hold: int = 0,
) -> tuple[Floats, Floats, Outcome]:
    """Return states, forces and outcome on a fine grid; `hold` 0 evaluates them in every stage."""
    controller_inputs(scenario, controller, fine)  # raises before the run if a gain is not positive
    loop = Loop(scenario, None, controller, continuous=False)
    limits, arrive, segments = criterion_of(scenario), loop.arrive, scenario.segments
    starts, step_of, count = _starts(fine, times), _steps_of(fine, times), len(fine) - 1
    ticks = np.full(count, not hold)
    if hold:
        ticks[starts[:-1:hold]] = True
    none = np.empty((count, 0))
    held = scenario.values(0.5 * (times[:-1] + times[1:]))[step_of] if holds.schedule else none
    push = held_disturbances(scenario, times).push[step_of] if holds.disturbance else none
    states = np.empty((count + 1, len(scenario.initial_state)))
    forces = np.zeros((count + 1, len(scenario.plant.inputs)))
    states[0] = scenario.initial_state
    work, last, status, before = work_space(states.shape[1]), 0, _RUNNING, None
    begins = np.searchsorted(fine[:-1], [segment.start for segment in segments])
    for segment, (first, until) in zip(segments, pairwise([*begins, count]), strict=True):
        if first == until:  # what begins at the horizon
            continue
        status = _FELL if has_ended(limits, states[first]) else status
        if status != _RUNNING:
            break
        states[first] = arrive(states[first], before, segment)
        before, line = segment, line_of(segment)
        true = line._replace(values=line.values.copy(), rates=line.rates.copy())
        part = (ticks, held, push, fine, states, forces, work, limits, first, until)
        with loop.watched():
            dynamics, law = loop.along(segment), loop.laws.along(segment)
            last, status = _advance(dynamics, line, true, law, loop.space, bool(hold), *part)
        if status not in (_RUNNING, _FELL):
            loop.require_equations_at(states[last], fine[last], segment)
    if status == _RUNNING:
        status = _FELL if has_ended(limits, states[last]) else _COMPLETED
    kept = forces[: last + 1]
    outcome = Outcome(OUTCOMES[status], float(fine[last]))
    return states[: last + 1], kept[:, 0] if kept.shape[1] == 1 else kept, outcome


@jitable
def _hold(line, values, push, k):
    for i in range(values.shape[1]):
        line.values[i], line.rates[i] = values[k, i], 0.0
    for i in range(push.shape[1]):
        line.push[i] = push[k, i]


@borrowing_kernel
def _advance(
    dynamics, line, true, law, space, holding, ticks, held, push, times, states, forces, work,
    limits, first, until,
):  # fmt: skip
    """Step within a segment; `line`, overwritten where it is held, acts, `true` is known."""
    followed, plant = (dynamics, line, true, law, space), (dynamics, line, space)
    for k in range(first, until):
        if k > first and has_ended(limits, states[k]):
            return k, _FELL
        _hold(line, held, push, k)
        if ticks[k]:
            values_at(true, times[k], space.values)
            command(law, times[k], states[k], space.values, space.inputs)
        for i in range(dynamics.k):
            forces[k, i] = forces[k + 1, i] = space.inputs[i]
            if not abs(space.inputs[i]) < STATE_LIMIT:
                return k, ending_of(limits, states[k])
        step = times[k + 1] - times[k]
        if holding:
            rk4_step(held_rates, plant, times[k], step, states[k], work, states[k + 1])
        else:
            rk4_step(loop_rates, followed, times[k], step, states[k], work, states[k + 1])
        if not within_limits(states[k + 1]):
            return k, ending_of(limits, states[k])
    return until, _RUNNING


def held_steps(scenario: Scenario, run: Trajectory) -> Floats:
    """Return where an RK4 step leads from each state of a run, the inputs as deployed."""
    step = run.provenance["settings"]["timestep"]
    steps = np.diff(run.time)
    steps[np.abs(steps - step) < 1e-9] = step
    loop, after = Loop(scenario), np.empty((len(steps), run.state.shape[1]))
    line = line_of(scenario.segments[0])
    values = scenario.values(0.5 * (run.time[:-1] + run.time[1:]))
    arrays = (values, held_disturbances(scenario, run.time).push, steps, work_space(after.shape[1]))
    with loop.watched():
        _held_steps(loop.dynamics, line, loop.space, run.state, run.inputs, *arrays, after)
    return after


@kernel
def _held_steps(dynamics, line, space, states, inputs, values, push, steps, work, after):
    for k in range(len(after)):
        _hold(line, values, push, k)
        for i in range(inputs.shape[1]):
            space.inputs[i] = inputs[k, i]
        plant = (dynamics, line, space)
        rk4_step(held_rates, plant, 0.0, steps[k], states[k], work, after[k])
