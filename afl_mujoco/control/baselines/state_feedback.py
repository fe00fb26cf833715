"""State feedback, its gains scheduled by M and l: straight to the force, or through (L1)."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from afl_mujoco.control.baselines.gain_grid import GainGrid
from afl_mujoco.control.compiled_controller import LINEAR, PARTIAL, CompiledController
from afl_mujoco.control.controller import Controller, assumed_as_data
from afl_mujoco.control.gain_function import shipped_data
from afl_mujoco.errors import FileError, InvalidValueError
from afl_mujoco.scenario.parameters import CartPoleParameters, require_type

FORMULAS: Mapping[int, str] = MappingProxyType(
    {LINEAR: "F = -k(M, l) x", PARTIAL: "F by (L1) of u = -k(M, l) x"}
)
"""What each kind of state feedback commands."""

SCHEMA = 1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StateFeedback(Controller):
    """A linear feedback of the state, with its gains and the parameters it assumes.

    It has a force at every state, also where the paper's controller has none.

    Attributes
    ----------
    name
        Name for reports and files.
    kind
        `LINEAR`, feedback to the force, or `PARTIAL`, feedback to the cart's acceleration u, made
        a force by the input map (L1) of the assumed plant.
    gains
        By the assumed M and l.
    belief
        Assumed parameters of the plant, constant; ``None`` gives it the true M(t) and l(t)
        (decision D7).
    design
        How the gains were found, as plain data.
    """

    name: str
    kind: int
    gains: GainGrid
    belief: CartPoleParameters | None = None
    design: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Validate every field."""
        require_type("controller name", self.name, str)
        require_type("gains", self.gains, GainGrid)
        require_type("belief", self.belief, CartPoleParameters | None)
        if self.kind not in FORMULAS:
            raise InvalidValueError(
                "kind", f"must be LINEAR ({LINEAR}) or PARTIAL ({PARTIAL})", self.kind
            )
        object.__setattr__(self, "design", dict(self.design))

    @property
    def compiled(self) -> CompiledController:
        """The controller as compiled loops take it: copies, since these need writable arrays."""
        grid = self.gains
        return CompiledController(
            self.kind, grid.table.copy(), grid.masses.copy(), grid.lengths.copy()
        )

    def describe(self) -> dict[str, Any]:
        """Return the controller as plain data, for provenance; its table by a hash."""
        table = hashlib.blake2b(self.gains.table.tobytes(), digest_size=8).hexdigest()
        return {
            "name": self.name,
            "formula": FORMULAS[self.kind],
            "design": dict(self.design),
            "table": table,
            "belief": assumed_as_data(self.belief),
        }


def baselines() -> list[StateFeedback]:
    """Return the state feedbacks that come with the package."""
    content = shipped_data("baselines.json")
    try:
        if content["schema"] != SCHEMA:
            raise InvalidValueError("schema", f"must be {SCHEMA}", content["schema"])
        return [
            StateFeedback(
                name=name,
                kind=entry["kind"],
                gains=GainGrid(content["cart_masses"], content["half_lengths"], entry["gains"]),
                design=entry["design"],
            )
            for name, entry in content["controllers"].items()
        ]
    except (KeyError, TypeError, AttributeError, InvalidValueError) as error:
        raise FileError("baselines.json", f"is not a table of baselines: {error}") from None
