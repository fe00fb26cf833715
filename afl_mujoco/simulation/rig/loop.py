"""The compiled loop of a rig: sense, command, advance to the next control tick."""

from __future__ import annotations

from typing import NamedTuple

from afl_mujoco.compiled import borrowing_kernel, load, store
from afl_mujoco.control.compiled_law import given_force, law_force
from afl_mujoco.control.estimation.estimator import filtered_state
from afl_mujoco.control.estimation.estimator import start as begin_estimate
from afl_mujoco.control.estimation.estimator import update as update_estimate
from afl_mujoco.control.estimation.settings import FORCE_SENSED, GRAVITY, POLE_MASS
from afl_mujoco.simulation.mujoco_model import (
    CONTROL,
    DATA,
    MODEL,
    PHI,
    PHI_DOT,
    PUSH,
    Z_DOT,
    Z,
    mj_reset_data,
    mj_step,
    strike,
    write_parameters,
    write_state,
)
from afl_mujoco.simulation.rig.channels import (
    AT_STOP,
    CART_MASS,
    COMMAND,
    HALF_LENGTH,
    IAE_PHI,
    IAE_Z,
    MAX_FORCE,
    MEAN_FORCE,
    PEAK_PHI,
    PEAK_Z,
    RUNNING,
    STATUS,
    STEP,
    UNSETTLED,
    actuate,
    sense,
    within_reach,
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

BAND_Z, BAND_PHI = 0.05, 0.02
"""A run is settled while ``|z|`` and ``|phi|`` stay within these [m, rad]."""

COURSE_MASS, COURSE_LENGTH, COURSE_PUSH, COURSE_IMPULSE = range(4)
"""Columns of a course: M [kg], l [m], disturbing force [N] in each step, jump of the momentum along
z [N s] at its start. The last row stays in force until the run ends."""

_COMPLETED, _FELL = OUTCOMES.index(COMPLETED), OUTCOMES.index(FELL)


class Plan(NamedTuple):
    """The numbers of a run.

    Attributes
    ----------
    steps
        Physics steps of the run.
    hold
        Physics steps of a control period.
    timestep
        Physics step [s].
    pole_mass, gravity
        m [kg] and g [m/s^2].
    rail
        The cart's travel to either side [m].
    """

    steps: int
    hold: int
    timestep: float
    pole_mass: float
    gravity: float
    rail: float


@borrowing_kernel
def _read(at):
    """Return the state in MjData."""
    return load(at[Z]), load(at[PHI]), load(at[Z_DOT]), load(at[PHI_DOT])


@borrowing_kernel
def _arrive(at, plan, course, memory, k):
    """Let happen what happens to the plant at the start of step k."""
    i = min(k, len(course) - 1)
    mass, length, impulse = (
        course[i, COURSE_MASS],
        course[i, COURSE_LENGTH],
        course[i, COURSE_IMPULSE],
    )
    if not (mass == memory[CART_MASS] and length == memory[HALF_LENGTH]):
        write_parameters(at, mass, plan.pole_mass, length, plan.gravity)
        memory[CART_MASS], memory[HALF_LENGTH] = mass, length
    if impulse != 0.0:
        z, phi, z_dot, phi_dot = _read(at)
        jump = strike(at, z, phi, z_dot, phi_dot, impulse)
        write_state(at, z, phi, z_dot + jump[0], phi_dot + jump[1])


@borrowing_kernel
def _enter(at, plan, course, memory, record, k, force):
    """Reach instant k: end the run there, or let it go on; record state and force."""
    z, phi = abs(load(at[Z])), abs(load(at[PHI]))
    memory[STEP] = k
    memory[PEAK_Z], memory[PEAK_PHI] = max(memory[PEAK_Z], z), max(memory[PEAK_PHI], phi)
    if z > BAND_Z or phi > BAND_PHI:
        memory[UNSETTLED] = k + 1
    if z >= plan.rail and memory[AT_STOP] < 0.0:
        memory[AT_STOP] = k
    if phi >= FALL_ANGLE:
        memory[STATUS] = _FELL
    elif k == plan.steps:
        memory[STATUS] = _COMPLETED
    else:
        _arrive(at, plan, course, memory, k)
    if len(record) > 0:
        row = record[k]
        row[0], row[1], row[2], row[3] = _read(at)
        row[4] = force


@borrowing_kernel
def start(at, plan, course, memory, record, initial_state):
    """Put the plant at the start of its run.

    Parameters
    ----------
    at
        `CartPoleModel.addresses`.
    plan
        A `Plan`.
    course
        What happens to the plant, columns as of `COURSE_MASS` and so on, shape (K, 4).
    memory
        From `blank_memory`.
    record
        Takes state and force from each instant on, shape (N + 1, 5), or (0, 5) for no record.
    initial_state
        (z, phi, z_dot, phi_dot), shape (4,).
    """
    x = initial_state
    mj_reset_data(at[MODEL], at[DATA])
    write_state(at, x[0], x[1], x[2], x[3])
    _enter(at, plan, course, memory, record, 0, 0.0)


@borrowing_kernel
def advance(at, plan, actuator, course, memory, record, command):
    """Go on to the next control tick, or to where the run ends.

    Parameters
    ----------
    at, plan, course, memory, record
        As of `start`.
    actuator
        An `Actuator`.
    command
        What the law commands [N]; NaN, or a force beyond all bounds that no limit of the drive
        cuts off, ends the run.
    """
    first, half = int(memory[STEP]), 0.5 * plan.timestep
    command = within_reach(actuator, command)
    if not abs(command) < STATE_LIMIT:
        memory[STATUS] = ending_of(_read(at))
        if len(record) > 0:
            record[first, 4] = command
        return
    memory[COMMAND], memory[MEAN_FORCE] = command, 0.0
    for k in range(first, min(first + plan.hold, plan.steps)):
        force = actuate(actuator, memory, command, k)
        if len(record) > 0:
            record[k, 4] = force
        before = _read(at)
        store(at[CONTROL], force)
        store(at[PUSH], course[min(k, len(course) - 1), COURSE_PUSH])
        mj_step(at[MODEL], at[DATA])
        after = _read(at)
        if not within_limits(after):
            memory[STATUS] = ending_of(before)
            return
        memory[MEAN_FORCE] += force / plan.hold
        memory[MAX_FORCE] = max(memory[MAX_FORCE], abs(force))
        memory[IAE_Z] += half * (abs(before[0]) + abs(after[0]))
        memory[IAE_PHI] += half * (abs(before[1]) + abs(after[1]))
        _enter(at, plan, course, memory, record, k + 1, force)
        if memory[STATUS] != RUNNING:
            return


@borrowing_kernel
def commanded(kind, given, measured, tick):
    """Return what the law commands [N].

    Parameters
    ----------
    kind
        Of the law, as of `CompiledLaw`.
    given
        What it is given at each tick, as of `Law.law_inputs`; the last row stays in force.
    measured
        From `sense`.
    tick
        Number of the control tick.
    """
    return given_force(kind, measured, given[min(tick, len(given) - 1)])


@borrowing_kernel
def march(at, plan, course, memory, record, initial_state, sensors, actuator, kind, given):
    """Run the closed loop from start to end.

    Parameters
    ----------
    at, plan, course, memory, record, initial_state
        As of `start`.
    sensors, actuator
        A `Sensors` and an `Actuator`.
    kind, given
        As of `commanded`.
    """
    start(at, plan, course, memory, record, initial_state)
    tick = 0
    while memory[STATUS] == RUNNING:
        measured = sense(at, sensors, memory, tick)
        command = commanded(kind, given, measured, tick)
        advance(at, plan, actuator, course, memory, record, command)
        tick += 1


@borrowing_kernel
def march_estimating(
    at,
    plan,
    course,
    memory,
    record,
    initial_state,
    sensors,
    actuator,
    law,
    filter_memory,
    settings,
    beliefs,
):
    """Run the closed loop with a law that an estimator tells M, l and the state.

    Parameters
    ----------
    at, plan, course, memory, record, initial_state, sensors, actuator
        As of `march`; the estimator gets the measured positions, and the force that was commanded
        over each control period, cut off at the limit; if its settings say that the drive reports
        the force, the mean of what it exerted.
    law
        A `CompiledLaw`.
    filter_memory, settings
        Of the estimator, as of `estimator.start`.
    beliefs
        Takes the M [kg] and l [m] that are believed at each control tick, shape (T, 2), or (0, 2).
    """
    kind, table, masses, lengths = law
    start(at, plan, course, memory, record, initial_state)
    tick = 0
    while memory[STATUS] == RUNNING:
        z, phi, _, _ = sense(at, sensors, memory, tick)
        if tick == 0:
            mass, length = begin_estimate(filter_memory, settings, z, phi)
        else:
            force = memory[MEAN_FORCE] if settings[FORCE_SENSED] else memory[COMMAND]
            mass, length = update_estimate(filter_memory, settings, z, phi, force, sensors.period)
        z, phi, z_dot, phi_dot = filtered_state(filter_memory)
        if tick < len(beliefs):
            beliefs[tick, 0], beliefs[tick, 1] = mass, length
        believed = (mass, settings[POLE_MASS], length, settings[GRAVITY])
        command = law_force(kind, table, masses, lengths, z, phi, z_dot, phi_dot, believed)
        advance(at, plan, actuator, course, memory, record, command)
        tick += 1
