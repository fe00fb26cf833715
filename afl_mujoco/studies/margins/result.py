"""What the study of margins finds."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.errors import UnknownNameError
from afl_mujoco.studies.loop_margins import Margins
from afl_mujoco.studies.margins.measured_delay import DelayComparison
from afl_mujoco.studies.margins.small_motions import SmallMotions

METRICS = tuple(field.name for field in fields(Margins))
"""The margins, in their order."""

GROWS_WORSE = ("gain_decrease", "crossover")
"""The margins whose largest value is the worst."""

Grid = tuple[tuple[float | None, ...], ...]
"""A margin by cart mass and half-length; None where it is infinite, or the loop is not stable."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopGrid:
    """Margins of one loop over the plants, as in `Margins`.

    Attributes
    ----------
    stable
        Whether the loop is stable, by cart mass and half-length.
    gain_decrease, gain_increase, disk, disk_gain
        Factors and disk size [1].
    phase, disk_phase
        Angles [deg].
    delay
        Delay [s].
    crossover
        Frequency [rad/s].
    """

    stable: tuple[tuple[bool, ...], ...]
    gain_decrease: Grid
    gain_increase: Grid
    phase: Grid
    delay: Grid
    crossover: Grid
    disk: Grid
    disk_gain: Grid
    disk_phase: Grid

    @property
    def unstable(self) -> int:
        """Number of plants on which the loop is not stable."""
        return sum(not flag for row in self.stable for flag in row)


@dataclass(frozen=True, slots=True, kw_only=True)
class ControllerMargins:
    """Margins of the continuous and of the sampled controller."""

    continuous: LoopGrid
    sampled: LoopGrid


@dataclass(frozen=True, slots=True)
class Worst:
    """The worst value of a margin on the grid, and its plant, M [kg] and l [m]."""

    value: float
    cart_mass: float
    half_length: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """Margins by controller and plant.

    Attributes
    ----------
    control_period
        How long the sampled loop holds its force [s].
    cart_masses, half_lengths
        The grid, M [kg] and l [m].
    pole_mass, gravity
        m [kg] and g [m/s^2].
    imperfections
        Those of the linear loop, by their keys; "none" for the ideal loop.
    linearisation_step
        Step of the central differences [m, rad, m/s, rad/s, N].
    margins
        The margins by controller.
    measured
        Margin and measurement on some of the plants; empty if none was measured.
    scenario, left_out
        Name of the scenario, if any; and its imperfections that are not modelled.
    not_linear
        Why each of the other controllers has no linear margins, by its name.
    small_motions
        What small motions of those controllers tolerate on some of the plants.
    """

    control_period: float
    cart_masses: tuple[float, ...]
    half_lengths: tuple[float, ...]
    pole_mass: float
    gravity: float
    imperfections: str
    linearisation_step: float
    margins: dict[str, ControllerMargins]
    measured: tuple[DelayComparison, ...] = ()
    scenario: str | None = None
    left_out: tuple[str, ...] = ()
    not_linear: dict[str, str] = field(default_factory=dict)
    small_motions: tuple[SmallMotions, ...] = ()

    @property
    def plants(self) -> int:
        """Number of plants."""
        return len(self.cart_masses) * len(self.half_lengths)

    def grid(self, controller: str, *, sampled: bool = False) -> LoopGrid:
        """Return the margins of one controller, by its name."""
        if controller not in self.margins:
            raise UnknownNameError.among("controller", controller, self.margins)
        found = self.margins[controller]
        return found.sampled if sampled else found.continuous

    def values(self, controller: str, metric: str, *, sampled: bool = False) -> NDArray[np.float64]:
        """Return one of `METRICS`, shape (masses, lengths); NaN where the loop is not stable."""
        grid = self.grid(controller, sampled=sampled)
        if metric not in METRICS:
            raise UnknownNameError.among("margin", metric, METRICS)
        rows = [[math.inf if x is None else x for x in row] for row in getattr(grid, metric)]
        return np.where(np.array(grid.stable), np.array(rows, dtype=np.float64), np.nan)

    def worst(self, controller: str, metric: str, *, sampled: bool = False) -> Worst | None:
        """Return the worst value of a margin over the stable plants; None if there is none."""
        values = self.values(controller, metric, sampled=sampled)
        if np.isnan(values).all():
            return None
        pick = np.nanargmax if metric in GROWS_WORSE else np.nanargmin
        row, column = np.unravel_index(int(pick(values)), values.shape)
        plant = self.cart_masses[row], self.half_lengths[column]
        return Worst(float(values[row, column]), *plant)
