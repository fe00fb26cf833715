"""The gains of the baselines for given plants, from the linear model alone."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.linalg import LinAlgError
from numpy.typing import NDArray
from scipy.linalg import solve_continuous_are

from afl_mujoco.control.baselines.gain_grid import GainGrid
from afl_mujoco.control.baselines.linear_model import (
    accelerated_mass,
    partially_linear_model,
    pole_placing_gains,
    upright_model,
)
from afl_mujoco.control.compiled_controller import LINEAR, PARTIAL
from afl_mujoco.control.gains import FIXED_GAINS
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.parameters import CartPoleParameters, PlantRange

Method = Callable[[CartPoleParameters], NDArray[np.float64]]

NODES_PER_OCTAVE = 4
"""Nodes at which gains are computed: from one node to the next, M or l grows by 19 %. Between the
nodes, gains are interpolated to two parts in ten thousand or better."""

MARGIN = 2
"""Nodes beyond the requested plants: with them, the gains interpolated at a plant do not depend on
which other plants were requested."""

LARGEST_STATE = (7.60, 1.05, 8.13, 2.84)
"""Bryson's rule: each state is weighted by the inverse square of this [m, rad, m/s, rad/s]: its
peak under the paper's controller with fixed gains on the nominal plant from -60 degrees."""

LARGEST_ACCELERATION = 41.76
"""The force is weighted by the inverse square of this times M + m/4 [m/s^2], chosen so that the LQR
needs the same largest force on the nominal plant from -60 degrees as the paper's, 96.1 N."""


def paper_poles(half_length: float, gravity: float) -> tuple[float, ...]:
    """Return the poles that the paper's controller with its fixed gains has at upright [1/s].

    There its linearisation is exact: ``xi1`` obeys ``(d/dt + lambda)^3 xi1 = s`` and, within the
    boundary layer, ``s' = -3 g K / (4 l Phi) s``. So pole placement with these poles is the paper's
    controller without its nonlinear terms.

    half_length, gravity: l [m] and g [m/s^2].
    """
    g = FIXED_GAINS
    fast = 0.75 * gravity / half_length * g.switching / g.boundary_layer
    return (-g.slope, -g.slope, -g.slope, -fast)


def lqr_gains(parameters: CartPoleParameters) -> NDArray[np.float64]:
    """Return the gains that minimise the quadratic cost of Bryson's rule, shape (4,).

    The input is taken as the acceleration that the force gives, so that the numbers keep their
    order of magnitude for any plant.
    """
    mass = accelerated_mass(parameters)
    a, b = upright_model(parameters)
    b = b * mass
    states, weight = np.diag([x**-2 for x in LARGEST_STATE]), LARGEST_ACCELERATION**-2
    cost = solve_continuous_are(a, b[:, None], states, np.array([[weight]]))
    return np.asarray(mass * (b @ cost) / weight)


def placed_gains(parameters: CartPoleParameters) -> NDArray[np.float64]:
    """Return the gains that give the plant `paper_poles`, shape (4,)."""
    p = parameters
    return pole_placing_gains(upright_model(p), paper_poles(p.half_length, p.gravity))


def outer_gains(parameters: CartPoleParameters) -> NDArray[np.float64]:
    """Return the gains that give the plant `paper_poles` through the input map (L1), shape (4,)."""
    p = parameters
    model = partially_linear_model(p.half_length, p.gravity)
    return pole_placing_gains(model, paper_poles(p.half_length, p.gravity))


@dataclass(frozen=True, slots=True)
class Design:
    """Gains for any plant: computed at nodes that are the same for every run, and interpolated."""

    # function that returns the gains of a plant, shape (4,); defined at module level
    method: Method = field(repr=False)
    description: Mapping[str, Any]  # what it does, as plain data

    def over(self, plants: PlantRange) -> GainGrid:
        """Return the gains at the nodes around some plants, or raise InvalidValueError."""
        (least_mass, largest_mass), (least, largest), pole_mass, gravity = plants
        rows, columns = _nodes(least_mass, largest_mass), _nodes(least, largest)
        return _grid(self.method, rows, columns, pole_mass, gravity)


def _nodes(least: float, largest: float) -> tuple[int, int]:
    """Return the first node and the one after the last."""
    return (
        math.floor(NODES_PER_OCTAVE * math.log2(least)) - MARGIN,
        math.ceil(NODES_PER_OCTAVE * math.log2(largest)) + MARGIN + 1,
    )


@functools.lru_cache(maxsize=1024)
def _grid(
    method: Method, rows: tuple[int, int], columns: tuple[int, int], *constants: float
) -> GainGrid:
    """Return the gains at some nodes; the constants are m [kg] and g [m/s^2]."""
    masses, lengths = (
        [2.0 ** (node / NODES_PER_OCTAVE) for node in range(*ends)] for ends in (rows, columns)
    )
    table = [[_gains(method, mass, length, *constants) for length in lengths] for mass in masses]
    return GainGrid(np.array(masses), np.array(lengths), np.array(table))


@functools.lru_cache(maxsize=65536)
def _gains(
    method: Method, cart_mass: float, half_length: float, pole_mass: float, gravity: float
) -> NDArray[np.float64]:
    """Return the gains of a plant, or raise."""
    plant = CartPoleParameters(
        cart_mass=cart_mass, pole_mass=pole_mass, half_length=half_length, gravity=gravity
    )
    try:
        return method(plant)
    except (ArithmeticError, LinAlgError, ValueError) as error:
        rule = f"must be one that the gains can be computed for: {error}"
        raise InvalidValueError("the plant", rule, plant) from None


_POLES = (
    "-lambda three times, -3 g K / (4 l Phi): those of the paper's controller with its fixed gains"
)

DESIGNS: Mapping[str, tuple[int, Design]] = MappingProxyType(
    {
        "lqr": (
            LINEAR,
            Design(
                lqr_gains,
                {
                    "method": "LQR by Bryson's rule",
                    "largest_state": list(LARGEST_STATE),
                    "largest_force": f"{LARGEST_ACCELERATION} (M + m/4)",
                },
            ),
        ),
        "pole-placement": (
            LINEAR,
            Design(placed_gains, {"method": "pole placement", "poles": _POLES}),
        ),
        "partial-linearization": (
            PARTIAL,
            Design(
                outer_gains,
                {"method": "pole placement behind the input map (L1)", "poles": _POLES},
            ),
        ),
    }
)
"""The baselines by name: kind of controller, and its gains."""
