"""The interface of a controller to a simulator: state and true plant in, force out."""

from __future__ import annotations

import math
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from afl_mujoco.control.compiled_controller import (
    CompiledController,
    compiled_force,
    forces_along,
    inputs_along,
)
from afl_mujoco.errors import ControllerDomainError
from afl_mujoco.scenario.parameters import CartPoleParameters, PlantRange


class Estimator(NamedTuple):
    """A compiled controller with the estimator of M, l and the state, for compiled loops."""

    compiled: CompiledController  # the controller
    settings: Any  # settings of the estimator, the record of `EstimatorSettings.on`


class Controller(Protocol):
    """A controller of the force: its gains, and the parameters that it assumes of the plant.

    Attributes
    ----------
    name
        Name for reports and files.
    belief
        Constant parameters that the controller assumes; ``None`` for the true M(t) and l(t)
        (decision D7).
    interpreted
        Whether it is called by the interpreter, through `command`, and has no compiled form.
    estimates
        Whether M, l and the state are estimated from measured positions, in sampled mode only.
    """

    name: str
    belief: CartPoleParameters | None
    interpreted: ClassVar[bool] = False
    estimates: ClassVar[bool] = False

    @property
    def kind(self) -> int:
        """Which control law it is in compiled loops; raises if it has no compiled form."""
        ...

    def compiled_for(self, plants: PlantRange) -> CompiledController:
        """Return the controller as compiled loops take it, valid for these plants, or raise."""
        ...

    def estimator_for(self, start: CartPoleParameters) -> Estimator | None:
        """Return the estimator of M, l and the state, None if there is none.

        Parameters
        ----------
        start
            The plant at the start of the run, all that may be known of it.
        """
        return None

    @property
    def stateful(self) -> bool:
        """Whether a call depends on the calls before it.

        Only sampled mode, which calls once per control period and in order, supports that.
        """
        return False

    def without_estimator(self) -> Controller:
        """Return the controller that sees the true M and l where this one estimates them."""
        return self

    def remarks(self, plants: PlantRange) -> list[str]:
        """Return remarks for readers of its runs on these plants, one sentence each."""
        return []

    def estimator_remarks(self, start: CartPoleParameters, plants: PlantRange) -> list[str]:
        """Return remarks on an estimator that cannot follow a run, one sentence each.

        Parameters
        ----------
        start
            The plant at the start of the run.
        plants
            The plants of the run.
        """
        return []

    def nodes(self, plants: PlantRange) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the M [kg] and the l [m] of the true plant at which its gains are not smooth."""
        return np.empty(0), np.empty(0)

    def start(self) -> Controller:
        """Return the controller for one run, with its internal state reset if it has any."""
        return self

    def describe(self) -> dict[str, Any]:
        """Return the controller as plain data, for provenance."""
        ...

    def assumed_parameters(
        self, cart_mass: float, pole_mass: float, half_length: float, gravity: float
    ) -> tuple[float, float, float, float]:
        """Return the (M, m, l, g) that the controller assumes of a plant.

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
        """Return the force [N] at one state, from the compiled controller.

        Parameters
        ----------
        state
            (z, phi, z_dot, phi_dot), shape (4,).
        truth
            The plant's true parameters now.
        time
            Time [s]; used only by a Python controller.

        Raises
        ------
        ControllerDomainError
            If the controller has no force at the pole angle; the paper's has none outside
            ``|phi| < pi/2``.
        """
        z, phi, z_dot, phi_dot = np.asarray(state, dtype=np.float64).tolist()
        p = truth
        assumed_parameters = self.assumed_parameters(
            p.cart_mass, p.pole_mass, p.half_length, p.gravity
        )
        compiled = self.compiled_for(PlantRange.of(p))
        force = float(compiled_force(*compiled, z, phi, z_dot, phi_dot, assumed_parameters))
        if math.isnan(force) and not abs(phi) < 0.5 * np.pi:
            raise ControllerDomainError(
                "pole angle phi", "must lie inside (-pi/2, pi/2)", f"{phi:g} rad"
            )
        return force

    def command(self, time: float, state: ArrayLike, assumed: NDArray[np.float64]) -> float:
        """Return the force [N], NaN where the controller has none.

        Parameters
        ----------
        time
            Time [s]; used only by a Python controller.
        state
            (z, phi, z_dot, phi_dot), shape (4,).
        assumed
            Assumed (M, m, l, g), shape (4,).
        """
        x = np.asarray(state, dtype=np.float64).tolist()
        compiled = self.compiled_for(_range_of(assumed[None]))
        return float(compiled_force(*compiled, *x, tuple(assumed.tolist())))

    def assumed_along_run(
        self, cart_mass: ArrayLike, half_length: ArrayLike, pole_mass: float, gravity: float
    ) -> NDArray[np.float64]:
        """Return the assumed (M, m, l, g) along a run, shape (..., 4).

        Parameters
        ----------
        cart_mass, half_length
            True M [kg] and l [m], both of shape (...).
        pole_mass, gravity
            True m [kg] and g [m/s^2].
        """
        masses = np.asarray(cart_mass, dtype=np.float64)
        assumed = np.empty((*masses.shape, 4))
        assumed[...] = self.assumed_parameters(np.nan, pole_mass, np.nan, gravity)
        if self.belief is None:
            assumed[..., 0], assumed[..., 2] = masses, half_length
        return assumed

    def inputs_along_run(
        self, cart_mass: ArrayLike, half_length: ArrayLike, pole_mass: float, gravity: float
    ) -> NDArray[np.float64]:
        """Return the inputs of the compiled controller along a run: assumed (M, m, l, g), gains.

        Parameters
        ----------
        cart_mass, half_length
            True M [kg] and l [m], both of shape (...).
        pole_mass, gravity
            True m [kg] and g [m/s^2].

        Returns
        -------
        ndarray
            Assumed parameters and gains, shape (..., 7) or (..., 8): the paper's controller has
            three gains, state feedback four.

        Raises
        ------
        InvalidValueError
            If a gain breaks its rule.
        """
        assumed = self.assumed_along_run(cart_mass, half_length, pole_mass, gravity)
        rows = assumed.reshape(-1, 4)
        inputs: NDArray[np.float64] = inputs_along(*self.compiled_for(_range_of(rows)), rows)
        return inputs.reshape((*assumed.shape[:-1], inputs.shape[1]))

    def forces(
        self,
        states: NDArray[np.float64],
        inputs: NDArray[np.float64],
        times: NDArray[np.float64] | None = None,
    ) -> NDArray[np.float64]:
        """Return the force [N] at each of many states; NaN outside the controller's domain.

        Parameters
        ----------
        states
            Shape (N, 4).
        inputs
            From `inputs_along_run`, shape (N, 7) or (N, 8).
        times
            Times [s], shape (N,); used only by a Python controller.
        """
        return np.asarray(
            forces_along(self.kind, np.ascontiguousarray(states), np.ascontiguousarray(inputs))
        )

    def saturation_ratio(
        self, states: NDArray[np.float64], inputs: NDArray[np.float64]
    ) -> NDArray[np.float64] | None:
        """Return s / Phi at each of many states, None without a boundary layer.

        Parameters
        ----------
        states
            Shape (N, 4).
        inputs
            From `inputs_along_run`, shape (N, 7) or (N, 8).
        """
        return None


def _range_of(assumed: NDArray[np.float64]) -> PlantRange:
    """Return the range of plants in rows of assumed (M, m, l, g), with m and g constant."""
    masses, lengths = (
        (float(column.min()), float(column.max())) for column in (assumed[:, 0], assumed[:, 2])
    )
    return PlantRange(masses, lengths, float(assumed[0, 1]), float(assumed[0, 3]))


def assumed_as_data(belief: CartPoleParameters | None) -> Any:
    """Return assumed parameters as plain data, for provenance: ``"true"`` or the parameters."""
    return "true" if belief is None else {k: getattr(belief, k) for k in belief.__slots__}
