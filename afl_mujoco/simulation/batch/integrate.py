"""Thousands of closed loops at once: the terms of the objective (O1) on constant plants, ideal ODE.

Each lane of a compiled block integrates one loop with its own step-size control, so that its
result does not depend on its neighbours; a lane that has ended takes the next loop. A step is
RK4 with an embedded estimate of order 3, and ends where the state enters or leaves the boundary
layer. Once the pole is nearly upright on the sliding surface, the rest is known in closed form.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from afl_mujoco.compiled import kernel
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.parameters import NOMINAL, require_positive
from afl_mujoco.simulation.batch.block import (
    IAE_PHI,
    IAE_Z,
    IDLE,
    LANES,
    LAYER_INVERSE,
    LEVER,
    LOST,
    MAX_FORCE,
    PHI_DOT,
    ROWS,
    RUNNING,
    SETTLED,
    SIGMA,
    SLOPE,
    STATUS,
    SWITCHING,
    TAU,
    TIME,
    Z_DOT,
    Z,
    advance,
)
from afl_mujoco.simulation.batch.reduced_loop import (
    reduced_force,
    reduced_slopes,
    tail_integrals,
)
from afl_mujoco.simulation.trajectory import FALL_ANGLE, STATE_LIMIT

TOLERANCE = 2e-6
"""Local error of a step, for every state relative to 1 plus its size. The objective is then
accurate to 5e-6 over the whole box of gains and plants."""


STIFFEST = 1e7
"""Largest product of the rate of the boundary layer and the horizon."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Terms:
    """The terms of (O1) of many closed loops.

    Attributes
    ----------
    iae_z, iae_phi
        Integrals of abs(z) [m s] and abs(phi) [rad s] up to `end_time`, shape (N,).
    max_force
        Largest abs(F) [N], shape (N,).
    end_time
        When the loop ended [s], shape (N,): the horizon, or the time at which it fell or diverged.
    lost
        Whether it fell or diverged, shape (N,).
    """

    iae_z: NDArray[np.float64]
    iae_phi: NDArray[np.float64]
    max_force: NDArray[np.float64]
    end_time: NDArray[np.float64]
    lost: NDArray[np.bool_]


def closed_loop_terms(
    gains: ArrayLike,
    plants: ArrayLike,
    *,
    initial_state: tuple[float, float, float, float] = (0.0, -math.pi / 3.0, 0.0, 0.0),
    duration: float = 20.0,
    pole_mass: float = NOMINAL.pole_mass,
    gravity: float = NOMINAL.gravity,
    tolerance: float = TOLERANCE,
    threads: int = 1,
) -> Terms:
    """Return the terms of (O1) for many gains and plants.

    Parameters
    ----------
    gains
        (K, lambda, Phi), shape (N, 3).
    plants
        (M, l) [kg, m], shape (N, 2) or (2,).
    duration
        The horizon [s].
    pole_mass, gravity
        m [kg] and g [m/s^2].
    tolerance
        Local error of a step, 1e-12 to 1e-2.
    threads
        Threads to share the loops among; the result does not depend on their number.

    Notes
    -----
    From a start well away from upright, such as the paper's, the relative error of the integrals is
    a few times the tolerance. The tail in closed form neglects terms that are cubic in 0.01 rad,
    which are not small for a start that is itself nearly upright. The largest force is taken at the
    steps and at the edge of the boundary layer, where the paper's start has it; from other starts a
    smooth peak between two steps may be missed by some 1e-3.
    """
    gains = _positive("gains", gains, 3)
    plants = np.asarray(plants, dtype=np.float64)
    if plants.shape not in ((2,), (len(gains), 2)):
        raise InvalidValueError(
            "plants", f"must have shape (2,) or ({len(gains)}, 2)", plants.shape
        )
    plants = _positive("plants", np.broadcast_to(plants, (len(gains), 2)), 2)
    constants = np.array(
        [
            require_positive("pole_mass", pole_mass),
            require_positive("gravity", gravity),
            require_positive("duration", duration),
            0.1 / require_positive("tolerance", tolerance),
        ]
    )
    if not 1e-12 <= tolerance <= 1e-2:
        raise InvalidValueError("tolerance", "must lie within 1e-12 and 1e-2", tolerance)
    if threads < 1:
        raise InvalidValueError("threads", "must be at least 1", threads)
    start = _start(initial_state)
    stiffness = 0.75 * gravity * gains[:, 0] / (gains[:, 2] * plants[:, 1]) * duration
    if np.any(stiffness > STIFFEST):
        rule = f"must not exceed {STIFFEST:g}: the loop would take as many steps"
        raise InvalidValueError("3 g K T / (4 l Phi)", rule, float(stiffness.max()))
    loops = np.ascontiguousarray(np.hstack([plants, gains]))
    found = np.empty((len(loops), 5))
    if threads == 1:
        integrate_all(loops, start, constants, found)
    else:
        with ThreadPoolExecutor(threads) as pool:
            bounds = np.linspace(0, len(loops), 4 * threads + 1).astype(int)
            parts = [slice(a, b) for a, b in pairwise(bounds) if a < b]
            list(pool.map(lambda p: integrate_all(loops[p], start, constants, found[p]), parts))
    return Terms(
        iae_z=found[:, 0],
        iae_phi=found[:, 1],
        max_force=found[:, 2],
        end_time=found[:, 3],
        lost=found[:, 4] == LOST,
    )


def _start(initial_state: tuple[float, float, float, float]) -> NDArray[np.float64]:
    """Return an initial state as an array, or raise."""
    start = np.array(initial_state, dtype=np.float64)
    sound = start.shape == (4,) and bool(np.all(np.abs(start) < STATE_LIMIT))
    if not sound or abs(start[1]) >= FALL_ANGLE:
        rule = f"must be four finite numbers, the angle within {FALL_ANGLE:.4f} rad"
        raise InvalidValueError("initial_state", rule, initial_state)
    return start


def _positive(thing: str, values: ArrayLike, width: int) -> NDArray[np.float64]:
    """Return an array of rows of positive finite numbers, or raise."""
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != width or not len(array):
        raise InvalidValueError(thing, f"must have shape (N, {width})", array.shape)
    bad = ~(np.isfinite(array) & (array > 0.0))
    if np.any(bad):
        raise InvalidValueError(thing, "must be positive and finite", array[bad][0])
    return array


@kernel
def integrate_all(loops, start, constants, found):
    """Integrate every loop to its end.

    Parameters
    ----------
    loops
        (M, l, K, lambda, Phi) of each, shape (N, 5).
    start
        The initial state, shape (4,).
    constants
        m, g, horizon and the weight of the error, shape (4,).
    found
        Takes integrals, largest force, end and status of each loop, shape (N, 5).
    """
    block = np.zeros(ROWS * LANES)
    holds = np.empty(LANES, dtype=np.int64)
    waiting = running = 0
    for lane in range(LANES):
        _load(block, lane, loops[min(lane, len(loops) - 1)], start, constants)
        holds[lane] = waiting
        if waiting < len(loops):
            waiting += 1
            running += 1
        else:
            block[STATUS * LANES + lane] = IDLE
    while running > 0:
        advance(block, constants[0], constants[1], constants[2], constants[3])
        for lane in range(LANES):
            status = block[STATUS * LANES + lane]
            if status == RUNNING or status == IDLE:
                continue
            _finish(block, lane, constants, found[holds[lane]])
            if waiting < len(loops):
                _load(block, lane, loops[waiting], start, constants)
                holds[lane] = waiting
                waiting += 1
            else:
                block[STATUS * LANES + lane] = IDLE
                running -= 1


@kernel
def _load(block, lane, loop, start, constants):
    """Put a loop into a lane, at its start."""
    pole_mass, gravity = constants[0], constants[1]
    cart_mass, half_length, switching, slope, layer = loop
    lever, tau = 4.0 / 3.0 * half_length, math.tan(start[1])
    sigma = math.asinh(tau)
    u, phi_ddot, sigma_dot, tau_dot, surface, _, _, _, cos = reduced_slopes(
        start[0], start[2], sigma, tau, start[3],
        lever, 1.0 / lever, gravity, switching, slope, 1.0 / layer,
    )  # fmt: skip
    force = reduced_force(u, tau, start[3], cos, cart_mass, pole_mass, lever, gravity)
    values = (
        start[0], start[2], sigma, tau, start[3], start[1],
        u, phi_ddot, sigma_dot, tau_dot, surface / layer,
        0.02 * half_length, 0.0, 0.0, 0.0, abs(force), float(RUNNING),
        lever, 1.0 / lever, switching, slope, 1.0 / layer, cart_mass,
    )  # fmt: skip
    for row in range(ROWS):
        block[row * LANES + lane] = values[row]


@kernel
def _finish(block, lane, constants, found):
    """Write the results of the loop in a lane, including its tail."""
    iae_z, iae_phi = block[IAE_Z * LANES + lane], block[IAE_PHI * LANES + lane]
    end, status = block[TIME * LANES + lane], block[STATUS * LANES + lane]
    if status == SETTLED:
        lever, slope = block[LEVER * LANES + lane], block[SLOPE * LANES + lane]
        _, _, _, _, _, xi1, xi2, xi3, _ = reduced_slopes(
            block[Z * LANES + lane], block[Z_DOT * LANES + lane], block[SIGMA * LANES + lane],
            block[TAU * LANES + lane], block[PHI_DOT * LANES + lane], lever, 1.0 / lever,
            constants[1], block[SWITCHING * LANES + lane], slope,
            block[LAYER_INVERSE * LANES + lane],
        )  # fmt: skip
        rest = tail_integrals(xi1, xi2, xi3, slope, lever, constants[1], constants[2] - end)
        iae_z, iae_phi, end = iae_z + rest[0], iae_phi + rest[1], constants[2]
    found[0], found[1], found[2] = iae_z, iae_phi, block[MAX_FORCE * LANES + lane]
    found[3], found[4] = end, status
