"""State feedback: LQR, pole placement and partial linearization, designed for any plant."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.linalg import LinAlgError

from afl_mujoco.control.controller import LINEAR, PARTIAL, CompiledController, Controller
from afl_mujoco.control.gains import FIXED_GAINS
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.plants.plant import Floats
from afl_mujoco.scenario.parameters import CartPoleParameters, PlantRange


class GainGrid(NamedTuple):
    """Gains of (z, phi, z_dot, phi_dot) at the nodes of a grid over M and l."""

    table: Floats  # gains at the nodes, shape (len(masses), len(lengths), 4)
    masses: Floats  # nodes M [kg] and l [m], increasing
    lengths: Floats


class LinearModel(NamedTuple):
    """A linear model ``x' = A x + B v`` of x = (z, phi, z_dot, phi_dot)."""

    a: Floats  # A, shape (4, 4)
    b: Floats  # B, shape (4,); v is the force [N], or the cart's acceleration [m/s^2]


def accelerated_mass(parameters: CartPoleParameters) -> float:
    """Return mu = M + m/4 [kg]: at upright, the force for a unit acceleration of the cart."""
    return parameters.cart_mass + 0.25 * parameters.pole_mass


def upright_model(parameters: CartPoleParameters) -> LinearModel:
    """Return the model at upright, its input the force [N]."""
    p, mu = parameters, accelerated_mass(parameters)
    return _model(
        cart=(0.75 * p.pole_mass * p.gravity / mu, 1.0 / mu),
        pole=(
            0.75 * (p.cart_mass + p.pole_mass) * p.gravity / (p.half_length * mu),
            0.75 / (p.half_length * mu),
        ),
    )


def partially_linear_model(half_length: float, gravity: float) -> LinearModel:
    """Return the model at upright under (L1) for l [m] and g [m/s^2], its input z'' [m/s^2]."""
    share = 0.75 / half_length
    return _model(cart=(0.0, 1.0), pole=(share * gravity, share))


def _model(cart: tuple[float, float], pole: tuple[float, float]) -> LinearModel:
    """Return the model in which z'' and phi'' have these factors of phi and of the input."""
    a, b = np.zeros((4, 4)), np.zeros(4)
    a[0, 2] = a[1, 3] = 1.0
    a[2, 1], b[2] = cart
    a[3, 1], b[3] = pole
    return LinearModel(a, b)


def pole_placing_gains(model: LinearModel, poles: Sequence[complex]) -> Floats:
    """Return the gains k with which ``v = -k x`` gives a model these poles.

    With z'' = c phi + p v and phi'' = a phi + q v, the closed loop's polynomial is
    ``s^4 + (p k3 + q k4) s^3 + (p k1 + q k2 - a) s^2 - (a p - c q) (k3 s + k1)``.

    poles: Four, real or in conjugate pairs [1/s].
    Returns ndarray: Gains of (z, phi, z_dot, phi_dot), shape (4,).
    """
    polynomial = np.poly(np.asarray(poles))
    if len(polynomial) != 5 or np.iscomplexobj(polynomial):
        raise InvalidValueError("poles", "must be four, real or in conjugate pairs", list(poles))
    _, s3, s2, s1, s0 = polynomial.tolist()
    c, p, a, q = model.a[2, 1], model.b[2], model.a[3, 1], model.b[3]
    coupling = a * p - c * q
    k1, k3 = -s0 / coupling, -s1 / coupling
    return np.array([k1, (s2 + a - p * k1) / q, k3, (s3 - p * k3) / q])


FORMULAS: Mapping[int, str] = MappingProxyType(
    {LINEAR: "F = -k(M, l) x", PARTIAL: "F by (L1) of u = -k(M, l) x"}
)
"""What each kind of state feedback commands."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StateFeedback(Controller):
    """A linear feedback of the state; it has a force also where the paper's controller has none."""

    name: str  # name for reports and files
    # 1, feedback to the force, or 2, feedback to the cart's acceleration u, which the input map
    # (L1) of the assumed plant turns into a force
    kind: int
    design: Design  # gains by the assumed M and l
    home: float = 0.0  # where it brings the cart [m]

    def nodes_within(self, spans: Mapping[str, tuple[float, float]]) -> dict[str, Floats]:
        """Return the nodes between which the gains are interpolated."""
        (pole_mass, _), (gravity, _) = spans["pole_mass"], spans["gravity"]
        plants = PlantRange(spans["cart_mass"], spans["half_length"], pole_mass, gravity)
        _, masses, lengths = self.design.over(plants)
        return {"cart_mass": masses, "half_length": lengths}

    def compiled_for(self, plants: PlantRange) -> CompiledController:
        """Return the controller as compiled loops take it: copies, which they may write to."""
        try:
            grid = self.design.over(plants)
        except InvalidValueError as error:
            raise error.within(f"controller {self.name!r}: ") from None
        table, masses, lengths = (one.copy() for one in grid)
        return CompiledController(self.kind, table, masses, lengths, self.home)

    def about(self, home: float) -> StateFeedback:
        """Return the controller that brings the cart to a place [m]."""
        return self if home == self.home else replace(self, home=home)

    def describe(self) -> dict[str, Any]:
        """Return the controller as plain data, for provenance."""
        return {
            "name": self.name,
            "formula": FORMULAS[self.kind],
            "gains": dict(self.design.description),
            "belief": "true",
            **({"home": self.home} if self.home else {}),
        }


Method = Callable[[CartPoleParameters], Floats]

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


def lqr_gains(parameters: CartPoleParameters) -> Floats:
    """Return the gains that minimise the quadratic cost of Bryson's rule, shape (4,).

    The input is taken as the acceleration that the force gives, so that the numbers keep their
    order of magnitude for any plant.
    """
    from scipy.linalg import solve_continuous_are  # a third of a second to import

    mass = accelerated_mass(parameters)
    a, b = upright_model(parameters)
    b = b * mass
    states, weight = np.diag([x**-2 for x in LARGEST_STATE]), LARGEST_ACCELERATION**-2
    cost = solve_continuous_are(a, b[:, None], states, np.array([[weight]]))
    return np.asarray(mass * (b @ cost) / weight)


def placed_gains(parameters: CartPoleParameters) -> Floats:
    """Return the gains that give the plant `paper_poles`, shape (4,)."""
    p = parameters
    return pole_placing_gains(upright_model(p), paper_poles(p.half_length, p.gravity))


def outer_gains(parameters: CartPoleParameters) -> Floats:
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
        rows, columns = _nodes(*plants.cart_mass), _nodes(*plants.half_length)
        return _grid(self.method, rows, columns, plants.pole_mass, plants.gravity)


def _nodes(least: float, largest: float) -> tuple[int, int]:
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
    return GainGrid(np.array(table), np.array(masses), np.array(lengths))


@functools.lru_cache(maxsize=65536)
def _gains(
    method: Method, cart_mass: float, half_length: float, pole_mass: float, gravity: float
) -> Floats:
    plant = CartPoleParameters(
        cart_mass=cart_mass, pole_mass=pole_mass, half_length=half_length, gravity=gravity
    )
    try:
        return method(plant)
    except (ArithmeticError, LinAlgError, ValueError) as error:
        rule = f"must be one that the gains can be computed for: {error}"
        raise InvalidValueError("the plant", rule, plant) from None


_BRYSON = {
    "method": "LQR by Bryson's rule",
    "largest_state": list(LARGEST_STATE),
    "largest_force": f"{LARGEST_ACCELERATION} (M + m/4)",
}
_PLACED = {
    "method": "pole placement",
    "poles": "-lambda three times, -3 g K / (4 l Phi): those of the paper's controller with its "
    "fixed gains",
}
_BEHIND = {**_PLACED, "method": "pole placement behind the input map (L1)"}

DESIGNS: Mapping[str, tuple[int, Design]] = MappingProxyType(
    {
        "lqr": (LINEAR, Design(lqr_gains, _BRYSON)),
        "pole-placement": (LINEAR, Design(placed_gains, _PLACED)),
        "partial-linearization": (PARTIAL, Design(outer_gains, _BEHIND)),
    }
)
"""The baselines by name: kind of controller, and its gains."""
