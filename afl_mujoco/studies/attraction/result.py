"""What the study of attraction finds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.simulation.attraction.grid import (
    FOUND,
    OUTCOMES,
    SETTLED,
    AttractionMap,
    Grid,
)
from afl_mujoco.studies.arrays import Array
from afl_mujoco.studies.attraction.comparison import INSIDE, ON_BORDER, Comparison
from afl_mujoco.studies.attraction.deployed import StartMap


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Map:
    """How the rollouts of a map ended, by the equations or in MuJoCo.

    Attributes
    ----------
    shares
        Shares of the grid points by how they ended [1].
    largest_time, largest_peak_z, largest_peak_force
        Largest values over the grid points that settled [s, m, N]; None if none did.
    settings
        Criterion, method and steps.
    outcome, time, peak_z, peak_force
        Values of each grid point, as in `AttractionMap`.
    """

    shares: dict[str, float]
    largest_time: float | None
    largest_peak_z: float | None
    largest_peak_force: float | None
    settings: dict[str, Any]
    outcome: Array
    time: Array
    peak_z: Array
    peak_force: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Disagreement:
    """Numbers of grid points that end differently; a finer grid would move those on a border.

    Attributes
    ----------
    differ, on_border, inside
        Numbers of grid points; the first is the sum of the others.
    ode_to_mujoco
        Numbers of grid points by their outcome by the equations, then in MuJoCo.
    """

    differ: int
    on_border: int
    inside: int
    ode_to_mujoco: dict[str, dict[str, int]]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MapPair:
    """One controller on one grid, by the equations and in MuJoCo.

    Attributes
    ----------
    plane, controller
        Plane of the map, and the controller's name.
    points
        Number of grid points.
    pole_mass, gravity
        m [kg] and g [m/s^2].
    ode, mujoco, disagreement
        The two maps, and how they differ.
    columns, rows, starts, plants
        As in `Grid`.
    """

    plane: str
    controller: str
    points: int
    pole_mass: float
    gravity: float
    ode: Map
    mujoco: Map
    disagreement: Disagreement
    columns: Array
    rows: Array
    starts: Array
    plants: Array

    @property
    def comparison(self) -> Comparison:
        """The two maps, to be drawn."""
        grid = Grid(
            plane=self.plane,
            columns=self.columns,
            rows=self.rows,
            starts=self.starts,
            plants=self.plants,
            pole_mass=self.pole_mass,
            gravity=self.gravity,
        )
        maps = (
            AttractionMap(
                grid=grid,
                controller=self.controller,
                simulator=simulator,
                settings=found.settings,
                **{name: getattr(found, name) for name in FOUND},
            )
            for simulator, found in (("ode", self.ode), ("mujoco", self.mujoco))
        )
        return Comparison(*maps)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Result:
    """Maps of attraction.

    Attributes
    ----------
    maps
        Each controller on each plane, by the equations and in MuJoCo; empty with a scenario.
    starts
        Map of each controller on the scenario, if one was given.
    """

    maps: tuple[MapPair, ...]
    starts: tuple[StartMap, ...] = ()


def result_of(comparisons: Sequence[Comparison]) -> Result:
    """Return comparisons as a result."""
    return Result(maps=tuple(_pair(comparison) for comparison in comparisons))


def _pair(comparison: Comparison) -> MapPair:
    """Return one comparison with its numbers."""
    grid = comparison.ode.grid
    kinds = np.bincount(comparison.disagreement().ravel(), minlength=3).tolist()
    return MapPair(
        plane=grid.plane,
        controller=comparison.ode.controller,
        points=int(comparison.ode.outcome.size),
        pole_mass=grid.pole_mass,
        gravity=grid.gravity,
        ode=_map(comparison.ode),
        mujoco=_map(comparison.mujoco),
        disagreement=Disagreement(
            differ=kinds[ON_BORDER] + kinds[INSIDE],
            on_border=kinds[ON_BORDER],
            inside=kinds[INSIDE],
            ode_to_mujoco={
                ode: dict(zip(OUTCOMES, row, strict=True))
                for ode, row in zip(OUTCOMES, comparison.transitions().tolist(), strict=True)
            },
        ),
        columns=grid.columns,
        rows=grid.rows,
        starts=grid.starts,
        plants=grid.plants,
    )


def _map(found: AttractionMap) -> Map:
    """Return one map with its shares and extremes."""
    settled = found.outcome == SETTLED

    def largest(values: NDArray[np.float64]) -> float | None:
        return float(values[settled].max()) if settled.any() else None

    return Map(
        shares=found.shares(),
        largest_time=largest(found.time),
        largest_peak_z=largest(found.peak_z),
        largest_peak_force=largest(found.peak_force),
        settings=dict(found.settings),
        **{name: getattr(found, name) for name in FOUND},
    )
