"""A table of tuned gains by plant: the paper's Table 1, searched anew, a file with provenance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources.abc import Traversable
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.gain_function import GAIN_NAMES, shipped_file
from afl_mujoco.control.gains import Gains
from afl_mujoco.errors import InvalidValueError, UnknownNameError, reading
from afl_mujoco.files import FloatArray, read_json, write_json
from afl_mujoco.scenario.parameters import CART_MASSES, HALF_LENGTHS, PlantRange

COLUMNS = ("cart_mass", "half_length", *GAIN_NAMES, "objective", "objective_mujoco")
"""M [kg], l [m], K, lambda, Phi, and the objective (O1) on the ideal ODE and in MuJoCo."""

WRONG = "is not a gain table"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _File:
    """What the file of a table holds."""

    schema: Literal[1]
    provenance: dict[str, Any]
    columns: tuple[str, ...]
    rows: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class GainTable:
    """Tuned gains by plant.

    Attributes
    ----------
    rows
        One row of `COLUMNS` for each plant, shape (N, 7), read-only; the objective in MuJoCo is NaN
        (``null`` in the file) where the pole fell there.
    provenance
        How it was made, as plain data.
    """

    rows: NDArray[np.float64]
    provenance: Mapping[str, Any]

    def __post_init__(self) -> None:
        """Check the rows and freeze them."""
        rows = np.array(self.rows, dtype=np.float64)
        if rows.ndim != 2 or rows.shape[1] != len(COLUMNS) or not len(rows):
            raise InvalidValueError("gain table", f"must have {len(COLUMNS)} columns", rows.shape)
        unknown = np.isnan(rows) & (np.arange(len(COLUMNS)) == len(COLUMNS) - 1)
        if not np.all(unknown | (np.isfinite(rows) & (rows > 0.0))):
            raise InvalidValueError("gain table", "must hold positive finite numbers")
        rows.flags.writeable = False
        object.__setattr__(self, "rows", rows)
        object.__setattr__(self, "provenance", MappingProxyType(dict(self.provenance)))

    def column(self, name: str) -> NDArray[np.float64]:
        """Return a column of `COLUMNS`, shape (N,)."""
        if name not in COLUMNS:
            raise UnknownNameError.among("column", name, COLUMNS)
        column: NDArray[np.float64] = self.rows[:, COLUMNS.index(name)]
        return column

    def gains(self, cart_mass: float, half_length: float) -> Gains:
        """Return the gains of a plant, M [kg] and l [m], which must be in the table."""
        found = np.flatnonzero(
            np.isclose(self.column("cart_mass"), cart_mass)
            & np.isclose(self.column("half_length"), half_length)
        )
        if not len(found):
            plant = f"M = {cart_mass:g} kg, l = {half_length:g} m"
            raise InvalidValueError("plant", "must be in the gain table", plant)
        return Gains(**{name: self.column(name)[found[0]] for name in GAIN_NAMES})

    def save(self, path: Path) -> None:
        """Write the table as JSON, one plant per line, whole or not at all."""
        provenance = dict(self.provenance)
        write_json(path, _File(schema=1, provenance=provenance, columns=COLUMNS, rows=self.rows))

    @classmethod
    def load(cls, path: Path | Traversable) -> GainTable:
        """Read a table that `save` wrote; anything else raises a `FileError`."""
        file = read_json(path, _File, WRONG)
        with reading(path, WRONG):
            if file.columns != COLUMNS:
                raise InvalidValueError("columns", f"must be {COLUMNS}", file.columns)
            return cls(file.rows, file.provenance)

    @classmethod
    def shipped(cls) -> GainTable:
        """Return the table that comes with the package."""
        return cls.load(shipped_file("gain_table.json"))


def beyond_table(plants: PlantRange) -> list[tuple[str, str]]:
    """Return where plants lie beyond the table: what it covers, and what is reached, in words."""
    axes = (
        ("M", "kg", CART_MASSES, plants.cart_mass),
        ("l", "m", HALF_LENGTHS, plants.half_length),
    )
    return [
        (f"{symbol} {nodes[0]:g} to {nodes[-1]:g} {unit}", f"{symbol} reaches {far:g} {unit}")
        for symbol, unit, nodes, ends in axes
        for far, beyond in ((ends[0], ends[0] < nodes[0]), (ends[1], ends[1] > nodes[-1]))
        if beyond
    ]
