"""Sensors and drive of the sampled loop, and their noise."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from afl_mujoco.compiled import borrowing_kernel, kernel
from afl_mujoco.scenario.imperfections import Imperfections
from afl_mujoco.scenario.parameters import COORDINATES, STATE
from afl_mujoco.scenario.sampling import SNAP
from afl_mujoco.simulation.mujoco_model import read_state

_ROUNDS = 10
_M0, _M1 = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_W0, _W1 = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)
_LOW, _WORD = np.uint64(0xFFFFFFFF), np.uint64(32)
_UNIT = 2.0**-32


@register_jitable
def _philox(c0, c1, c2, c3, k0, k1):
    """Return four words of 32 bits for a counter of four and a key of two, all as uint64."""
    for _ in range(_ROUNDS):
        p0, p1 = _M0 * c0, _M1 * c2
        c0, c1, c2, c3 = (p1 >> _WORD) ^ c1 ^ k0, p1 & _LOW, (p0 >> _WORD) ^ c3 ^ k1, p0 & _LOW
        k0, k1 = (k0 + _W0) & _LOW, (k1 + _W1) & _LOW
    return c0, c1, c2, c3


@kernel
def random_words(counter, key):
    """Return the block of Philox4x32-10, four words.

    counter, key: Words of 32 bits as uint64, shape (4,) and (2,).
    """
    return _philox(counter[0], counter[1], counter[2], counter[3], key[0], key[1])


@register_jitable
def _pair(first, second):
    """Return two independent standard normal numbers from two words, by Box and Muller."""
    radius = math.sqrt(-2.0 * math.log((float(first) + 0.5) * _UNIT))
    angle = 2.0 * math.pi * ((float(second) + 0.5) * _UNIT)
    return radius * math.cos(angle), radius * math.sin(angle)


@kernel
def normals(seed, tick):
    """Return four independent standard normal numbers."""
    s, t, zero = np.uint64(seed), np.uint64(tick), np.uint64(0)
    a, b, c, d = _philox(t & _LOW, t >> _WORD, zero, zero, s & _LOW, s >> _WORD)
    n0, n1 = _pair(a, b)
    n2, n3 = _pair(c, d)
    return n0, n1, n2, n3


RUN = np.dtype(
    [
        *(("written_mass", np.float64), ("written_length", np.float64)),
        *((f"seen_{name}", np.float64) for name in ("z", "phi", "z_dot", "phi_dot")),
        *((name, np.float64) for name in ("demand", "force", "onset", "asked", "command")),
        *((name, np.float64) for name in ("mean_force", "max_command", "limited")),
        *((name, np.float64) for name in ("force_squared", "force_variation")),
        *(("status", np.int64), ("step", np.int64)),
        *((name, np.float64) for name in ("peak_z", "peak_phi", "max_force", "iae_z", "iae_phi")),
        *(("unsettled", np.int64), ("at_stop", np.int64)),
    ]
)
"""The state of a run, kept from step to step.

``written_mass``, ``written_length``: M [kg] and l [m] in the model. ``seen_...``: the last
measurement. ``demand``, ``force``: the force that the drive aims at and the force that it exerts
[N]. ``onset``: the force that it exerted at the start of the last step [N]. ``asked``,
``command``, ``mean_force``: what the controller asked for at the last tick, the same within the
drive's limit, and the mean force exerted since then [N]. ``max_command``: the largest of what was
asked for [N]. ``limited``: how long it was at the limit or beyond [step]. ``force_squared``,
``force_variation``: of the exerted force, the integral of its square [N^2 step] and its total
variation [N], exact for its course within the steps. ``status``: `RUNNING`, `SETTLED` or an index
into `OUTCOMES`. ``step``: the step that the run has reached. Peaks and integrals: up to that step.
``unsettled``: the first step from which the state has stayed within the bands. ``at_stop``: the
step at which the cart reached an end stop, -1 if it never did.
"""

RUNNING = -1
"""The status of a run that has not ended."""

RECORD = ("z", "phi", "z_dot", "phi_dot", "force", "command")
"""Columns of a record: the state at an instant, the force from then on, and the command [N]."""


class Sensors(NamedTuple):
    """How the state is measured."""

    noisy: bool  # whether any noise is added
    noise_z: float  # standard deviations [m, rad, m/s, rad/s]
    noise_phi: float
    noise_z_dot: float
    noise_phi_dot: float
    step_z: float  # resolutions [m, rad]
    step_phi: float
    differentiated: bool  # whether velocities are differences of positions
    period: float  # control period [s]
    # share of the gap to the measured velocity that the filtered velocity closes in a period, 1
    # without a filter [1]
    filter_share: float
    seed: int  # seed of the noise


class Actuator(NamedTuple):
    """How a command becomes the force on the cart."""

    limit: float  # largest force [N]
    slew: float  # largest rate of the force [N/step]
    late: int  # whole physics steps of the transport delay
    later_share: float  # rest of the transport delay [step]
    lag: float  # time constant of the first-order lag [step]


def sensors_of(imperfections: Imperfections, period: float) -> Sensors:
    """Return how the hardware measures.

    period: Control period [s].
    """
    r = imperfections
    return Sensors(
        noisy=r.noisy,
        **{f"noise_{name}": r.at(f"noise.{name}") for name in STATE},
        **{f"step_{name}": r.at(f"encoder_step.{name}") for name in COORDINATES},
        differentiated=r.differentiated,
        period=period,
        filter_share=1.0 if r.velocity_filter == 0.0 else -math.expm1(-period / r.velocity_filter),
        seed=r.seed,
    )


def actuator_of(imperfections: Imperfections, timestep: float, steps: int) -> Actuator:
    """Return how the hardware acts.

    timestep: Physics step [s].
    """
    r = imperfections
    delay = min(r.delay / timestep, steps + 1.0)
    late = math.floor(delay + SNAP)
    return Actuator(
        limit=math.inf if r.input_limit is None else r.input_limit,
        slew=math.inf if r.slew_rate is None else r.slew_rate * timestep,
        late=late,
        later_share=delay - late if delay - late > SNAP else 0.0,
        lag=r.lag / timestep,
    )


def new_run() -> Any:
    """Return the state of a run that has not begun: no force, no measurement, nothing written."""
    run = np.zeros(1, RUN)
    run["written_mass"], run["status"], run["at_stop"] = np.nan, RUNNING, -1
    return run[0]


def no_commands(actuator: Actuator) -> NDArray[np.float64]:
    """Return a buffer, all zero, for the commands [N] that the transport delay can hold."""
    return np.zeros(actuator.late + 2)


@borrowing_kernel
def sense(at, sensors, run, tick):
    """Return (z, phi, z_dot, phi_dot) as the controller gets them."""
    z, phi, z_dot, phi_dot = read_state(at)
    if sensors.noisy:
        n = normals(sensors.seed, tick)
        z, phi = z + sensors.noise_z * n[0], phi + sensors.noise_phi * n[1]
        z_dot += sensors.noise_z_dot * n[2]
        phi_dot += sensors.noise_phi_dot * n[3]
    # noise first: an encoder counts the noisy position
    if sensors.step_z > 0.0:
        z = sensors.step_z * np.rint(z / sensors.step_z)
    if sensors.step_phi > 0.0:
        phi = sensors.step_phi * np.rint(phi / sensors.step_phi)
    if sensors.differentiated:
        z_dot = (z - run.seen_z) / sensors.period if tick > 0 else 0.0
        phi_dot = (phi - run.seen_phi) / sensors.period if tick > 0 else 0.0
        run.seen_z, run.seen_phi = z, phi
    if sensors.filter_share < 1.0:
        if tick > 0:
            z_dot = run.seen_z_dot + sensors.filter_share * (z_dot - run.seen_z_dot)
            phi_dot = run.seen_phi_dot + sensors.filter_share * (phi_dot - run.seen_phi_dot)
        run.seen_z_dot, run.seen_phi_dot = z_dot, phi_dot
    return z, phi, z_dot, phi_dot


@borrowing_kernel
def within_reach(actuator, command):
    """Return a command cut off at the force limit; NaN stays NaN."""
    if command > actuator.limit:
        return actuator.limit
    if command < -actuator.limit:
        return -actuator.limit
    return command


@borrowing_kernel
def _reach(run, force):
    """Let the exerted force change to a value, with none beyond the two in between."""
    run.force_variation += abs(force - run.force)
    run.max_force = max(run.max_force, abs(force))
    run.force = force


@borrowing_kernel
def _follow(run, start, rate, length, lag):
    """Return the integral of the force, lagging a demand that changes at a constant rate.

    In steps and newtons: the demand goes from `start` at `rate` for `length`. With an excess E of
    the force over the demand, delayed by the lag T, the force is
    ``start + rate (t - T) + E exp(-t / T)``, from which the integral of its square follows too.
    """
    if length <= 0.0:
        return 0.0
    if lag == 0.0:
        end = start + rate * length
        _reach(run, start)
        _reach(run, end)
        run.force_squared += length * (start * start + start * end + end * end) / 3.0
        return (start + 0.5 * rate * length) * length
    # T F' + F = demand, whose solution for a ramp is in the docstring
    excess = run.force - start + rate * lag
    lost = -math.expm1(-length / lag)
    kept = 1.0 - lost
    if excess * rate > 0.0 and abs(rate) * lag < abs(excess):
        turn = -lag * math.log(rate * lag / excess)  # where force and demand meet, at rest
        if turn < length:
            _reach(run, start + rate * turn)
    _reach(run, start + rate * (length - lag) + excess * kept)
    base = start - rate * lag
    run.force_squared += (
        length * (base * base + rate * length * (base + rate * length / 3.0))
        + 2.0 * excess * lag * (base * lost + rate * (lag * lost - length * kept))
        + 0.5 * excess * excess * lag * lost * (1.0 + kept)
    )
    return (start + rate * (0.5 * length - lag)) * length + excess * lag * lost


@borrowing_kernel
def _obey(actuator, run, command, length):
    """Return the integral of the force while a command holds for a length, one step at most."""
    demand, ramp = run.demand, 0.0
    run.demand = command
    integral = 0.0
    if command != demand and actuator.slew < np.inf:
        rate = math.copysign(actuator.slew, command - demand)
        ramp = min((command - demand) / rate, length)
        integral = _follow(run, demand, rate, ramp, actuator.lag)
        if ramp == length:  # the ramp goes on in the next step
            run.demand = demand + rate * length
    return integral + _follow(run, command, 0.0, length - ramp, actuator.lag)


@borrowing_kernel
def actuate(actuator, run, pending, command, k, length):
    """Return the mean force on the cart over a physics step.

    Delay, slew limit and lag act continuously in time, one after the other, on a command that is
    held; a step gets the exact mean over the step, so that it delivers the right momentum with any
    of MuJoCo's integrators. The run notes the force itself, which the mean would understate.

    command: The command now, from `within_reach` [N].
    length: Length of the step [step], at most 1.
    """
    before, share = command, min(actuator.later_share, length)
    if actuator.late > 0 or share > 0.0:  # a ring of past commands, one a step
        size = len(pending)
        pending[k % size] = command
        command = pending[(k - actuator.late) % size]
        before = pending[(k - actuator.late - 1) % size]
    if actuator.lag == 0.0 and actuator.slew == np.inf:
        run.onset = before if share > 0.0 else command
        _follow(run, before, 0.0, share, 0.0)
        _follow(run, command, 0.0, length - share, 0.0)
        return command if share == 0.0 else command + share / length * (before - command)
    run.onset = run.force
    integral = _obey(actuator, run, before, share) if share > 0.0 else 0.0
    if share < length:
        integral += _obey(actuator, run, command, length - share)
    return integral / length
