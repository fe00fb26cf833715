"""Every controller by its name, and digests of controllers and scenarios."""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from afl_mujoco.control import angle
from afl_mujoco.control.cartpole_feedback import DESIGNS, StateFeedback
from afl_mujoco.control.controller import AFL, CompiledController, Controller
from afl_mujoco.control.estimator import EstimatedController
from afl_mujoco.control.gains import (
    FIXED_GAINS,
    GAIN_NAMES,
    GainFunction,
    Gains,
    beyond_table,
    shipped_data,
)
from afl_mujoco.control.law import sliding_and_drift
from afl_mujoco.control.names import ANGLE, ESTIMATED, INFORMED, PAPER, require_known
from afl_mujoco.control.own import PythonController, load_python_controller
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.plants.plant import Floats
from afl_mujoco.scenario.files import scenario_to_table
from afl_mujoco.scenario.parameters import NOMINAL, CartPoleParameters, PlantRange
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.values import require_type


class GainError(InvalidValueError):
    """A gain function whose gain is not positive for the parameters that a controller assumes."""


@functools.lru_cache(maxsize=256)
def _compiled(gain_function: GainFunction) -> CompiledController:
    none = np.zeros(1)
    return CompiledController(AFL, gain_function.coefficients[None], none, none)


@dataclass(frozen=True, slots=True, kw_only=True)
class AFLController(Controller):
    """The control law (L1)-(L10) with its gains and the parameters it assumes.

    Attributes
    ----------
    name
        Name for reports and files.
    gain_function
        Gains as a function of the assumed M and l; constant for fixed gains.
    belief
        Constant parameters that the controller assumes; ``None`` for the true M(t) and l(t)
        (decision D7).
    home
        Where it brings the cart [m]: the target of the scenario.
    """

    name: str
    gain_function: GainFunction
    belief: CartPoleParameters | None = None
    home: float = 0.0

    def __post_init__(self) -> None:
        require_type("controller name", self.name, str)
        require_type("gain_function", self.gain_function, GainFunction)
        require_type("belief", self.belief, CartPoleParameters | None)

    @property
    def kind(self) -> int:
        """The paper's control law."""
        return AFL

    def assumed(self, values: Floats) -> Floats:
        """Return the parameters of its belief in place of those that it is told, if it has one."""
        if self.belief is None:
            return values
        own = [getattr(self.belief, name) for name in self.plant.parameters]
        return np.array(np.broadcast_to(own, values.shape))

    def compiled_for(self, plants: PlantRange) -> CompiledController:
        """Return the controller as compiled loops take it: (G1) has a gain for every plant."""
        return _compiled(self.gain_function)._replace(home=self.home)

    def about(self, home: float) -> AFLController:
        """Return the controller that brings the cart to a place [m]."""
        return self if home == self.home else replace(self, home=home)

    def remarks(self, scenario: Scenario) -> list[str]:
        """Return where scheduled gains are used beyond the plants for which they were found."""
        if self.gain_function.is_constant:
            return []
        own = self.belief
        assumed = scenario.assumed_plants if own is None else PlantRange.of(own)
        return [
            f"Its gains are extrapolated: they were found for {covered}, and {reached} here."
            for covered, reached in beyond_table(assumed)
        ]

    def inputs_for(self, values: Floats) -> Floats:
        """Return M, m, l, g, K, lambda, Phi in rows; raise if a gain is not positive."""
        inputs = Controller.inputs_for(self, values)
        _require_positive_gains(inputs)
        return inputs

    def saturation_ratio(self, states: Floats, inputs: Floats) -> Floats:
        """Return s / Phi at each of N states: beyond +-1 the switching term is saturated."""
        z, phi, z_dot, phi_dot = states.T
        length, gravity, slope, layer, home = inputs.T[[2, 3, 5, 6, 7]]
        surface, _ = sliding_and_drift(z - home, phi, z_dot, phi_dot, length, gravity, slope)
        return np.asarray(surface / layer)

    def describe(self) -> dict[str, Any]:
        """Return the controller as plain data, for provenance."""
        return {
            "name": self.name,
            "gain_function": {n: list(getattr(self.gain_function, n)) for n in GAIN_NAMES},
            "belief": "true" if self.belief is None else asdict(self.belief),
            **({"home": self.home} if self.home else {}),
        }


def _require_positive_gains(inputs: Floats) -> None:
    for column, name in enumerate(GAIN_NAMES, start=4):
        bad = ~(inputs[:, column] > 0.0)
        if np.any(bad):
            mass, _, length = inputs[bad][0, :3]
            raise GainError(
                f"{name} of the gain function at M = {mass:g} kg, l = {length:g} m",
                "must be positive",
                f"{inputs[bad][0, column]:g}",
            )


def _build() -> dict[str, Controller]:
    retuned = shipped_data("gain_functions.json")
    functions = {
        "fixed": GainFunction.constant(FIXED_GAINS),
        "adaptive": GainFunction.published(),
        "fixed-retuned": GainFunction.constant(Gains(**retuned["fixed"])),
        "adaptive-retuned": GainFunction.retuned(),
    }
    catalogue: list[Controller] = [
        AFLController(name=n, gain_function=f) for n, f in functions.items()
    ]
    catalogue += [
        AFLController(name=f"{n}-nominal", gain_function=functions[n], belief=NOMINAL)
        for n in PAPER
    ]
    catalogue.append(PythonController(name=ANGLE, function=angle.force))
    catalogue += [
        StateFeedback(name=n, kind=kind, design=design) for n, (kind, design) in DESIGNS.items()
    ]
    return {controller.name: controller for controller in catalogue}


CONTROLLERS: Mapping[str, Controller] = MappingProxyType(_build())
"""Every controller by name; those that end in ``-nominal`` assume constant M and l."""


def as_controller(controller: Any) -> Controller:
    """Return a controller from what the Python functions take."""
    if isinstance(controller, str):
        return find_controller(controller)
    if hasattr(controller, "inputs_for"):
        return controller  # type: ignore[no-any-return]
    name = getattr(controller, "__name__", type(controller).__name__)
    return PythonController(name=name, function=controller)


def require_stateless(controller: Controller, where: str) -> None:
    """Raise if a controller is stateful, which only sampled mode supports."""
    if controller.stateful:
        rule = f'is stateful, which {where} does not support; only mode "sampled" does'
        if isinstance(controller, PythonController) and controller.memory:
            rule += f" ({controller.memory})"
        raise InvalidValueError(f"controller {controller.name!r}", rule)


def find_controller(name: str) -> Controller:
    """Return a controller by its name.

    Parameters
    ----------
    name
        A key of `CONTROLLERS`; a key that does not end in ``-nominal``, followed by ``-estimated``,
        for that controller with the estimator; or ``module:attribute`` for your own controller.

    Raises
    ------
    UnknownNameError
        If `name` is not known.
    InvalidValueError
        If there is no such function, or it is not a controller.
    """
    if ":" in name:
        return load_python_controller(name)
    if (base := name.removesuffix(ESTIMATED)) != name and base in INFORMED:
        return EstimatedController(name=name, controller=CONTROLLERS[base])
    require_known(name)
    return CONTROLLERS[name]


def digests(scenarios: Iterable[Scenario], controllers: Iterable[Controller]) -> dict[str, str]:
    """Return a digest of each scenario and each controller, by ``scenario NAME`` and so on.

    Those of a plant of one's own, with its MJCF, and of a controller in Python cover the file that
    defines them, not what it imports.
    """
    found = {
        f"scenario {one.name}": scenario_to_table(one)
        | ({} if one.is_cart_pole else {"files": [one.plant.text, one.plant.stamp]})
        for one in scenarios
    }
    found |= {f"controller {one.name}": one.describe() for one in controllers}
    return {
        name: hashlib.blake2b(json.dumps(content).encode(), digest_size=16).hexdigest()
        for name, content in found.items()
    }
