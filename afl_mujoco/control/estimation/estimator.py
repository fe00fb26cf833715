"""The estimator of M and l: an extended Kalman filter that forgets no more than it learns.

Compiled, on a flat float64 memory that the caller holds, one for each run. `start` it with the
first measurement, then `update` it once in each control period with the measurement at its end and
the force over it. Equation numbers: docs/estimation.md.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.compiled import kernel
from afl_mujoco.control.estimation import settings as given
from afl_mujoco.control.estimation.prediction import (
    STATES,
    fill_transition,
    linearise,
    moved,
)

# Places in the memory: the state, its covariance row by row, the surprise, the excitations of M
# and l, and room to work in.
COVARIANCE = STATES
SURPRISE = COVARIANCE + STATES * STATES
EXCITATION = SURPRISE + 1
_TRANSITION = EXCITATION + 2
_PRODUCT = _TRANSITION + STATES * STATES
_ROWS = _PRODUCT + STATES * STATES
MEMORY_SIZE = _ROWS + 2 * STATES
"""Length of the memory."""

LARGEST_TURN = 0.5
"""The filter starts anew, with the M and l it has, when the pole would turn more in a period [rad]:
no such state has been measured, and none can be predicted on."""

_LN_START, _LN_VARIANCE = given.LN_START, given.LN_VARIANCE
_LN_LOWEST, _LN_HIGHEST = given.LN_LOWEST, given.LN_HIGHEST
_LEAST_VARIANCE, _LEAST_EXCITATION = given.LEAST_VARIANCE, given.LEAST_EXCITATION
_POSITION_VARIANCE, _ANGLE_VARIANCE = given.POSITION_VARIANCE, given.ANGLE_VARIANCE
_SPEED_VARIANCE, _RATE_VARIANCE = given.SPEED_VARIANCE, given.RATE_VARIANCE
_EXCITATION_MEMORY = given.EXCITATION_MEMORY
_ACCELERATION_INTENSITY = given.ACCELERATION_INTENSITY
_POLE_MASS, _GRAVITY = given.POLE_MASS, given.GRAVITY


def blank_memory() -> NDArray[np.float64]:
    """Return a memory for `start`."""
    return np.zeros(MEMORY_SIZE)


@kernel
def estimate(memory):
    """Return the estimates of M [kg] and l [m].

    Parameters
    ----------
    memory
        Of an estimator that was started.
    """
    return np.exp(memory[4]), np.exp(memory[5])


@kernel
def filtered_state(memory):
    """Return the filtered (z, phi, z_dot, phi_dot).

    Parameters
    ----------
    memory
        Of an estimator that was started.
    """
    return memory[0], memory[1], memory[2], memory[3]


@kernel
def start(memory, settings, z, phi):
    """Begin with the first measurement and return the initial beliefs of M [kg] and l [m].

    Parameters
    ----------
    memory
        Written, shape (MEMORY_SIZE,).
    settings
        `EstimatorSettings.array`.
    z, phi
        Measured position [m] and angle [rad].
    """
    memory[:] = 0.0
    memory[0], memory[1] = z, phi
    covariance = memory[COVARIANCE:SURPRISE].reshape(STATES, STATES)
    covariance[0, 0] = settings[_POSITION_VARIANCE]
    covariance[1, 1] = settings[_ANGLE_VARIANCE]
    covariance[2, 2] = settings[_SPEED_VARIANCE]
    covariance[3, 3] = settings[_RATE_VARIANCE]
    for i in range(2):
        memory[4 + i] = settings[_LN_START + i]
        covariance[4 + i, 4 + i] = settings[_LN_VARIANCE + i]
    return estimate(memory)


@kernel
def update(memory, settings, z, phi, force, dt):
    """Take in one control period and return the estimates of M [kg] and l [m].

    Parameters
    ----------
    memory
        Of an estimator that was started; changed.
    settings
        `EstimatorSettings.array`.
    z, phi
        Position [m] and angle [rad] measured at the end of the period.
    force
        Force on the cart over the period, its mean if it was not constant [N].
    dt
        Length of the period [s].
    """
    covariance = memory[COVARIANCE:SURPRISE].reshape(STATES, STATES)
    _predict(memory, settings, force, dt, covariance)
    if not abs(memory[3]) * dt < LARGEST_TURN:
        return _start_anew(memory, settings, z, phi)
    learns_mass = _learns(memory, settings, covariance, 0)
    learns_length = _learns(memory, settings, covariance, 1)
    learns = (learns_mass, learns_length)
    product = memory[_PRODUCT:_ROWS]
    surprise = _correct(memory, covariance, 0, z, settings[_POSITION_VARIANCE], learns, product)
    surprise += _correct(memory, covariance, 1, phi, settings[_ANGLE_VARIANCE], learns, product)
    memory[SURPRISE] = surprise
    for i in range(2):
        j = 4 + i
        if _excited(memory, settings, i):
            covariance[j, j] = max(covariance[j, j], settings[_LEAST_VARIANCE + i])
        memory[j] = min(max(memory[j], settings[_LN_LOWEST + i]), settings[_LN_HIGHEST + i])
    return estimate(memory)


@kernel
def _start_anew(memory, settings, z, phi):
    """Begin again with a measurement, but with the M and l that are believed."""
    kept = (memory[4], memory[5])
    start(memory, settings, z, phi)
    memory[4], memory[5] = kept
    return estimate(memory)


@kernel
def _excited(memory, settings, i):
    """Return whether the motion says something about M (0) or l (1)."""
    return abs(memory[EXCITATION + i]) > settings[_LEAST_EXCITATION + i]


@kernel
def _learns(memory, settings, covariance, i):
    """Return whether M (0) or l (1) may change: it is excited, or not yet known."""
    variance = covariance[4 + i, 4 + i]
    return _excited(memory, settings, i) or variance > settings[_LEAST_VARIANCE + i]


@kernel
def _predict(memory, settings, force, dt, covariance):
    """Move state, covariance and excitations on by a period, Eqs. (E2)-(E5)."""
    plant = (np.exp(memory[4]), settings[_POLE_MASS], np.exp(memory[5]), settings[_GRAVITY])
    after = moved(memory[0], memory[1], memory[2], memory[3], force, plant, dt)
    phi = 0.5 * (memory[1] + after[1])
    phi_dot = 0.5 * (memory[3] + after[3])
    cart_row, pole_row = memory[_ROWS : _ROWS + STATES], memory[_ROWS + STATES :]
    coupling, cart, pole = linearise(phi, phi_dot, force, plant, cart_row, pole_row)
    transition = memory[_TRANSITION:_PRODUCT].reshape(STATES, STATES)
    fill_transition(cart_row, pole_row, dt, transition)
    product = memory[_PRODUCT:_ROWS].reshape(STATES, STATES)
    noise = 0.5 * dt * settings[_ACCELERATION_INTENSITY]
    _add_noise(covariance, noise, coupling)
    for i in range(STATES):
        for j in range(STATES):
            sum_ = 0.0
            for k in range(STATES):
                sum_ += transition[i, k] * covariance[k, j]
            product[i, j] = sum_
    for i in range(STATES):
        for j in range(i, STATES):
            sum_ = 0.0
            for k in range(STATES):
                sum_ += product[i, k] * transition[j, k]
            covariance[i, j] = covariance[j, i] = sum_
    _add_noise(covariance, noise, coupling)
    memory[0], memory[1], memory[2], memory[3] = after
    share = dt / (dt + settings[_EXCITATION_MEMORY])
    memory[EXCITATION] += share * (cart - memory[EXCITATION])
    memory[EXCITATION + 1] += share * (plant[2] * pole - memory[EXCITATION + 1])


@kernel
def _add_noise(covariance, noise, coupling):
    """Add half of what an unknown acceleration of the cart does in a period, Eq. (E5)."""
    covariance[2, 2] += noise
    covariance[2, 3] += noise * coupling
    covariance[3, 2] = covariance[2, 3]
    covariance[3, 3] += noise * coupling * coupling * (1.0 + covariance[5, 5])


@kernel
def _correct(memory, covariance, which, measured, variance, learns, product):
    """Take in one measured coordinate, Joseph's form; return its squared innovation over variance.

    Eqs. (E6)-(E8). `product` is room for two vectors.
    """
    gain, row = product[:STATES], product[STATES : 2 * STATES]
    innovation = measured - memory[which]
    expected = covariance[which, which] + variance
    for i in range(STATES):
        row[i] = covariance[which, i]
        gain[i] = row[i] / expected if i < 4 or learns[i - 4] else 0.0
        memory[i] += gain[i] * innovation
    for i in range(STATES):
        for j in range(i, STATES):
            left = covariance[i, j] - gain[i] * row[j]
            crossed = row[i] - gain[i] * row[which]
            covariance[i, j] = left - crossed * gain[j] + gain[i] * variance * gain[j]
    for i in range(STATES):
        for j in range(i):
            covariance[i, j] = covariance[j, i]
    return innovation * innovation / expected
