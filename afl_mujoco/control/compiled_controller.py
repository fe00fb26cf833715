"""Every controller as one compiled function, so that a loop need not know which one it runs.

A controller is a `kind` and a `table` of numbers. The kind is an integer and not a function passed
as an argument, because the cache of compiled code cannot store the latter.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.compiled import kernel
from afl_mujoco.control.afl import afl_force, force_kernel
from afl_mujoco.control.feedback_linearization import linearizing_force
from afl_mujoco.control.gain_function import scheduled_gain

AFL, LINEAR, PARTIAL = 0, 1, 2
"""Kinds of controller: the paper's control law (L1)-(L10); state feedback ``F = -k x``; state
feedback ``u = -k x`` through the input map (L1)."""

_linearizing_force = linearizing_force


class CompiledController(NamedTuple):
    """A controller as the compiled functions of this module take it, in this order."""

    kind: int  # `AFL`, `LINEAR` or `PARTIAL`
    # its numbers, float64, C-contiguous, of three dimensions, as `compiled_force` describes them
    table: NDArray[np.float64]
    masses: NDArray[np.float64]  # nodes M [kg] and l [m] of the table
    lengths: NDArray[np.float64]


@kernel
def scheduled_force(z, phi, z_dot, phi_dot, assumed, w):
    """Return the force [N] of the control law with the gains of (G1), NaN where it has no value.

    w: Coefficients of the gain function, shape (3, 5).
    """
    cart_mass, pole_mass, half_length, gravity = assumed
    return force_kernel(
        z, phi, z_dot, phi_dot, cart_mass, pole_mass, half_length, gravity,
        scheduled_gain(cart_mass, half_length, w[0]),
        scheduled_gain(cart_mass, half_length, w[1]),
        scheduled_gain(cart_mass, half_length, w[2]),
    )  # fmt: skip


@kernel
def _weights(grid, value):
    """Return four nodes around a value and their weights in a cubic with a continuous slope.

    The slope at a node is that of the line through its neighbours. Beyond the grid by more than
    round-off the weights are NaN: nothing is known there.
    """
    last = len(grid) - 1
    if last == 0:
        return (0, 0, 0, 0), (1.0, 0.0, 0.0, 0.0)
    slack = 1e-9 * grid[last]
    if not grid[0] - slack <= value <= grid[last] + slack:
        return (0, 0, 0, 0), (np.nan, np.nan, np.nan, np.nan)
    left = min(max(np.searchsorted(grid, value, side="right") - 1, 0), last - 1)
    right, before, after = left + 1, max(left - 1, 0), min(left + 2, last)
    width = grid[right] - grid[left]
    t = (value - grid[left]) / width
    if t < 0.0:
        t = 0.0
    if t > 1.0:
        t = 1.0
    rising = t * t * (3.0 - 2.0 * t)
    slope_left = t * (1.0 - t) * (1.0 - t) * width / (grid[right] - grid[before])
    slope_right = -t * t * (1.0 - t) * width / (grid[after] - grid[left])
    return (before, left, right, after), (
        -slope_left,
        1.0 - rising - slope_right,
        rising + slope_left,
        slope_right,
    )


@kernel
def interpolated_gains(table, masses, lengths, cart_mass, half_length):
    """Return the four gains of a plant, bicubic between the nodes, NaN beyond them.

    Their slopes are continuous, so that fixed steps stay accurate along a ramp of M or l; the
    reference integrator ends a step at every node.

    table: Gains at the nodes, shape (len(masses), len(lengths), 4).
    masses, lengths: Nodes M [kg] and l [m], increasing.
    cart_mass, half_length: The plant's M [kg] and l [m].
    """
    rows, row_weights = _weights(masses, cart_mass)
    columns, column_weights = _weights(lengths, half_length)
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    for i in range(4):
        for j in range(4):
            weight = row_weights[i] * column_weights[j]
            node = table[rows[i], columns[j]]
            a += weight * node[0]
            b += weight * node[1]
            c += weight * node[2]
            d += weight * node[3]
    return a, b, c, d


@kernel
def _feedback_force(kind, z, phi, z_dot, phi_dot, assumed, gains):
    """Return the force [N] of state feedback; NaN for an unknown kind."""
    feedback = -(gains[0] * z + gains[1] * phi + gains[2] * z_dot + gains[3] * phi_dot)
    if kind == LINEAR:
        return feedback
    if kind == PARTIAL:
        cart_mass, pole_mass, half_length, gravity = assumed
        return _linearizing_force(
            feedback, phi, phi_dot, cart_mass, pole_mass, half_length, gravity
        )
    return np.nan


@kernel
def compiled_force(kind, table, masses, lengths, z, phi, z_dot, phi_dot, assumed):
    """Return the force [N] of a controller at one state, or NaN where it has no value.

    table: Float64, C-contiguous. For `AFL`: coefficients of the gain function (G1), shape (1, 3,
        5). For the others: gains k by M and l, shape (len(masses), len(lengths), 4), interpolated
        at the assumed M and l; a single node applies to every plant.
    masses, lengths: Nodes M [kg] and l [m], increasing; `AFL` does not use them.
    """
    if kind == AFL:
        return scheduled_force(z, phi, z_dot, phi_dot, assumed, table[0])
    gains = interpolated_gains(table, masses, lengths, assumed[0], assumed[2])
    return _feedback_force(kind, z, phi, z_dot, phi_dot, assumed, gains)


@kernel
def force_from_inputs(kind, state, inputs):
    """Return the force [N] from gains already looked up, equal to `compiled_force` bit for bit.

    state: (z, phi, z_dot, phi_dot), shape (4,).
    """
    if kind == AFL:
        return afl_force(state, inputs)
    return _feedback_force(
        kind, state[0], state[1], state[2], state[3],
        (inputs[0], inputs[1], inputs[2], inputs[3]), (inputs[4], inputs[5], inputs[6], inputs[7]),
    )  # fmt: skip


@kernel
def forces_along(kind, states, inputs):
    """Return the force at each of many states, shape (N,).

    inputs: As in `force_from_inputs`, shape (N, 7) or (N, 8).
    """
    forces = np.empty(len(states))
    for i in range(len(states)):
        forces[i] = force_from_inputs(kind, states[i], inputs[i])
    return forces


@kernel
def inputs_along(kind, table, masses, lengths, assumed):
    """Return the inputs of a controller at each of many instants: assumed (M, m, l, g), gains.

    assumed: Assumed (M, m, l, g) at each instant, shape (N, 4).
    """
    count = 7 if kind == AFL else 8
    inputs = np.empty((len(assumed), count))
    for i in range(len(assumed)):
        for j in range(4):
            inputs[i, j] = assumed[i, j]
        cart_mass, half_length = assumed[i, 0], assumed[i, 2]
        if i > 0 and cart_mass == assumed[i - 1, 0] and half_length == assumed[i - 1, 2]:
            for j in range(4, count):  # most schedules are constant most of the time
                inputs[i, j] = inputs[i - 1, j]
        elif kind == AFL:
            for j in range(3):
                inputs[i, 4 + j] = scheduled_gain(cart_mass, half_length, table[0, j])
        else:
            gains = interpolated_gains(table, masses, lengths, cart_mass, half_length)
            inputs[i, 4], inputs[i, 5], inputs[i, 6], inputs[i, 7] = gains
    return inputs
