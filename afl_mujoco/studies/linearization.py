"""A closed loop at upright to first order, by finite differences on MuJoCo and controller."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.controller import Controller
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.belief import TRUTH, Belief
from afl_mujoco.scenario.imperfections import IDEAL, Imperfections
from afl_mujoco.scenario.parameters import CartPoleParameters
from afl_mujoco.simulation.mujoco_model import CartPoleModel, forward

STEP = 1e-5
"""Step of the central differences [m, rad, m/s, rad/s, N]: their error falls with its square, the
rounding error grows with its inverse; here both are near 1e-10."""

COARSER = 10.0
"""Ratio of a second, longer step, with which the first is compared, to the first."""

AGREEMENT = 1e-5
"""Largest relative difference between the two results: the longer step's error is near 1e-7."""

REST = 1e-9
"""Largest force at upright [N]."""

KINK = 1e-3
"""Largest difference between a controller's slopes on either side of upright, relative to its
largest slope: central differences do not see a kink, whatever their step."""

_UPRIGHT = np.zeros(4)


class NotSmoothError(InvalidValueError):
    """Raised for a controller whose force has no slope at upright."""


Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Loop:
    """The loop ``x' = A x + B F``, ``F = -K x`` of the state x = (z, phi, z_dot, phi_dot).

    Attributes
    ----------
    a, b
        The plant: A, shape (4, 4), and B, shape (4,), the input a force [N]; with one more row and
        column if the actuator lags.
    k
        The controller: K, shape (4,) or (5,).
    disagreement
        Largest relative difference of A, B and K from those with a step ten times longer.
    """

    a: Array
    b: Array
    k: Array
    disagreement: float = 0.0

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Poles of the closed loop [1/s]."""
        return np.linalg.eigvals(self.a - np.outer(self.b, self.k)).astype(np.complex128)

    @property
    def stable(self) -> bool:
        """Whether all poles lie in the left half-plane."""
        return bool(self.poles.real.max() < 0.0)


LINEAR = (
    "delay", "actuator_lag", "rail_damping", "hinge_damping", "rail_armature", "hinge_armature",
    "tip_mass_share", "pole_radius", "control_period",
    "differentiated", "velocity_filter",
)  # fmt: skip
"""Imperfections that a linear loop can have."""


def linear_part(imperfections: Imperfections) -> Imperfections:
    """Return imperfections without those that a linear loop cannot have."""
    return Imperfections(**{name: getattr(imperfections, name) for name in LINEAR})


def linearize(
    controller: Controller,
    plant: CartPoleParameters,
    imperfections: Imperfections = IDEAL,
    belief: Belief = TRUTH,
) -> Loop:
    """Return the loop of a controller, as it is deployed, and MuJoCo's cart-pole at upright.

    Parameters
    ----------
    imperfections
        Only those in `LINEAR` count: passive physics, and the actuator's lag, whose state follows
        those of the plant. `loop_margins` handles delay, hold and velocities.
    belief
        What the controller assumes of the plant, its nominal values known.
    """
    r = linear_part(imperfections)
    dynamics = plant_dynamics(CartPoleModel(plant, imperfections=r))
    assumed = belief.about(plant)

    def force(state: Array) -> Array:
        return np.array([controller.force(state, assumed)])

    thing = f"linearisation of {controller.name!r} at M = {plant.cart_mass:g} kg"
    thing += f", l = {plant.half_length:g} m"
    (at_rest,) = force(_UPRIGHT)
    if not abs(at_rest) <= REST:
        rule = "must be about an equilibrium: no force at upright"
        raise InvalidValueError(thing, rule, f"{at_rest:g} N")
    fine, coarse = (
        (
            jacobian(lambda x: dynamics(x, 0.0), _UPRIGHT, step),
            jacobian(lambda u: dynamics(_UPRIGHT, u[0]), np.zeros(1), step),
            -jacobian(force, _UPRIGHT, step),
        )
        for step in (STEP, COARSER * STEP)
    )
    disagreement = max(
        float(np.abs(one - other).max() / max(np.abs(one).max(), 1e-300))
        for one, other in zip(fine, coarse, strict=True)
    )
    a, b, k = fine
    if not np.isfinite(k).all():
        raise InvalidValueError(thing, "must have finite slopes", k.ravel().tolist())
    kink = float(np.abs(_bend(force, _UPRIGHT, STEP)).max() / max(np.abs(k).max(), 1e-300))
    if not disagreement <= AGREEMENT:
        rule = f"must not depend on the step by more than {AGREEMENT:g}"
        raise NotSmoothError(thing, rule, f"{disagreement:.1e}")
    if not kink <= KINK:
        rule = f"must be smooth: slopes on either side may differ by {KINK:g} of the largest"
        raise NotSmoothError(thing, rule, f"{kink:.1e}")
    loop = Loop(a, b[:, 0], k[0], disagreement)
    return loop if r.actuator_lag == 0.0 else _lagging(loop, r.actuator_lag)


def _lagging(loop: Loop, lag: float) -> Loop:
    """Return a loop whose force follows what is commanded with a first-order lag [s]."""
    order = len(loop.a)
    a = np.zeros((order + 1, order + 1))
    a[:order, :order], a[:order, order], a[order, order] = loop.a, loop.b, -1.0 / lag
    b = np.zeros(order + 1)
    b[order] = 1.0 / lag
    return Loop(a, b, np.append(loop.k, 0.0), loop.disagreement)


def plant_dynamics(model: CartPoleModel) -> Callable[[Array, float], Array]:
    """Return MuJoCo's ``x' = f(x, F)`` for the parameters that a model has."""

    def dynamics(state: Array, force: float) -> Array:
        accelerations = forward(model.addresses, *state.tolist(), float(force), 0.0)
        return np.array([*state[2:], *accelerations])

    return dynamics


def jacobian(function: Callable[[Array], Array], point: Array, step: float) -> Array:
    """Return the derivative of a function by central differences, shape (outputs, inputs).

    Parameters
    ----------
    function
        Maps an array, shape (inputs,), to an array, shape (outputs,).
    point
        Where to take the derivative, shape (inputs,).
    """
    columns = [
        (function(point + offset) - function(point - offset)) / (2.0 * step)
        for offset in step * np.eye(len(point))
    ]
    return np.stack(columns, axis=-1)


def _bend(function: Callable[[Array], Array], point: Array, step: float) -> Array:
    """Return how far the slopes on either side differ, shape (outputs, inputs)."""
    middle = 2.0 * function(point)
    columns = [
        (function(point + offset) + function(point - offset) - middle) / step
        for offset in step * np.eye(len(point))
    ]
    return np.stack(columns, axis=-1)
