"""A controller that takes M, l and the state from the estimator instead of the true ones."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from afl_mujoco.control.compiled_controller import CompiledController
from afl_mujoco.control.controller import Controller, Estimator
from afl_mujoco.control.estimation.settings import EstimatorSettings
from afl_mujoco.control.own.python_controller import PythonController
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.parameters import CartPoleParameters, PlantRange, require_type

GRID = 11
"""Number of values of M, and of l, for which gains are checked before a run."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimatedController(Controller):
    """A controller with the estimator of its M, l and state; only sampled mode supports it."""

    name: str  # name for reports and files
    controller: Controller  # the compiled controller that uses the estimates
    # settings of the estimator
    settings: EstimatorSettings = field(default_factory=EstimatorSettings)
    # none: the assumed parameters change along the run
    belief: CartPoleParameters | None = field(default=None, init=False)
    estimates: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Validate the kind of every field."""
        require_type("controller name", self.name, str)
        require_type("settings", self.settings, EstimatorSettings)
        thing = f"controller inside {self.name!r}"
        kinds = type(self.controller).__mro__
        if Controller not in kinds or EstimatedController in kinds or PythonController in kinds:
            raise InvalidValueError(thing, "must be a compiled controller", repr(self.controller))
        if self.controller.belief is not None:
            rule = "must not assume constant parameters"
            raise InvalidValueError(thing, rule, self.controller.name)

    @property
    def kind(self) -> int:
        """Raise: a loop without the estimator cannot run it."""
        raise self._refusal()

    def compiled_for(self, plants: PlantRange) -> CompiledController:
        """Raise, as `kind`."""
        raise self._refusal()

    def _refusal(self) -> InvalidValueError:
        """Return the error to raise where a form without the estimator is needed."""
        rule = 'uses the estimator; only mode "sampled" supports it'
        return InvalidValueError(f"controller {self.name!r}", rule)

    def estimator_for(self, start: CartPoleParameters) -> Estimator:
        """Return controller and settings as compiled loops take them."""
        settings, assumed = self.settings.on(start)
        masses, lengths = (np.linspace(*ends, GRID) for ends in assumed[:2])
        self.controller.inputs_along_run(  # raises if a gain is not positive
            *np.meshgrid(masses, lengths), assumed.pole_mass, assumed.gravity
        )
        return Estimator(self.controller.compiled_for(assumed), settings)

    def remarks(self, plants: PlantRange) -> list[str]:
        """Return the remarks of the controller inside."""
        return self.controller.remarks(plants)

    def estimator_remarks(self, start: CartPoleParameters, plants: PlantRange) -> list[str]:
        """Return where the plant leaves the range of the estimates."""
        _, assumed = self.settings.on(start)
        return [
            f"{symbol} goes to {value:g} {unit}, beyond the {least:g} to {largest:g} {unit} that "
            f"the estimator may assume ({name} of EstimatorSettings)"
            for symbol, unit, name, (least, largest), ends in (
                ("M", "kg", "cart_mass_range", assumed.cart_mass, plants.cart_mass),
                ("l", "m", "half_length_range", assumed.half_length, plants.half_length),
            )
            for value in sorted({*ends})
            if not least <= value <= largest
        ]

    def without_estimator(self) -> Controller:
        """Return the controller inside, which sees the true M and l."""
        return self.controller

    def inputs_along_run(
        self, cart_mass: ArrayLike, half_length: ArrayLike, pole_mass: float, gravity: float
    ) -> NDArray[Any]:
        """Return the inputs that the controller would have if M and l were known."""
        return self.controller.inputs_along_run(cart_mass, half_length, pole_mass, gravity)

    def describe(self) -> dict[str, Any]:
        """Return controller and estimator as plain data, for provenance."""
        return {
            "name": self.name,
            "controller": self.controller.describe(),
            "estimator": asdict(self.settings),
            "belief": "estimated",
        }


def require_no_estimator(controllers: Iterable[Controller]) -> None:
    """Raise if a controller uses the estimator: call before runs that do not support it."""
    for controller in controllers:
        if controller.estimates:
            _ = controller.kind
