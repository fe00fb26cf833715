"""The sensors and the actuator of a rig, compiled, and the memory they keep between steps."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.compiled import borrowing_kernel, load
from afl_mujoco.scenario.realism import Realism
from afl_mujoco.scenario.sampling import SNAP
from afl_mujoco.simulation.mujoco_model import PHI, PHI_DOT, Z_DOT, Z
from afl_mujoco.simulation.rig.noise import normals

# Places in the memory of a run: what is written in the model, what was seen, the actuator's state,
# how far the run is, figures of it, what the drive was asked for and exerted over the last control
# period, commands under way.
CART_MASS, HALF_LENGTH, SEEN_Z, SEEN_PHI, SEEN_Z_DOT, SEEN_PHI_DOT, DEMAND, FORCE = range(8)
STATUS, STEP, PEAK_Z, PEAK_PHI, MAX_FORCE, IAE_Z, IAE_PHI, UNSETTLED, AT_STOP = range(8, 17)
COMMAND, MEAN_FORCE, RING = 17, 18, 19

RUNNING = -1
"""The status of a run that has not ended; else it is an index into `OUTCOMES`."""


class Sensors(NamedTuple):
    """How the state is measured.

    Attributes
    ----------
    noisy
        Whether any noise is added.
    noise_z, noise_phi, noise_z_dot, noise_phi_dot
        Standard deviations [m, rad, m/s, rad/s].
    step_z, step_phi
        Resolutions [m, rad].
    differentiated
        Whether velocities are differences of positions.
    period
        Control period [s].
    filter_share
        How far the filtered velocity goes to the measured one in a period, 1 without a filter [1].
    seed
        Of the noise.
    """

    noisy: bool
    noise_z: float
    noise_phi: float
    noise_z_dot: float
    noise_phi_dot: float
    step_z: float
    step_phi: float
    differentiated: bool
    period: float
    filter_share: float
    seed: int


class Actuator(NamedTuple):
    """How a command becomes the force on the cart.

    Attributes
    ----------
    limit
        Largest force [N].
    slew
        Largest rate of the force [N/step].
    late
        Whole physics steps of the transport delay.
    later_share
        What is left of the delay [step].
    lag
        Time constant of the first-order lag [step].
    """

    limit: float
    slew: float
    late: int
    later_share: float
    lag: float


def sensors_of(realism: Realism, period: float) -> Sensors:
    """Return how a rig measures.

    Parameters
    ----------
    realism
        Noise, resolution, differentiation, filter.
    period
        Control period [s].
    """
    r = realism
    noise = (r.noise_z, r.noise_phi, r.noise_z_dot, r.noise_phi_dot)
    share = 1.0 if r.velocity_filter == 0.0 else -math.expm1(-period / r.velocity_filter)
    return Sensors(
        any(noise), *noise, r.encoder_step_z, r.encoder_step_phi,
        r.differentiated, period, share, r.seed,
    )  # fmt: skip


def actuator_of(realism: Realism, timestep: float, steps: int) -> Actuator:
    """Return how a rig acts.

    Parameters
    ----------
    realism
        Limit, delay, slew rate, lag.
    timestep
        Physics step [s].
    steps
        How many the run has: a longer delay is as good as this.
    """
    r = realism
    delay = min(r.delay / timestep, steps + 1.0)
    late = math.floor(delay + SNAP)
    return Actuator(
        limit=math.inf if r.force_limit is None else r.force_limit,
        slew=math.inf if r.slew_rate is None else r.slew_rate * timestep,
        late=late,
        later_share=delay - late if delay - late > SNAP else 0.0,
        lag=r.actuator_lag / timestep,
    )


def blank_memory(actuator: Actuator) -> NDArray[np.float64]:
    """Return the memory of a run that has not begun: no force, nothing seen, nothing written.

    Parameters
    ----------
    actuator
        Says how many commands can be under way.
    """
    memory = np.zeros(RING + actuator.late + 2)
    memory[CART_MASS], memory[STATUS], memory[AT_STOP] = np.nan, RUNNING, -1.0
    return memory


@borrowing_kernel
def sense(at, sensors, memory, tick):
    """Return (z, phi, z_dot, phi_dot) as the law gets them.

    Parameters
    ----------
    at
        `CartPoleModel.addresses`; the state is read from MjData.
    sensors
        A `Sensors`.
    memory
        From `blank_memory`.
    tick
        Number of the control tick; each is measured once, in order.
    """
    z, phi, z_dot, phi_dot = load(at[Z]), load(at[PHI]), load(at[Z_DOT]), load(at[PHI_DOT])
    if sensors.noisy:
        n = normals(sensors.seed, tick)
        z, phi = z + sensors.noise_z * n[0], phi + sensors.noise_phi * n[1]
        z_dot += sensors.noise_z_dot * n[2]
        phi_dot += sensors.noise_phi_dot * n[3]
    if sensors.step_z > 0.0:
        z = sensors.step_z * np.rint(z / sensors.step_z)
    if sensors.step_phi > 0.0:
        phi = sensors.step_phi * np.rint(phi / sensors.step_phi)
    if sensors.differentiated:
        z_dot = (z - memory[SEEN_Z]) / sensors.period if tick > 0 else 0.0
        phi_dot = (phi - memory[SEEN_PHI]) / sensors.period if tick > 0 else 0.0
        memory[SEEN_Z], memory[SEEN_PHI] = z, phi
    if sensors.filter_share < 1.0:
        if tick > 0:
            z_dot = memory[SEEN_Z_DOT] + sensors.filter_share * (z_dot - memory[SEEN_Z_DOT])
            phi_dot = memory[SEEN_PHI_DOT] + sensors.filter_share * (phi_dot - memory[SEEN_PHI_DOT])
        memory[SEEN_Z_DOT], memory[SEEN_PHI_DOT] = z_dot, phi_dot
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
def _follow(memory, start, rate, length, lag):
    """Return the integral of the force, lagging a demand that changes at a constant rate.

    In steps and newtons: the demand goes from `start` at `rate` for `length`.
    """
    if lag == 0.0:
        return (start + 0.5 * rate * length) * length
    excess = memory[FORCE] - start + rate * lag
    lost = -math.expm1(-length / lag)
    memory[FORCE] = start + rate * (length - lag) + excess * (1.0 - lost)
    return (start + rate * (0.5 * length - lag)) * length + excess * lag * lost


@borrowing_kernel
def _obey(actuator, memory, command, length):
    """Return the integral of the force while a command stands for a length, a step at most."""
    demand, ramp = memory[DEMAND], 0.0
    memory[DEMAND] = command
    integral = 0.0
    if command != demand and actuator.slew < np.inf:
        rate = math.copysign(actuator.slew, command - demand)
        ramp = min((command - demand) / rate, length)
        integral = _follow(memory, demand, rate, ramp, actuator.lag)
        if ramp == length:
            memory[DEMAND] = demand + rate * length
    return integral + _follow(memory, command, 0.0, length - ramp, actuator.lag)


@borrowing_kernel
def actuate(actuator, memory, command, k):
    """Return the mean force on the cart over a physics step.

    Delay, slew limit and lag act continuously in time, one after the other, on a command that is
    held; what a step gets is the exact mean over the step, so that it delivers the right momentum
    with any integrator of MuJoCo's.

    Parameters
    ----------
    actuator
        An `Actuator`.
    memory
        From `blank_memory`.
    command
        From `within_reach` [N], the command now.
    k
        Number of the step; each is asked for once, in order.
    """
    before, share = command, actuator.later_share
    if actuator.late > 0 or share > 0.0:
        size = len(memory) - RING
        memory[RING + k % size] = command
        command = memory[RING + (k - actuator.late) % size]
        before = memory[RING + (k - actuator.late - 1) % size]
    if actuator.lag == 0.0 and actuator.slew == np.inf:
        return command if share == 0.0 else command + share * (before - command)
    integral = _obey(actuator, memory, before, share) if share > 0.0 else 0.0
    return integral + _obey(actuator, memory, command, 1.0 - share)
