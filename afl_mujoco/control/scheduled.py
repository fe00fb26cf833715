"""The paper's controller with gains held from the start of a run, or with a slope by the angle."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from afl_mujoco.control.controller import CompiledController, PaperLaw, assumed_as_data
from afl_mujoco.control.gains import Gains, beyond_table, shipped_data
from afl_mujoco.control.law import afl_force
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.plants.plant import Floats
from afl_mujoco.scenario.parameters import CART_MASSES, HALF_LENGTHS, CartPoleParameters, PlantRange

DAMPING = 0.2
"""Exponent by which the slope follows the table: of those tried, the one that most often has a
lower objective than the fixed gains on random schedules (`benchmarks/bench_gain_functions.py`)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldController(PaperLaw):
    """The control law (L1)-(L10) with gains that are chosen at the start of a run.

    ``lambda = lambda_0 (lambda_table(M, l) / lambda_0)^DAMPING`` with M and l as assumed at the
    start; K, Phi and lambda_0 are the fixed gains. Beyond the table the gain of its edge is taken.
    It remembers: only where a run has a start is it defined.
    """

    name: str  # name for reports and files
    fixed: Gains  # the fixed gains
    belief: CartPoleParameters | None = None
    _chosen: list[Gains] | None = field(default=None, repr=False, compare=False)

    @property
    def stateful(self) -> bool:
        """It remembers its gains."""
        return True

    def gains(self, cart_mass: float, half_length: float) -> Gains:
        """Return the gains of a run that starts with M [kg] and l [m]."""
        mass = np.clip(cart_mass, CART_MASSES[0], CART_MASSES[-1])
        slope = _table_slope()((mass, np.clip(half_length, HALF_LENGTHS[0], HALF_LENGTHS[-1])))
        base = self.fixed.slope
        return Gains(
            switching=self.fixed.switching,
            slope=base * float(slope / base) ** DAMPING,
            boundary_layer=self.fixed.boundary_layer,
        )

    def compiled_for(self, plants: PlantRange) -> CompiledController:
        """Raise: no table of gains over M and l is this controller."""
        _need_a_start(self.name)

    def inputs_for(self, values: Floats) -> Floats:
        """Return M, m, l, g along a run and the gains of its first instant, shape (N, 7)."""
        assumed = self.assumed(values)
        g = self.gains(float(assumed[0, 0]), float(assumed[0, 2]))
        gains = np.broadcast_to([g.switching, g.slope, g.boundary_layer], (len(assumed), 3))
        return np.hstack([assumed, gains])

    def remarks(self, plants: PlantRange) -> list[str]:
        """Return where a plant lies beyond the table."""
        return [
            f"Its gains are chosen from a table for {covered}, and {reached} here: a start there "
            "gets those of the edge."
            for covered, reached in beyond_table(plants)
        ]

    def start(self) -> HeldController:
        """Return the controller for one run, which chooses its gains at the first call."""
        return replace(self, _chosen=[])

    def command(self, time: float, state: ArrayLike, assumed: Floats) -> float:
        """Return the force [N], NaN where the controller has none; `assumed` is (M, m, l, g)."""
        if self._chosen is None:
            _need_a_start(self.name)
        if not self._chosen:
            self._chosen.append(self.gains(float(assumed[0]), float(assumed[2])))
        g = self._chosen[0]
        inputs = np.array([[*assumed, g.switching, g.slope, g.boundary_layer]])
        return float(self.forces(np.asarray(state, dtype=np.float64).reshape(1, 4), inputs)[0])

    def describe(self) -> dict[str, Any]:
        """Return the controller as plain data, for provenance."""
        return {
            "name": self.name,
            "fixed": {name: getattr(self.fixed, name) for name in self.fixed.__slots__},
            "damping": DAMPING,
            "belief": assumed_as_data(self.belief),
        }


def _need_a_start(name: str) -> NoReturn:
    """Raise: the controller is asked for something that does not know how its run started."""
    rule = "chooses its gains when a run starts, and is defined only for runs"
    raise InvalidValueError(f"controller {name!r}", rule)


@cache
def _table_slope() -> Any:
    """Return the slope of the shipped table over (M, l), linear between its plants."""
    from scipy.interpolate import RegularGridInterpolator  # a second to import

    table = shipped_data("gain_table.json")
    names = ("cart_mass", "half_length", "slope")
    columns = np.array(table["rows"])[:, [table["columns"].index(name) for name in names]].T
    masses, lengths = np.unique(columns[0]), np.unique(columns[1])
    order = np.lexsort((columns[1], columns[0]))
    slopes = columns[2][order].reshape(len(masses), len(lengths))
    return RegularGridInterpolator((masses, lengths), slopes)


ANGLES = (math.radians(20.0), math.radians(60.0))  # abs(phi) between which ln(lambda) is linear
SLOPES = (5.0, 3.0)  # lambda there at l = LENGTH [1/s]; of `benchmarks/bench_equal_effort.py`
EXPONENT, LENGTH = -0.25, 0.5  # lambda goes with (l / LENGTH)^EXPONENT; l in m
BOX = (1.0, 5.0)  # least and largest lambda [1/s] (decision D8)

_FIXED = shipped_data("gain_functions.json")["fixed"]


def slope_at(angle: float, half_length: float) -> float:
    """Return lambda [1/s] for phi [rad] and the assumed l [m]."""
    (near, far), (fast, slow) = ANGLES, SLOPES
    share = min(max((abs(angle) - near) / (far - near), 0.0), 1.0)
    slope: float = fast * (slow / fast) ** share * (half_length / LENGTH) ** EXPONENT
    return min(max(slope, BOX[0]), BOX[1])


def force(time: float, state: Sequence[float], belief: CartPoleParameters) -> float:
    """Return the force [N] of (L1)-(L10), NaN where it has none, as a controller in Python."""
    p, g = belief, _FIXED
    inputs = (
        *(p.cart_mass, p.pole_mass, p.half_length, p.gravity),
        *(g["switching"], slope_at(state[1], p.half_length), g["boundary_layer"]),
    )
    return float(afl_force(tuple(state), inputs))
