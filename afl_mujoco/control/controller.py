"""What a controller is to a simulator: state and truth in, force out."""

from __future__ import annotations

import math
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from afl_mujoco.control.compiled_controller import (
    CompiledController,
    forces_along,
    inputs_along,
    law_force,
)
from afl_mujoco.errors import ControllerDomainError
from afl_mujoco.scenario.parameters import CartPoleParameters


class Estimator(NamedTuple):
    """A law whose M, l and state are estimated, as compiled loops take it.

    Attributes
    ----------
    law
        The law.
    settings
        Of the estimator, `EstimatorSettings.record`.
    """

    law: CompiledController
    settings: Any


class Controller(Protocol):
    """What commands the force: its gains, and the parameters that it assumes of the plant.

    Attributes
    ----------
    name
        Name for reports and files.
    belief
        What the law takes the plant to be, whatever it is; ``None`` lets it see the true M(t) and
        l(t) (decision D7).
    interpreted
        Whether it is called by the interpreter, through `command`, and has no compiled form.
    """

    name: str
    belief: CartPoleParameters | None
    interpreted: ClassVar[bool] = False

    @property
    def compiled(self) -> CompiledController:
        """The law as compiled loops take it."""
        ...

    @property
    def estimator(self) -> Estimator | None:
        """What finds M, l and the state from measured positions, which only sampled mode runs."""
        return None

    @property
    def stateful(self) -> bool:
        """Whether a call depends on those before it.

        Only sampled mode, which calls once a control period and in order, can run it then.
        """
        return False

    def informed(self) -> Controller:
        """Return the law that is given the true M and l where this one estimates them."""
        return self

    def relabelled(self) -> Controller:
        """Return the law in the other reading of the paper's gain columns, if it has one."""
        return self

    def start(self) -> Controller:
        """Return the law as one run uses it, with fresh memory where it keeps any."""
        return self

    def describe(self) -> dict[str, Any]:
        """Return the law as plain data, for provenance."""
        ...

    def assumed_parameters(
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

    def force(self, state: ArrayLike, truth: CartPoleParameters, time: float = 0.0) -> float:
        """Return the force [N] at one state, from the compiled law.

        Parameters
        ----------
        state
            (z, phi, z_dot, phi_dot), shape (4,).
        truth
            The plant's true parameters now.
        time
            Time [s]; of consequence only to a law in Python.

        Raises
        ------
        ControllerDomainError
            If the law has no value at the pole angle: that of the paper beyond ``|phi| < pi/2``.
        """
        z, phi, z_dot, phi_dot = np.asarray(state, dtype=np.float64).tolist()
        p = truth
        assumed_parameters = self.assumed_parameters(
            p.cart_mass, p.pole_mass, p.half_length, p.gravity
        )
        force = float(law_force(*self.compiled, z, phi, z_dot, phi_dot, assumed_parameters))
        if math.isnan(force) and not abs(phi) < 0.5 * np.pi:
            raise ControllerDomainError(
                "pole angle phi", "must lie inside (-pi/2, pi/2)", f"{phi:g} rad"
            )
        return force

    def command(self, time: float, state: ArrayLike, told: NDArray[np.float64]) -> float:
        """Return the force [N], NaN where the law has none.

        Parameters
        ----------
        time
            Time [s]; of consequence only to a law in Python.
        state
            (z, phi, z_dot, phi_dot), shape (4,).
        told
            (M, m, l, g) as the law takes them to be, shape (4,).
        """
        x = np.asarray(state, dtype=np.float64).tolist()
        return float(law_force(*self.compiled, *x, tuple(told.tolist())))

    def told(
        self, cart_mass: ArrayLike, half_length: ArrayLike, pole_mass: float, gravity: float
    ) -> NDArray[np.float64]:
        """Return what the law takes (M, m, l, g) to be along a run, shape (..., 4).

        Parameters
        ----------
        cart_mass, half_length
            True M [kg] and l [m], any one shape (...).
        pole_mass, gravity
            True m [kg] and g [m/s^2].
        """
        masses = np.asarray(cart_mass, dtype=np.float64)
        told = np.empty((*masses.shape, 4))
        told[...] = self.assumed_parameters(np.nan, pole_mass, np.nan, gravity)
        if self.belief is None:
            told[..., 0], told[..., 2] = masses, half_length
        return told

    def inputs_along_run(
        self, cart_mass: ArrayLike, half_length: ArrayLike, pole_mass: float, gravity: float
    ) -> NDArray[np.float64]:
        """Return what the compiled law is given along a run: (M, m, l, g) and its gains.

        Parameters
        ----------
        cart_mass, half_length
            True M [kg] and l [m], any one shape (...).
        pole_mass, gravity
            True m [kg] and g [m/s^2].

        Returns
        -------
        ndarray
            Assumed parameters and gains, shape (..., 7) or (..., 8): the paper's law has three
            gains, state feedback four.

        Raises
        ------
        InvalidValueError
            If a gain breaks its rule.
        """
        told = self.told(cart_mass, half_length, pole_mass, gravity)
        law: NDArray[np.float64] = inputs_along(*self.compiled, told.reshape(-1, 4))
        return law.reshape((*told.shape[:-1], law.shape[1]))

    def forces(
        self,
        states: NDArray[np.float64],
        law: NDArray[np.float64],
        times: NDArray[np.float64] | None = None,
    ) -> NDArray[np.float64]:
        """Return the force [N] at each of many states; NaN outside the law's domain.

        Parameters
        ----------
        states
            Shape (N, 4).
        law
            From `inputs_along_run`, shape (N, 7) or (N, 8).
        times
            When [s], shape (N,); of consequence only to a law in Python.
        """
        kind = self.compiled.kind
        return np.asarray(
            forces_along(kind, np.ascontiguousarray(states), np.ascontiguousarray(law))
        )

    def saturation_ratio(
        self, states: NDArray[np.float64], law: NDArray[np.float64]
    ) -> NDArray[np.float64] | None:
        """Return s / Phi at each of many states, or None of a law that has no boundary layer.

        Parameters
        ----------
        states
            Shape (N, 4).
        law
            From `inputs_along_run`, shape (N, 7) or (N, 8).
        """
        return None


def assumed_as_data(belief: CartPoleParameters | None) -> Any:
    """Return a belief as plain data, for provenance: ``"true"`` or the parameters."""
    return "true" if belief is None else {k: getattr(belief, k) for k in belief.__slots__}
