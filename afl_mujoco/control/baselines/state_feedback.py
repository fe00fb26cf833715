"""State feedback, its gains scheduled by M and l: straight to the force, or through (L1)."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.baselines.design import Design
from afl_mujoco.control.baselines.gain_grid import GainGrid
from afl_mujoco.control.compiled_controller import LINEAR, PARTIAL, CompiledController
from afl_mujoco.control.controller import Controller, assumed_as_data
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.parameters import CartPoleParameters, PlantRange, require_type

FORMULAS: Mapping[int, str] = MappingProxyType(
    {LINEAR: "F = -k(M, l) x", PARTIAL: "F by (L1) of u = -k(M, l) x"}
)
"""What each kind of state feedback commands."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StateFeedback(Controller):
    """A linear feedback of the state, with its gains and the parameters it assumes.

    It has a force at every state, even where the paper's controller has none.

    Attributes
    ----------
    name
        Name for reports and files.
    kind
        1, feedback to the force, or 2, feedback to the cart's acceleration u, which the input map
        (L1) of the assumed plant turns into a force.
    gains
        Gains by the assumed M and l: a table, valid within its nodes only, or a design, which has
        gains for any plant.
    belief
        Constant parameters that the controller assumes; ``None`` for the true M(t) and l(t)
        (decision D7).
    """

    name: str
    kind: int
    gains: GainGrid | Design
    belief: CartPoleParameters | None = None

    def __post_init__(self) -> None:
        """Validate every field."""
        require_type("controller name", self.name, str)
        require_type("gains", self.gains, GainGrid | Design)
        require_type("belief", self.belief, CartPoleParameters | None)
        if self.kind not in FORMULAS:
            raise InvalidValueError(
                "kind", f"must be LINEAR ({LINEAR}) or PARTIAL ({PARTIAL})", self.kind
            )

    def nodes(self, plants: PlantRange) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the nodes between which the gains are interpolated, none for one assumed plant."""
        if self.belief is not None:
            return np.empty(0), np.empty(0)
        grid = self.gains.over(plants)
        return grid.masses, grid.lengths

    def compiled_for(self, plants: PlantRange) -> CompiledController:
        """Return the controller as compiled loops take it: copies, which they may write to."""
        try:
            grid = self.gains.over(plants if self.belief is None else PlantRange.of(self.belief))
        except InvalidValueError as error:
            raise error.within(f"controller {self.name!r}: ") from None
        return CompiledController(
            self.kind, grid.table.copy(), grid.masses.copy(), grid.lengths.copy()
        )

    def describe(self) -> dict[str, Any]:
        """Return the controller as plain data, for provenance; a table as its hash."""
        gains = self.gains
        return {
            "name": self.name,
            "formula": FORMULAS[self.kind],
            "gains": dict(gains.description)
            if isinstance(gains, Design)
            else {"table": hashlib.blake2b(gains.table.tobytes(), digest_size=8).hexdigest()},
            "belief": assumed_as_data(self.belief),
        }
