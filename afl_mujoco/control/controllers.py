"""The controllers by name: fixed or adaptive gains, with what each believes of the plant."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from afl_mujoco.compiled import kernel
from afl_mujoco.control.afl import force_kernel, forces_along, sliding_and_drift
from afl_mujoco.control.gain_function import (
    GAIN_NAMES,
    GainFunction,
    scheduled_gain,
    shipped_data,
)
from afl_mujoco.control.gains import FIXED_GAINS, GAIN_LABELS, Gains
from afl_mujoco.errors import InvalidValueError, LawDomainError, UnknownNameError
from afl_mujoco.scenario.parameters import NOMINAL, CartPoleParameters, require_type


@kernel
def scheduled_force(z, phi, z_dot, phi_dot, believed, w):
    """Return the force [N] of the law with the gains of (G1), or NaN where it has no value.

    Parameters
    ----------
    z, phi, z_dot, phi_dot
        The state.
    believed
        (M, m, l, g) as the law takes them to be.
    w
        Coefficients of the gain function, shape (3, 5).
    """
    cart_mass, pole_mass, half_length, gravity = believed
    return force_kernel(
        z, phi, z_dot, phi_dot, cart_mass, pole_mass, half_length, gravity,
        scheduled_gain(cart_mass, half_length, w[0]),
        scheduled_gain(cart_mass, half_length, w[1]),
        scheduled_gain(cart_mass, half_length, w[2]),
    )  # fmt: skip


@kernel
def _gains_along(cart_mass, half_length, coefficients):
    """Return (K, lambda, Phi) of (G1) for each plant, shape (N, 3)."""
    gains = np.empty((len(cart_mass), 3))
    for i in range(len(cart_mass)):
        for j in range(3):
            gains[i, j] = scheduled_gain(cart_mass[i], half_length[i], coefficients[j])
    return gains


@dataclass(frozen=True, slots=True, kw_only=True)
class Controller:
    """The law (L1)-(L10) with its gains and its belief.

    Attributes
    ----------
    name
        Name for reports and files.
    gain_function
        Gains as a function of the believed M and l; constant for fixed gains.
    belief
        What the law takes the plant to be, whatever it is; ``None`` lets it see the true M(t) and
        l(t) (decision D7).
    """

    name: str
    gain_function: GainFunction
    belief: CartPoleParameters | None = None

    def __post_init__(self) -> None:
        """Validate the kind of every field."""
        require_type("controller name", self.name, str)
        require_type("gain_function", self.gain_function, GainFunction)
        require_type("belief", self.belief, CartPoleParameters | None)

    def believed(
        self, cart_mass: float, pole_mass: float, half_length: float, gravity: float
    ) -> tuple[float, float, float, float]:
        """Return what the law takes (M, m, l, g) to be when they are truly as given.

        Parameters
        ----------
        cart_mass, pole_mass, half_length, gravity
            The plant's true parameters now [kg, kg, m, m/s^2].
        """
        b = self.belief
        if b is None:
            return cart_mass, pole_mass, half_length, gravity
        return b.cart_mass, b.pole_mass, b.half_length, b.gravity

    def force(self, state: ArrayLike, truth: CartPoleParameters) -> float:
        """Return the force [N] at one state, from the compiled law.

        Parameters
        ----------
        state
            (z, phi, z_dot, phi_dot), shape (4,).
        truth
            The plant's true parameters now.

        Raises
        ------
        LawDomainError
            If the pole angle is not inside ``|phi| < pi/2``.
        """
        z, phi, z_dot, phi_dot = np.asarray(state, dtype=np.float64).tolist()
        if not abs(phi) < 0.5 * np.pi:
            raise LawDomainError("pole angle phi", "must lie inside (-pi/2, pi/2)", f"{phi:g} rad")
        p = truth
        believed = self.believed(p.cart_mass, p.pole_mass, p.half_length, p.gravity)
        coefficients = self.gain_function.coefficients
        return float(scheduled_force(z, phi, z_dot, phi_dot, believed, coefficients))

    def law_inputs(
        self, cart_mass: ArrayLike, half_length: ArrayLike, pole_mass: float, gravity: float
    ) -> NDArray[np.float64]:
        """Return what the compiled law is given along a run: (M, m, l, g, K, lambda, Phi).

        Parameters
        ----------
        cart_mass, half_length
            True M [kg] and l [m], any one shape (...).
        pole_mass, gravity
            True m [kg] and g [m/s^2].

        Returns
        -------
        ndarray
            Believed parameters and gains, shape (..., 7).

        Raises
        ------
        InvalidValueError
            If the gain function gives a gain that is not positive.
        """
        masses = np.asarray(cart_mass, dtype=np.float64)
        lengths = np.asarray(half_length, dtype=np.float64)
        if self.belief is not None:
            masses = np.full_like(masses, self.belief.cart_mass)
            lengths = np.full_like(lengths, self.belief.half_length)
            pole_mass, gravity = self.belief.pole_mass, self.belief.gravity
        gains = _gains_along(masses.ravel(), lengths.ravel(), self.gain_function.coefficients)
        law = np.empty((masses.size, 7))
        law[:, 0], law[:, 1] = masses.ravel(), pole_mass
        law[:, 2], law[:, 3] = lengths.ravel(), gravity
        law[:, 4:] = gains
        _require_positive_gains(law)
        return law.reshape((*masses.shape, 7))

    def forces(self, states: NDArray[np.float64], law: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the force [N] at each of many states; NaN outside the law's domain.

        Parameters
        ----------
        states
            Shape (N, 4).
        law
            From `law_inputs`, shape (N, 7).
        """
        return np.asarray(forces_along(np.ascontiguousarray(states), np.ascontiguousarray(law)))

    def saturation_ratio(
        self, states: NDArray[np.float64], law: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return s / Phi at each of many states: beyond +-1 the switching term is saturated.

        Parameters
        ----------
        states
            Shape (N, 4).
        law
            From `law_inputs`, shape (N, 7).
        """
        z, phi, z_dot, phi_dot = states.T
        surface, _ = sliding_and_drift(z, phi, z_dot, phi_dot, law[:, 2], law[:, 3], law[:, 5])
        return np.asarray(surface / law[:, 6])

    def describe(self) -> dict[str, Any]:
        """Return the controller as plain data, for provenance."""
        return {
            "name": self.name,
            "gain_function": {n: list(getattr(self.gain_function, n)) for n in GAIN_NAMES},
            "belief": "true"
            if self.belief is None
            else {k: getattr(self.belief, k) for k in self.belief.__slots__},
        }


def _require_positive_gains(law: NDArray[np.float64]) -> None:
    """Raise if a gain along the run is not positive."""
    for column, name in enumerate(GAIN_NAMES, start=4):
        bad = ~(law[:, column] > 0.0)
        if np.any(bad):
            mass, _, length = law[bad][0, :3]
            raise InvalidValueError(
                f"{name} of the gain function at M = {mass:g} kg, l = {length:g} m",
                "must be positive",
                f"{law[bad][0, column]:g}",
            )


def _build() -> dict[str, Controller]:
    """Return the catalogue."""
    retuned = shipped_data("gain_functions.json")
    functions = {
        "fixed": GainFunction.constant(FIXED_GAINS),
        "adaptive": GainFunction.published(),
        "fixed-retuned": GainFunction.constant(Gains(**retuned["fixed"])),
        "adaptive-retuned": GainFunction.retuned(),
    }
    catalogue = [Controller(name=name, gain_function=f) for name, f in functions.items()]
    for name in ("fixed", "adaptive"):
        catalogue.append(
            Controller(name=f"{name}-nominal", gain_function=functions[name], belief=NOMINAL)
        )
    return {controller.name: controller for controller in catalogue}


CONTROLLERS: Mapping[str, Controller] = MappingProxyType(_build())
"""Every controller by name; those that end in ``-nominal`` are never told M(t) and l(t)."""


def find_controller(name: str, gain_labels: str = "table2") -> Controller:
    """Return a controller of the catalogue, in either reading of the paper's gain columns.

    The retuned gains are not the paper's and have one reading.

    Parameters
    ----------
    name
        A key of `CONTROLLERS`.
    gain_labels
        A key of `GAIN_LABELS`, decision D2.

    Raises
    ------
    UnknownNameError
        If `name` or `gain_labels` is not known.
    """
    if name not in CONTROLLERS:
        raise UnknownNameError.among("controller", name, CONTROLLERS)
    if gain_labels not in GAIN_LABELS:
        raise UnknownNameError.among("gain labels", gain_labels, GAIN_LABELS)
    controller = CONTROLLERS[name]
    if gain_labels == "table2" or name.endswith("-retuned"):
        return controller
    return Controller(
        name=f"{name}-table1",
        gain_function=controller.gain_function.relabelled(),
        belief=controller.belief,
    )
