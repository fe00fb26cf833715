"""The closed loop with the force held, compiled around MuJoCo's `mj_step`.

`start`, `advance` to the next control tick, and the whole loop made of the two. Every sampled run
uses them: with ideal hardware or not, one run or thousands, in the dm_control environment and in
the maps of attraction.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from afl_mujoco.compiled import borrowing_kernel, load, store
from afl_mujoco.control.controller import compiled_force, force_from_inputs
from afl_mujoco.control.estimator import filtered_state
from afl_mujoco.control.estimator import start as begin_estimate
from afl_mujoco.control.estimator import update as update_estimate
from afl_mujoco.scenario.requirements import BANDS
from afl_mujoco.simulation.mujoco_model import (
    impulse_jump,
    mj_reset_data,
    mj_step,
    read_state,
    write_parameters,
    write_state,
)
from afl_mujoco.simulation.sampled.hardware import RUNNING, actuate, sense, within_reach
from afl_mujoco.simulation.trajectory import (
    COMPLETED,
    FALL_ANGLE,
    FELL,
    OUTCOMES,
    STATE_LIMIT,
    ending_of,
    within_limits,
)

BAND_Z, BAND_PHI = BANDS["z"], BANDS["phi"]
"""A run is settled while ``|z|`` and ``|phi|`` stay within these [m, rad]."""

SETTLED = len(OUTCOMES)
"""The status of a run that ended early, settled for the dwell of its criterion."""

PROFILE = np.dtype(
    [(name, np.float64) for name in ("cart_mass", "half_length", "push", "impulse", "split")]
)
"""What happens to the plant in a step: M [kg], l [m], disturbing force [N], and a jump of the
momentum along z [N s] with the share of the step after which it acts. The last row of a profile
applies from then on."""

_COMPLETED, _FELL = OUTCOMES.index(COMPLETED), OUTCOMES.index(FELL)


class Criterion(NamedTuple):
    """When a run ends before its horizon, and when it counts as settled."""

    fall_angle: float = FALL_ANGLE  # the run ends as fallen when ``|phi|`` reaches this [rad]
    z: float = BAND_Z  # half-widths of the bands within which a run is settled [m, rad, m/s, rad/s]
    phi: float = BAND_PHI
    z_dot: float = math.inf
    phi_dot: float = math.inf
    dwell: int = 0  # the run ends as settled after this many steps within the bands; 0 for never


class Plan(NamedTuple):
    """The numbers of a run."""

    steps: int  # physics steps of the run
    hold: int  # physics steps of a control period
    timestep: float  # physics step [s]
    last: float  # length of the last step [s], at most a physics step: it ends at the horizon
    pole_mass: float  # m [kg] and g [m/s^2]
    gravity: float
    rail: float = math.inf  # largest displacement of the cart to either side [m]
    criterion: Criterion = Criterion()  # when the run ends early


@borrowing_kernel
def write_plant(at, plan, profile, run, k):
    """Write the parameters of step k to the model, unless it has them."""
    i = min(k, len(profile) - 1)
    mass, length = profile[i].cart_mass, profile[i].half_length
    if not (mass == run.written_mass and length == run.written_length):
        write_parameters(at, mass, plan.pole_mass, length, plan.gravity)
        run.written_mass, run.written_length = mass, length


@borrowing_kernel
def apply_impulse(at, profile, k, inside):
    """Apply the impulse at the start of step k or inside it, with the parameters in the model."""
    row = profile[min(k, len(profile) - 1)]
    impulse = row.impulse
    if impulse != 0.0 and (row.split > 0.0) == inside:
        z, phi, z_dot, phi_dot = read_state(at)
        force, push = load(at.control), load(at.push)
        # mj_forward under the impulse minus mj_forward without it: M^-1 times the momentum
        jump = impulse_jump(at, z, phi, z_dot, phi_dot, impulse)
        store(at.control, force)
        store(at.push, push)
        write_state(at, z, phi, z_dot + jump[0], phi_dot + jump[1])


@borrowing_kernel
def _settled(criterion, state):
    """Return whether the state is within the bands."""
    return (
        abs(state[0]) <= criterion.z
        and abs(state[1]) <= criterion.phi
        and abs(state[2]) <= criterion.z_dot
        and abs(state[3]) <= criterion.phi_dot
    )


@borrowing_kernel
def _enter(at, plan, profile, run, record, k):
    """Reach instant k: end the run there or continue it; record state, force and command."""
    state, criterion = read_state(at), plan.criterion
    z, phi = abs(state[0]), abs(state[1])
    run.step = k
    run.peak_z, run.peak_phi = max(run.peak_z, z), max(run.peak_phi, phi)
    if not _settled(criterion, state):
        run.unsettled = k + 1
    if z >= plan.rail and run.at_stop < 0:
        run.at_stop = k
    if phi >= criterion.fall_angle:
        run.status = _FELL
    elif criterion.dwell > 0 and k - run.unsettled >= criterion.dwell:
        run.status = SETTLED
    elif k == plan.steps:
        run.status = _COMPLETED
    else:
        write_plant(at, plan, profile, run, k)
        apply_impulse(at, profile, k, False)
    if len(record) > 0:
        row = record[k]
        row[0], row[1], row[2], row[3] = read_state(at)
        row[4], row[5] = run.force, run.asked


@borrowing_kernel
def start(at, plan, profile, run, record, initial_state):
    """Put the plant at the start of its run.

    record: Takes the columns of `RECORD` at each instant, shape (N + 1, 6), or (0, 6) for no
        record.
    initial_state: (z, phi, z_dot, phi_dot), shape (4,).
    """
    x = initial_state
    mj_reset_data(at.model, at.data)
    store(at.timestep, plan.timestep)
    write_state(at, x[0], x[1], x[2], x[3])
    _enter(at, plan, profile, run, record, 0)


@borrowing_kernel
def _step(at, plan, profile, k, length):
    """Take step k, cut in two where an impulse acts inside it."""
    share = profile[min(k, len(profile) - 1)].split
    if share > 0.0:  # both parts have the parameters of the middle of the whole step
        store(at.timestep, share * plan.timestep * length)
        mj_step(at.model, at.data)
        apply_impulse(at, profile, k, True)
    if share > 0.0 or length < 1.0:
        store(at.timestep, (1.0 - share) * plan.timestep * length)
    mj_step(at.model, at.data)
    if share > 0.0 or length < 1.0:
        store(at.timestep, plan.timestep)


@borrowing_kernel
def advance(at, plan, actuator, profile, run, pending, record, command):
    """Continue to the next control tick, or to the end of the run.

    command: Force that the controller commands [N]; NaN ends the run, and so does a force beyond
        `STATE_LIMIT` that no limit of the drive cuts off.
    """
    first = run.step
    run.asked, run.max_command = command, max(run.max_command, abs(command))
    beyond = abs(command) >= actuator.limit  # of what was asked, before it is cut off
    command = within_reach(actuator, command)
    before = read_state(at)
    if not abs(command) < STATE_LIMIT:
        run.status = ending_of(before)
        if len(record) > 0:
            record[first, 5] = command
        return
    run.command, run.mean_force = command, 0.0
    for k in range(first, min(first + plan.hold, plan.steps)):
        length = 1.0  # of this step, in steps: only the last may be shorter
        if k == plan.steps - 1 and plan.last < plan.timestep:
            length = plan.last / plan.timestep
        half = 0.5 * plan.timestep * length
        force = actuate(actuator, run, pending, command, k, length)
        if beyond:
            run.limited += length
        if len(record) > 0:
            record[k, 4], record[k, 5] = run.onset, run.asked
        before = read_state(at)
        store(at.control, force)
        store(at.push, profile[min(k, len(profile) - 1)].push)
        _step(at, plan, profile, k, length)
        after = read_state(at)
        if not within_limits(after):
            run.status = ending_of(before)
            return
        run.mean_force += force / plan.hold  # what an estimator with a force sensor sees
        # trapezoidal rule, as of the metrics of a recorded run
        run.iae_z += half * (abs(before[0]) + abs(after[0]))
        run.iae_phi += half * (abs(before[1]) + abs(after[1]))
        _enter(at, plan, profile, run, record, k + 1)
        if run.status != RUNNING:
            return


@borrowing_kernel
def run_to_end(
    at, plan, profile, run, pending, record, initial_state, sensors, actuator, kind, inputs
):
    """Run the closed loop with a compiled controller from start to end."""
    start(at, plan, profile, run, record, initial_state)
    tick = 0
    while run.status == RUNNING:
        measured = sense(at, sensors, run, tick)
        command = force_from_inputs(kind, measured, inputs[min(tick, len(inputs) - 1)])
        advance(at, plan, actuator, profile, run, pending, record, command)
        tick += 1


@borrowing_kernel
def run_estimating(
    at,
    plan,
    profile,
    run,
    pending,
    record,
    initial_state,
    sensors,
    actuator,
    compiled,
    filter_,
    settings,
    estimates,
):
    """Run the closed loop with a controller whose M, l and state are estimated.

    estimates: Takes the estimated M [kg] and l [m] at each control tick, shape (T, 2), or (0, 2).
    """
    kind, table, masses, lengths = compiled
    start(at, plan, profile, run, record, initial_state)
    tick = 0
    while run.status == RUNNING:
        z, phi, _, _ = sense(at, sensors, run, tick)
        # the estimate of this tick uses the force since the last: no algebraic loop
        if tick == 0:
            mass, length = begin_estimate(filter_, settings, z, phi)
        else:
            force = run.mean_force if settings.force_sensed else run.command
            mass, length = update_estimate(filter_, settings, z, phi, force, sensors.period)
        z, phi, z_dot, phi_dot = filtered_state(filter_)
        if tick < len(estimates):
            estimates[tick, 0], estimates[tick, 1] = mass, length
        assumed = (mass, settings.pole_mass, length, settings.gravity)
        command = compiled_force(kind, table, masses, lengths, z, phi, z_dot, phi_dot, assumed)
        advance(at, plan, actuator, profile, run, pending, record, command)
        tick += 1
