"""Sensors and drives of the sampled loop, and their noise."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.compiled import inlined_kernel, jitable, kernel
from afl_mujoco.plants.plant import Floats
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.time_steps import SNAP
from afl_mujoco.simulation.mujoco_model import read_state

_ROUNDS = 10
_M0, _M1 = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_W0, _W1 = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)
_LOW, _WORD = np.uint64(0xFFFFFFFF), np.uint64(32)
_UNIT = 2.0**-32


@jitable
def philox(c0, c1, c2, c3, k0, k1):
    """Return four words of 32 bits for a counter of four and a key of two, all as uint64."""
    for _ in range(_ROUNDS):
        p0, p1 = _M0 * c0, _M1 * c2
        c0, c1, c2, c3 = (p1 >> _WORD) ^ c1 ^ k0, p1 & _LOW, (p0 >> _WORD) ^ c3 ^ k1, p0 & _LOW
        k0, k1 = (k0 + _W0) & _LOW, (k1 + _W1) & _LOW
    return c0, c1, c2, c3


@jitable
def _pair(first, second):
    """Return two independent standard normal numbers from two words, by Box and Muller."""
    radius = math.sqrt(-2.0 * math.log((float(first) + 0.5) * _UNIT))
    angle = 2.0 * math.pi * ((float(second) + 0.5) * _UNIT)
    return radius * math.cos(angle), radius * math.sin(angle)


@kernel
def normals(seed, tick, block=0):
    """Return four independent standard normal numbers; a tick has any number of blocks of them."""
    s, t, zero = np.uint64(seed), np.uint64(tick), np.uint64(0)
    a, b, c, d = philox(t & _LOW, t >> _WORD, np.uint64(block), zero, s & _LOW, s >> _WORD)
    n0, n1 = _pair(a, b)
    n2, n3 = _pair(c, d)
    return n0, n1, n2, n3


DRIVE = np.dtype(
    [
        *((name, np.float64) for name in ("demand", "force", "onset", "asked", "command")),
        *((name, np.float64) for name in ("mean_force", "max_command", "max_force", "limited")),
        *((name, np.float64) for name in ("force_squared", "force_variation")),
        ("beyond", np.bool_),
    ]
)
"""The state of the drive of an input, kept from step to step.

``demand``, ``force``: the force that the drive aims at and the force that it exerts [N].
``onset``: the force that it exerted at the start of the last step [N]. ``asked``, ``command``,
``mean_force``: what the controller asked for at the last tick, the same within the drive's limit,
and the mean force exerted since then [N]. ``max_command``, ``max_force``: the largest of what was
asked for and exerted [N]. ``limited``: how long it was at the limit or beyond [step], which
``beyond`` says of the last tick. ``force_squared``, ``force_variation``: of the exerted force, the
integral of its square [N^2 step] and its total variation [N], exact for its course within the
steps.
"""

MARKS = np.dtype([(name, np.int64) for name in ("status", "step", "written")])
"""How far a run is.

``status``: `RUNNING` or an index into `OUTCOMES`. ``step``: the step that the run has reached.
``written``: the row of the profile that the model has, -1 for none.
"""

RUNNING = -1  # the status of a run that has not ended

ACTUATOR = np.dtype(
    [
        *((name, np.float64) for name in ("low", "high")),  # limits of the force [N]
        ("slew", np.float64),  # largest rate of the force [N/step]
        ("late", np.int64),  # whole physics steps of the transport delay
        ("later_share", np.float64),  # rest of the transport delay [step]
        ("lag", np.float64),  # time constant of the first-order lag [step]
    ]
)
"""How the command of an input becomes the force that acts."""


class RunState(NamedTuple):
    """The state of a run of a plant with n coordinates and k inputs, kept from step to step."""

    marks: Any  # how far it is, a record of `MARKS`
    drive: NDArray[Any]  # the state of each drive, shape (k,) of `DRIVE`
    command: Floats  # what is commanded, shape (k,) [N]
    measured: Floats  # the last measurement, shape (2 n,)
    seen: Floats  # positions and filtered rates of the last tick, shape (2 n,)
    before: Floats  # the state before and after a step, shape (2 n,)
    after: Floats
    peak: Floats  # largest deviations of the coordinates so far, shape (n,)
    space: Floats  # work space, shape (k + 5 n,)


class Sensors(NamedTuple):
    """How the state is measured."""

    noisy: bool  # whether any noise is added
    noise: Floats  # standard deviations, shape (2 n,)
    step: Floats  # resolutions of the coordinates, shape (n,)
    differentiated: bool  # whether velocities are differences of positions
    period: float  # control period [s]
    # share of the gap to the measured velocity that the filtered velocity closes in a period, 1
    # without a filter [1]
    filter_share: float
    seed: int  # seed of the noise


def sensors_of(scenario: Scenario, period: float) -> Sensors:
    """Return how the hardware of a scenario measures in a control period [s]."""
    r, plant = scenario.imperfections, scenario.plant
    return Sensors(
        noisy=r.noisy,
        noise=np.array([float(r.at(f"noise.{name}")) for name in plant.states]),
        step=np.array([float(r.at(f"encoder_step.{name}")) for name in plant.coordinates]),
        differentiated=r.differentiated,
        period=period,
        filter_share=1.0 if r.velocity_filter == 0.0 else -math.expm1(-period / r.velocity_filter),
        seed=r.seed,
    )


def actuators_of(scenario: Scenario, timestep: float, steps: int) -> NDArray[Any]:
    """Return how the hardware of a scenario acts in physics steps [s]."""
    r, inputs = scenario.imperfections, scenario.plant.inputs
    found = np.zeros(len(inputs), ACTUATOR)
    for one, name, limits in zip(found, inputs, scenario.limits.tolist(), strict=True):
        delay = min(r.of_input("delay", name) / timestep, steps + 1.0)
        late = math.floor(delay + SNAP)
        slew = r.of_input("slew_rate", name)
        one["low"], one["high"] = limits
        one["slew"] = math.inf if slew is None else slew * timestep
        one["late"], one["later_share"] = late, delay - late if delay - late > SNAP else 0.0
        one["lag"] = r.of_input("lag", name) / timestep
    return found


def new_run(n: int = 2, k: int = 1) -> RunState:
    """Return the state of a run that has not begun: no force, no measurement, nothing written."""
    marks = np.zeros(1, MARKS)
    marks["status"] = marks["written"] = RUNNING
    of_states = {name: np.zeros(2 * n) for name in ("measured", "seen", "before", "after")}
    others = {"peak": np.zeros(n), "space": np.zeros(k + 5 * n)}
    return RunState(marks[0], np.zeros(k, DRIVE), np.zeros(k), **of_states, **others)


def no_commands(actuators: NDArray[Any]) -> Floats:
    """Return a buffer, all zero, for the commands [N] that the transport delays can hold."""
    return np.zeros((int(actuators["late"].max(initial=0)) + 2, len(actuators)))


@inlined_kernel
def sense(at, sensors, run, tick):
    """Measure the state as the controller gets it."""
    x, seen, n = run.measured, run.seen, at.n
    read_state(at, x)
    if sensors.noisy:
        drawn = normals(sensors.seed, tick, 0)
        for i in range(2 * n):
            if i > 0 and i % 4 == 0:
                drawn = normals(sensors.seed, tick, i // 4)
            x[i] += sensors.noise[i] * drawn[i % 4]
    # noise first: an encoder counts the noisy position
    for i in range(n):
        if sensors.step[i] > 0.0:
            x[i] = sensors.step[i] * np.rint(x[i] / sensors.step[i])
        if sensors.differentiated:
            x[n + i] = (x[i] - seen[i]) / sensors.period if tick > 0 else 0.0
            seen[i] = x[i]
        if sensors.filter_share < 1.0:
            if tick > 0:
                x[n + i] = seen[n + i] + sensors.filter_share * (x[n + i] - seen[n + i])
            seen[n + i] = x[n + i]


@inlined_kernel
def within_reach(actuator, command):
    """Return a command cut off at the force limits; NaN stays NaN."""
    if command > actuator.high:
        return actuator.high
    if command < actuator.low:
        return actuator.low
    return command


@inlined_kernel
def _reach(drive, force):
    """Let the exerted force change to a value, with none beyond the two in between."""
    drive.force_variation += abs(force - drive.force)
    drive.max_force = max(drive.max_force, abs(force))
    drive.force = force


@inlined_kernel
def _follow(drive, start, rate, length, lag):
    """Return the integral of the force, lagging a demand that changes at a constant rate.

    In steps and newtons: the demand goes from `start` at `rate` for `length`. With an excess E of
    the force over the demand, delayed by the lag T, the force is
    ``start + rate (t - T) + E exp(-t / T)``, from which the integral of its square follows too.
    """
    if length <= 0.0:
        return 0.0
    if lag == 0.0:
        end = start + rate * length
        _reach(drive, start)
        _reach(drive, end)
        drive.force_squared += length * (start * start + start * end + end * end) / 3.0
        return (start + 0.5 * rate * length) * length
    # T F' + F = demand, whose solution for a ramp is in the docstring
    excess = drive.force - start + rate * lag
    lost = -math.expm1(-length / lag)
    kept = 1.0 - lost
    if excess * rate > 0.0 and abs(rate) * lag < abs(excess):
        turn = -lag * math.log(rate * lag / excess)  # where force and demand meet, at rest
        if turn < length:
            _reach(drive, start + rate * turn)
    _reach(drive, start + rate * (length - lag) + excess * kept)
    base = start - rate * lag
    drive.force_squared += (
        length * (base * base + rate * length * (base + rate * length / 3.0))
        + 2.0 * excess * lag * (base * lost + rate * (lag * lost - length * kept))
        + 0.5 * excess * excess * lag * lost * (1.0 + kept)
    )
    return (start + rate * (0.5 * length - lag)) * length + excess * lag * lost


@inlined_kernel
def _obey(actuator, drive, command, length):
    """Return the integral of the force while a command holds for a length, one step at most."""
    demand, ramp = drive.demand, 0.0
    drive.demand = command
    integral = 0.0
    if command != demand and actuator.slew < np.inf:
        rate = math.copysign(actuator.slew, command - demand)
        ramp = min((command - demand) / rate, length)
        integral = _follow(drive, demand, rate, ramp, actuator.lag)
        if ramp == length:  # the ramp goes on in the next step
            drive.demand = demand + rate * length
    return integral + _follow(drive, command, 0.0, length - ramp, actuator.lag)


@inlined_kernel
def actuate(actuator, drive, pending, index, command, k, length):
    """Return the mean force of a drive over a physics step, or its length of one.

    Delay, slew limit and lag act continuously in time, one after the other, on a command that is
    held; a step gets the exact mean over the step, so that it delivers the right momentum with any
    of MuJoCo's integrators. The drive notes the force itself, which the mean would understate.
    """
    before, share = command, min(actuator.later_share, length)
    if actuator.late > 0 or share > 0.0:  # a ring of past commands, one a step
        size = len(pending)
        pending[k % size, index] = command
        command = pending[(k - actuator.late) % size, index]
        before = pending[(k - actuator.late - 1) % size, index]
    if actuator.lag == 0.0 and actuator.slew == np.inf:
        drive.onset = before if share > 0.0 else command
        _follow(drive, before, 0.0, share, 0.0)
        _follow(drive, command, 0.0, length - share, 0.0)
        return command if share == 0.0 else command + share / length * (before - command)
    drive.onset = drive.force
    integral = _obey(actuator, drive, before, share) if share > 0.0 else 0.0
    if share < length:
        integral += _obey(actuator, drive, command, length - share)
    return integral / length
