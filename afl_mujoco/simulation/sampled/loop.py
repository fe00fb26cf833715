"""The closed loop with the inputs held, compiled around MuJoCo's `mj_step`, for any plant.

`start`, `advance` to the next control tick, and the whole loop made of the two. Every sampled run
uses them: with ideal hardware or not, one run or thousands, in the dm_control environment and in
the maps of attraction.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.compiled import borrowing_kernel, inlined_kernel, load, store
from afl_mujoco.control.controller import compiled_force, force_from_inputs
from afl_mujoco.control.estimator import filtered_state
from afl_mujoco.control.estimator import start as begin_estimate
from afl_mujoco.control.estimator import update as update_estimate
from afl_mujoco.plants.library import (
    mj_forward,
    mj_mul_m,
    mj_reset_data,
    mj_solve_m,
    mj_step,
    write_row,
)
from afl_mujoco.plants.plant import Floats
from afl_mujoco.simulation.mujoco_model import (
    impulse_jump,
    rate_forces,
    read_numbers,
    read_state,
    write_numbers,
    write_state,
)
from afl_mujoco.simulation.sampled.hardware import RUNNING, actuate, sense, within_reach
from afl_mujoco.simulation.trajectory import (
    COMPLETED,
    FELL,
    OUTCOMES,
    STATE_LIMIT,
    Criterion,
    deviation,
    ending_of,
    within_limits,
)

_COMPLETED, _FELL = OUTCOMES.index(COMPLETED), OUTCOMES.index(FELL)


class Profile(NamedTuple):
    """What happens to the plant in each of K steps; the last applies from then on."""

    rows: Floats  # what is written into the model, shape (R, targets)
    which: NDArray[np.int64]  # the row of each step, shape (K,)
    push: Floats  # disturbing forces along coordinates [N, N m], shape (K, n)
    beside: Floats  # and beside the drives of inputs at sites, shape (K, k)
    impulse: Floats  # jumps of the momenta [N s, N m s], shape (K, n)
    # the share of the step after which its jump acts, 0 at its start; -1 for none, shape (K,)
    split: Floats
    struck: NDArray[np.int64]  # the row of the instant of the jump of each step, shape (K,)
    # first and past the last row of the events at the start of each step, of which each has a row
    # before it and one after, shape (K, 2)
    events: NDArray[np.int64]
    # how bodies move in their frames under each of the rows, for `rate_forces`, shape (R, bodies *
    # 15); none where no rate acts
    drift: Floats


class Plan(NamedTuple):
    """The numbers of a run."""

    steps: int  # physics steps of the run
    hold: int  # physics steps of a control period
    timestep: float  # physics step [s]
    last: float  # length of the last step [s], at most a physics step: it ends at the horizon
    criterion: Criterion  # when the run ends early


@inlined_kernel
def write_plant(at, profile, run, k, reached):
    """Write the parameters of step k to the model, after the events there if it is `reached`."""
    i = min(k, len(profile.which) - 1)
    row, (event, end) = profile.which[i], profile.events[i]
    if row == run.marks.written and event == end:
        return
    if reached:
        for before in range(event, end, 2):
            _keep_momenta(at, profile, run, before)
    write_row(at.structures, at.targets, profile.rows[row])
    run.marks.written = row


@borrowing_kernel
def _keep_momenta(at, profile, run, before):
    """Keep M v + N p' from the parameters and rates of a row to those of the next."""
    momenta = run.space.ctypes.data
    write_row(at.structures, at.targets, profile.rows[before])
    mj_forward(at.model, at.data)
    mj_mul_m(at.model, at.data, momenta, at.qvel)
    _carry(at, profile, run, before, -1.0)
    write_row(at.structures, at.targets, profile.rows[before + 1])
    _carry(at, profile, run, before + 1, 1.0)
    mj_forward(at.model, at.data)
    mj_solve_m(at.model, at.data, at.qvel, momenta, 1)


@borrowing_kernel
def _carry(at, profile, run, row, sign):
    """Add what the rates of a row carry, -N p', to the momenta in the work space, with a sign."""
    if len(profile.drift) == 0 or not profile.drift[row].any():
        return
    carried = run.space[at.k + 2 * at.n :][: at.n]
    _at_rest(at, run, profile.drift[row], carried)
    for j in range(at.n):
        run.space[j] += sign * carried[j]


@borrowing_kernel
def _at_rest(at, run, drift, out):
    """Write the impulses -N p' of rates on the plant at rest where it is."""
    state = run.space[at.k + 3 * at.n :]
    read_state(at, run.after)
    for j in range(at.n):
        state[j], state[at.n + j] = run.after[j], 0.0
    rate_forces(at, drift, state, True, out)
    write_state(at, run.after)


@borrowing_kernel
def apply_impulse(at, profile, run, k, inside):
    """Apply the impulse at the start of step k or inside it, with the parameters of its instant."""
    i = min(k, len(profile.which) - 1)
    split = profile.split[i]
    if split < 0.0 or (split > 0.0) != inside:
        return
    n, inputs, forces = at.n, run.space[: at.k], run.space[at.k :][: 2 * at.n]
    changing = profile.struck[i] != profile.which[i]
    if changing:
        write_row(at.structures, at.targets, profile.rows[profile.struck[i]])
    read_numbers(at.ctrl, inputs)
    read_numbers(at.applied, forces[:n])
    # mj_forward under the impulse minus mj_forward without it: M^-1 times the momenta
    impulse_jump(at, profile.impulse[i], forces[n:])
    write_numbers(at.ctrl, inputs)
    write_numbers(at.applied, forces[:n])
    for j in range(n):
        store(at.qvel + 8 * j, load(at.qvel + 8 * j) + forces[n + j])
    if changing:
        write_row(at.structures, at.targets, profile.rows[profile.which[i]])


@inlined_kernel
def _enter(at, plan, profile, run, record, k):
    """Reach instant k: end the run there or continue it; record state, inputs and commands."""
    criterion, state, marks, n = plan.criterion, run.after, run.marks, at.n
    read_state(at, state)
    marks.step = k
    fallen = False
    for i in range(n):
        away = abs(deviation(state[i], criterion.target[i], criterion.wraps[i]))
        run.peak[i] = max(run.peak[i], away)
        fallen = fallen or away >= criterion.ends[i]
    if fallen:
        marks.status = _FELL
    elif k == plan.steps:
        marks.status = _COMPLETED
    else:
        write_plant(at, profile, run, k, True)
        apply_impulse(at, profile, run, k, False)
    if len(record) > 0:
        read_state(at, record[k])
        for i in range(at.k):
            drive = run.drive[i]
            record[k, 2 * n + i], record[k, 2 * n + at.k + i] = drive.force, drive.asked


@inlined_kernel
def start(at, plan, profile, run, record, initial_state):
    """Put the plant at the start; `record` takes (N + 1, 2 n + 2 k) numbers, or none."""
    mj_reset_data(at.model, at.data)
    store(at.timestep, plan.timestep)
    write_state(at, initial_state)
    _enter(at, plan, profile, run, record, 0)


@inlined_kernel
def _step(at, plan, profile, run, k, length):
    """Take step k, cut in two where an impulse acts inside it."""
    share = profile.split[min(k, len(profile.split) - 1)]
    if share > 0.0:  # both parts have the parameters of the middle of the whole step
        store(at.timestep, share * plan.timestep * length)
        mj_step(at.model, at.data)
        apply_impulse(at, profile, run, k, True)
    if share > 0.0 or length < 1.0:
        store(at.timestep, (1.0 - max(share, 0.0)) * plan.timestep * length)
    mj_step(at.model, at.data)
    if share > 0.0 or length < 1.0:
        store(at.timestep, plan.timestep)


@inlined_kernel
def _take(at, plan, actuator, run, record):
    """Take the commands of a tick; return whether the run goes on under them."""
    marks = run.marks
    for i in range(at.k):
        drive, command = run.drive[i], run.command[i]
        drive.asked, drive.max_command = command, max(drive.max_command, abs(command))
        # of what was asked, before it is cut off
        drive.beyond = command >= actuator[i].high or command <= actuator[i].low
        run.command[i] = drive.command = within_reach(actuator[i], command)
        drive.mean_force = 0.0
    for i in range(at.k):
        if not abs(run.command[i]) < STATE_LIMIT:
            read_state(at, run.after)
            marks.status = ending_of(plan.criterion, run.after)
            if len(record) > 0:
                for j in range(at.k):
                    record[marks.step, 2 * at.n + at.k + j] = run.command[j]
            return False
    return True


@inlined_kernel
def _drive(at, plan, actuator, profile, run, pending, record, k, length):
    """Set what acts on the plant over step k."""
    for i in range(at.k):
        drive = run.drive[i]
        force = actuate(actuator[i], drive, pending, i, run.command[i], k, length)
        if drive.beyond:
            drive.limited += length
        if len(record) > 0:
            record[k, 2 * at.n + i], record[k, 2 * at.n + at.k + i] = drive.onset, drive.asked
        drive.mean_force += force / plan.hold  # what an estimator with a force sensor sees
        store(at.ctrl + 8 * i, force)
    row = min(k, len(profile.push) - 1)
    for i in range(at.k):
        if profile.beside[row, i] != 0.0:
            store(at.ctrl + 8 * i, load(at.ctrl + 8 * i) + profile.beside[row, i])
    write_numbers(at.applied, profile.push[row])
    if len(profile.drift) > 0:
        _drift(at, profile, run, row, 0.5 * plan.timestep * length)


@borrowing_kernel
def _drift(at, profile, run, row, half):
    """Add the forces of rates, as they are half a step on, held over the step like the others."""
    drift, n = profile.drift[profile.which[row]], at.n
    if not drift.any():
        return
    state, force = run.space[at.k + 3 * n :], run.space[at.k + 2 * n :][:n]
    push = run.space[at.k :][:n]
    read_numbers(at.applied, push)
    read_state(at, run.before)
    read_state(at, state)
    for part in range(2):  # at the start, which says where half a step on is; then there
        rate_forces(at, drift, state, False, force)
        write_state(at, run.before)
        for j in range(n):
            store(at.applied + 8 * j, push[j] + force[j])
        if part == 0:
            mj_forward(at.model, at.data)
            for j in range(n):
                state[j] = run.before[j] + half * run.before[n + j]
                state[n + j] = run.before[n + j] + half * load(at.qacc + 8 * j)


@inlined_kernel
def advance(at, plan, actuator, profile, run, pending, record):
    """Go on to the next control tick, or the end: a command without limit may be the end."""
    first, criterion, marks = run.marks.step, plan.criterion, run.marks
    if not _take(at, plan, actuator, run, record):
        return
    for k in range(first, min(first + plan.hold, plan.steps)):
        length = 1.0  # of this step, in steps: only the last may be shorter
        if k == plan.steps - 1 and plan.last < plan.timestep:
            length = plan.last / plan.timestep
        _drive(at, plan, actuator, profile, run, pending, record, k, length)
        read_state(at, run.before)
        _step(at, plan, profile, run, k, length)
        read_state(at, run.after)
        if not within_limits(run.after):
            marks.status = ending_of(criterion, run.before)
            return
        _enter(at, plan, profile, run, record, k + 1)
        if marks.status != RUNNING:
            return


@borrowing_kernel
def run_to_end(
    at, plan, profile, run, pending, record, initial_state, sensors, actuator, kind, inputs
):
    """Run the closed loop with a compiled controller."""
    start(at, plan, profile, run, record, initial_state)
    tick = 0
    while run.marks.status == RUNNING:
        sense(at, sensors, run, tick)
        force_from_inputs(kind, run.measured, inputs[min(tick, len(inputs) - 1)], run.command)
        advance(at, plan, actuator, profile, run, pending, record)
        tick += 1


@borrowing_kernel
def run_estimating(
    at, plan, profile, run, pending, record, initial_state, sensors, actuator, estimator
):
    """Run the cart-pole with M, l and state estimated; `estimates` takes M, l of each tick."""
    (kind, table, masses, lengths, home), filter_, settings, estimates = estimator
    start(at, plan, profile, run, record, initial_state)
    tick = 0
    while run.marks.status == RUNNING:
        sense(at, sensors, run, tick)
        z, phi, drive = run.measured[0], run.measured[1], run.drive[0]
        # the estimate of this tick uses the force since the last: no algebraic loop
        if tick == 0:
            mass, length = begin_estimate(filter_, settings, z, phi)
        else:
            force = drive.mean_force if settings.force_sensed else drive.command
            mass, length = update_estimate(filter_, settings, z, phi, force, sensors.period)
        z, phi, z_dot, phi_dot = filtered_state(filter_)
        if tick < len(estimates):
            estimates[tick, 0], estimates[tick, 1] = mass, length
        assumed = (mass, settings.pole_mass, length, settings.gravity)
        run.command[0] = compiled_force(
            kind, table, masses, lengths, home, z, phi, z_dot, phi_dot, assumed
        )
        advance(at, plan, actuator, profile, run, pending, record)
        tick += 1
