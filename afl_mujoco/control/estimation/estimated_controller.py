"""A law that is told M, l and the state by the estimator instead of by the truth."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from typing import Any

from numpy.typing import ArrayLike, NDArray

from afl_mujoco.control.compiled_controller import CompiledController
from afl_mujoco.control.controller import Controller, Estimator
from afl_mujoco.control.estimation.settings import EstimatorSettings
from afl_mujoco.control.own.python_controller import PythonController
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.parameters import CartPoleParameters, require_type


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimatedController(Controller):
    """A law and the estimator that tells it M and l and filters its state; sampled mode runs it.

    Attributes
    ----------
    name
        Name for reports and files.
    law
        The law.
    settings
        Of the estimator.
    belief
        None: what the controller assumes changes along the run.
    """

    name: str
    law: Controller
    settings: EstimatorSettings = field(default_factory=EstimatorSettings)
    belief: CartPoleParameters | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        """Validate the kind of every field."""
        require_type("controller name", self.name, str)
        require_type("settings", self.settings, EstimatorSettings)
        thing = f"law of controller {self.name!r}"
        kinds = type(self.law).__mro__
        if Controller not in kinds or EstimatedController in kinds or PythonController in kinds:
            raise InvalidValueError(thing, "must be a compiled law", repr(self.law))
        if self.law.belief is not None:
            raise InvalidValueError(thing, "must have no belief of its own", self.law.name)

    @property
    def compiled(self) -> CompiledController:
        """What a loop without the estimator must not run."""
        rule = "is told by an estimator, which only sampled mode simulates"
        raise InvalidValueError(f"controller {self.name!r}", rule)

    @property
    def estimator(self) -> Estimator:
        """Law and settings as compiled loops take them."""
        return Estimator(self.law.compiled, self.settings.record)

    def informed(self) -> Controller:
        """Return the law, which is given the true M and l without its estimator."""
        return self.law

    def inputs_along_run(
        self, cart_mass: ArrayLike, half_length: ArrayLike, pole_mass: float, gravity: float
    ) -> NDArray[Any]:
        """Return what the controller would be given if M and l were known."""
        return self.law.inputs_along_run(cart_mass, half_length, pole_mass, gravity)

    def describe(self) -> dict[str, Any]:
        """Return law and estimator as plain data, for provenance."""
        return {
            "name": self.name,
            "law": self.law.describe(),
            "estimator": asdict(self.settings),
            "belief": "estimated",
        }


def refuse_estimated(laws: Iterable[Controller]) -> None:
    """Raise if a law is told by an estimator, before anything is run that cannot run it."""
    for law in laws:
        if law.estimator is not None:
            _ = law.compiled
