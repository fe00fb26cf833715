"""The estimator of M and l: an extended Kalman filter that is frozen where nothing excites it.

The functions are compiled and work on a record that the caller holds, one for each run. `start` it
with the first measurement, then `update` it once in each control period with the measurement at
the end of the period and the force over it. Equation numbers: docs/explanation/estimation.md.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from afl_mujoco.compiled import kernel
from afl_mujoco.control.estimation.prediction import (
    STATES,
    fill_transition,
    linearise,
    moved,
)

FILTER = np.dtype(
    [
        *(("state", np.float64, (STATES,)), ("covariance", np.float64, (STATES, STATES))),
        *(("excitation", np.float64, (2,)), ("nis", np.float64)),
        *((name, np.float64, (STATES, STATES)) for name in ("transition", "product")),
        *((name, np.float64, (STATES,)) for name in ("cart_row", "pole_row", "gain", "row")),
    ]
)
"""State (z, phi, z', phi', ln M, ln l) and covariance; moving means of z'' and l phi'' [m/s^2]; the
normalised innovation squared (NIS) of the last update; work space."""

LARGEST_TURN = 0.5
"""The filter restarts, with its present M and l, if the pole would turn more than this in a period
[rad]: such a state was not measured, and it allows no further prediction."""


def new_filter() -> Any:
    """Return a filter for `start`."""
    return np.zeros(1, FILTER)[0]


@kernel
def estimate(filter_):
    """Return the estimates of M [kg] and l [m]."""
    return np.exp(filter_.state[4]), np.exp(filter_.state[5])


@kernel
def filtered_state(filter_):
    """Return the filtered (z, phi, z_dot, phi_dot)."""
    x = filter_.state
    return x[0], x[1], x[2], x[3]


@kernel
def start(filter_, settings, z, phi):
    """Begin with the first measurement and return the initial estimates of M [kg] and l [m].

    z, phi: Measured position [m] and angle [rad].
    """
    filter_.nis = 0.0
    for i in range(STATES):
        filter_.state[i] = 0.0
        for j in range(STATES):
            filter_.covariance[i, j] = 0.0
    filter_.state[0], filter_.state[1] = z, phi
    filter_.covariance[0, 0] = settings.position_variance
    filter_.covariance[1, 1] = settings.angle_variance
    filter_.covariance[2, 2] = settings.speed_variance
    filter_.covariance[3, 3] = settings.rate_variance
    for i in range(2):
        filter_.excitation[i] = 0.0
        filter_.state[4 + i] = settings.ln_start[i]
        filter_.covariance[4 + i, 4 + i] = settings.ln_variance[i]
    return estimate(filter_)


@kernel
def update(filter_, settings, z, phi, force, dt):
    """Process one control period and return the estimates of M [kg] and l [m].

    z, phi: Position [m] and angle [rad] measured at the end of the period.
    force: Force on the cart over the period, its mean if it was not constant [N].
    dt: Length of the period [s].
    """
    _predict(filter_, settings, force, dt)
    if not abs(filter_.state[3]) * dt < LARGEST_TURN:
        return _start_anew(filter_, settings, z, phi)
    learns = (_learns(filter_, settings, 0), _learns(filter_, settings, 1))
    nis = _correct(filter_, 0, z, settings.position_variance, learns)
    nis += _correct(filter_, 1, phi, settings.angle_variance, learns)
    filter_.nis = nis
    for i in range(2):
        j = 4 + i
        if _excited(filter_, settings, i):
            filter_.covariance[j, j] = max(filter_.covariance[j, j], settings.least_variance[i])
        within = max(filter_.state[j], settings.ln_lowest[i])
        filter_.state[j] = min(within, settings.ln_highest[i])
    return estimate(filter_)


@kernel
def _start_anew(filter_, settings, z, phi):
    """Restart with a measurement, but keep the estimates of M and l."""
    mass, length = filter_.state[4], filter_.state[5]
    start(filter_, settings, z, phi)
    filter_.state[4], filter_.state[5] = mass, length
    return estimate(filter_)


@kernel
def _excited(filter_, settings, i):
    """Return whether the motion excites M (0) or l (1)."""
    return abs(filter_.excitation[i]) > settings.least_excitation[i]


@kernel
def _learns(filter_, settings, i):
    """Return whether M (0) or l (1) may change: it is excited, or not yet known."""
    variance = filter_.covariance[4 + i, 4 + i]
    return _excited(filter_, settings, i) or variance > settings.least_variance[i]


@kernel
def _predict(filter_, settings, force, dt):
    """Propagate state, covariance and excitations over a period, Eqs. (E2)-(E5)."""
    x, covariance = filter_.state, filter_.covariance
    plant = (np.exp(x[4]), settings.pole_mass, np.exp(x[5]), settings.gravity)
    after = moved(x[0], x[1], x[2], x[3], force, plant, dt)
    phi = 0.5 * (x[1] + after[1])
    phi_dot = 0.5 * (x[3] + after[3])
    cart_row, pole_row = filter_.cart_row, filter_.pole_row
    coupling, cart, pole = linearise(phi, phi_dot, force, plant, cart_row, pole_row)
    transition, product = filter_.transition, filter_.product
    fill_transition(cart_row, pole_row, dt, transition)
    noise = 0.5 * dt * settings.acceleration_intensity
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
    x[0], x[1], x[2], x[3] = after
    share = dt / (dt + settings.excitation_memory)
    excitation = filter_.excitation
    excitation[0] += share * (cart - excitation[0])
    excitation[1] += share * (plant[2] * pole - excitation[1])


@kernel
def _add_noise(covariance, noise, coupling):
    """Add half the covariance of an unknown acceleration of the cart in a period, Eq. (E5)."""
    covariance[2, 2] += noise
    covariance[2, 3] += noise * coupling
    covariance[3, 2] = covariance[2, 3]
    covariance[3, 3] += noise * coupling * coupling * (1.0 + covariance[5, 5])


@kernel
def _correct(filter_, which, measured, variance, learns):
    """Correct by one coordinate in Joseph's form; return its squared innovation over its variance.

    Eqs. (E6)-(E8).
    """
    x, covariance, gain, row = filter_.state, filter_.covariance, filter_.gain, filter_.row
    innovation = measured - x[which]
    expected = covariance[which, which] + variance
    for i in range(STATES):
        row[i] = covariance[which, i]
        gain[i] = row[i] / expected if i < 4 or learns[i - 4] else 0.0
        x[i] += gain[i] * innovation
    for i in range(STATES):
        for j in range(i, STATES):
            left = covariance[i, j] - gain[i] * row[j]
            crossed = row[i] - gain[i] * row[which]
            covariance[i, j] = left - crossed * gain[j] + gain[i] * variance * gain[j]
    for i in range(STATES):
        for j in range(i):
            covariance[i, j] = covariance[j, i]
    return innovation * innovation / expected
