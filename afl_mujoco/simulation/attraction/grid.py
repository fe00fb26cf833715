"""The grid of a map of attraction and its outcomes, shared by the equations and MuJoCo."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from afl_mujoco.compiled import borrowing_kernel
from afl_mujoco.errors import InvalidValueError, require_count
from afl_mujoco.scenario.parameters import LARGEST_STATE, NOMINAL, require_finite, require_positive

SETTLED, FALLEN, UNDECIDED = range(3)
OUTCOMES = ("settled", "fallen", "undecided")
"""How a rollout ends, by its code. Fallen: ``|phi|`` has reached `FALL_ANGLE`, or a state or a
force is beyond `STATE_LIMIT` or not a number. Undecided: neither fallen nor settled by the
horizon."""

STATES, PLANTS = "states", "plants"
PLANES = (STATES, PLANTS)
"""What a map is drawn over: (phi0, phi0') on one plant, or (M, l) from one start."""

MAX_ANGLE, MAX_RATE = 1.55, 10.0
"""Edges of the map over states [rad, rad/s]."""

MASSES, LENGTHS = (0.1, 2.0), (0.05, 1.0)
"""Edges of the map over plants [kg, m]: the paper's grid."""

MOST_POINTS = 1001
"""Most grid points along an axis."""

START = (0.0, -math.pi / 3.0, 0.0, 0.0)
"""Initial state of the map over plants: that of the paper."""

FOUND = ("outcome", "time", "peak_z", "peak_force")
"""Results for each grid point, in this order."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Settling:
    """When a rollout counts as settled: every state within its band for a stretch of time.

    The bands are a box about upright in the whole state space. From each of its corners every
    controller of the package converges on every plant of the paper's grid, so that a state within
    it decides the outcome. By default the stretch is as long as the fastest cart within the bands
    takes to cross its position band: a cart that only passes through does not count.

    Attributes
    ----------
    bands
        Largest ``|z|``, ``|phi|``, ``|z'|``, ``|phi'|`` [m, rad, m/s, rad/s].
    dwell
        How long all four states must stay within their bands [s].
    horizon
        When a rollout that has neither settled nor fallen ends as undecided [s].

    Raises
    ------
    InvalidValueError
        If a value breaks its rule.
    """

    bands: tuple[float, float, float, float] = (0.1, 0.05, 0.2, 0.2)
    dwell: float = 1.0
    horizon: float = 20.0

    def __post_init__(self) -> None:
        """Validate every field."""
        if len(self.bands) != 4:
            raise InvalidValueError("bands", "must be four", len(self.bands))
        for band in self.bands:
            require_positive("bands", band)
        require_positive("dwell", self.dwell)
        require_positive("horizon", self.horizon)
        if self.dwell > self.horizon:
            raise InvalidValueError("dwell", f"must be within {self.horizon:g} s", self.dwell)

    def describe(self) -> dict[str, Any]:
        """Return the criterion as plain data."""
        return {"bands": list(self.bands), "dwell": self.dwell, "horizon": self.horizon}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Grid:
    """A rectangle of rollouts: where each starts, and on which plant.

    Attributes
    ----------
    plane
        One of `PLANES`.
    columns, rows
        Coordinates of the grid points: phi0 [rad] and phi0' [rad/s], or M [kg] and l [m].
    starts
        Initial (z, phi, z_dot, phi_dot) of each grid point, row by row, shape (N, 4).
    plants
        (M, l) [kg, m] of each grid point, shape (N, 2).
    pole_mass, gravity
        m [kg] and g [m/s^2].
    """

    plane: str
    columns: NDArray[np.float64]
    rows: NDArray[np.float64]
    starts: NDArray[np.float64]
    plants: NDArray[np.float64]
    pole_mass: float = NOMINAL.pole_mass
    gravity: float = NOMINAL.gravity

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of rows and columns."""
        return len(self.rows), len(self.columns)


def axis(name: str, low: float, high: float, count: int) -> NDArray[np.float64]:
    """Return evenly spaced coordinates, antisymmetric to the bit if the limits are +-x."""
    require_count("grid", count, 2, MOST_POINTS)
    if not require_finite(name, low) < require_finite(name, high):
        raise InvalidValueError(name, f"must exceed its low end {low:g}", f"{high:g}")
    if max(abs(low), abs(high)) > LARGEST_STATE:
        raise InvalidValueError(name, f"must be at most {LARGEST_STATE:g}", max(low, high))
    from_middle = np.arange(count) - 0.5 * (count - 1)
    return np.asarray(0.5 * (low + high) + from_middle * ((high - low) / (count - 1)))


def state_grid(
    angles: ArrayLike,
    rates: ArrayLike,
    *,
    cart_mass: float = NOMINAL.cart_mass,
    half_length: float = NOMINAL.half_length,
) -> Grid:
    """Return the map over (phi0, phi0') from z = z' = 0 on one plant.

    Parameters
    ----------
    angles, rates
        phi0 [rad] and phi0' [rad/s].
    cart_mass, half_length
        M [kg] and l [m].
    """
    columns, rows = _coordinates("phi0", angles), _coordinates("phi0'", rates)
    phi, phi_dot = (grid.ravel() for grid in np.meshgrid(columns, rows))
    starts, plants = np.zeros((len(phi), 4)), np.empty((len(phi), 2))
    starts[:, 1], starts[:, 3] = phi, phi_dot
    plants[:, 0] = require_positive("cart_mass", cart_mass)
    plants[:, 1] = require_positive("half_length", half_length)
    return Grid(plane=STATES, columns=columns, rows=rows, starts=starts, plants=plants)


def plant_grid(
    masses: ArrayLike,
    lengths: ArrayLike,
    *,
    start: tuple[float, float, float, float] = START,
) -> Grid:
    """Return the map over (M, l) from one start.

    Parameters
    ----------
    masses, lengths
        M [kg] and l [m].
    start
        (z, phi, z_dot, phi_dot) [m, rad, m/s, rad/s].
    """
    columns, rows = _coordinates("cart_mass", masses), _coordinates("half_length", lengths)
    for name, values in (("cart_mass", columns), ("half_length", rows)):
        require_positive(name, float(values.min()))
    starts = np.empty((len(columns) * len(rows), 4))
    starts[:] = [require_finite("start", x) for x in start]
    plants = np.stack([grid.ravel() for grid in np.meshgrid(columns, rows)], axis=1)
    return Grid(plane=PLANTS, columns=columns, rows=rows, starts=starts, plants=plants)


def _coordinates(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """Return the coordinates of grid points, or raise."""
    array = np.array(values, dtype=np.float64)
    if array.ndim != 1 or not array.size or not np.isfinite(array).all():
        raise InvalidValueError(name, "must be a row of finite numbers", array.shape)
    return array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AttractionMap:
    """How each rollout of a rectangle ended.

    Attributes
    ----------
    grid
        What was simulated.
    controller, simulator
        Name of the controller; ``"ode"`` or ``"mujoco"``.
    outcome
        Index into `OUTCOMES`, shape (rows, columns), uint8.
    time
        Time of the outcome [s]: the fall, the end of the stretch within the bands, the horizon.
    peak_z, peak_force
        Largest ``|z|`` [m] and ``|F|`` [N] up to then.
    settings
        Criterion, method and steps, as plain data.
    """

    grid: Grid
    controller: str
    simulator: str
    outcome: NDArray[np.uint8]
    time: NDArray[np.float64]
    peak_z: NDArray[np.float64]
    peak_force: NDArray[np.float64]
    settings: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        grid: Grid,
        controller: str,
        simulator: str,
        settings: Mapping[str, Any],
        found: NDArray[np.float64],
    ) -> AttractionMap:
        """Make a map from the results of its rollouts, shape (N, 4), with columns as in `FOUND`."""
        outcome, *rest = (column.reshape(grid.shape) for column in found.T)
        arrays = dict(zip(FOUND[1:], rest, strict=True))
        return cls(
            grid=grid,
            controller=controller,
            simulator=simulator,
            outcome=outcome.astype(np.uint8),
            settings=dict(settings),
            **arrays,
        )

    def shares(self) -> dict[str, float]:
        """Return the share of the grid points that ended each way."""
        counts = np.bincount(self.outcome.ravel(), minlength=len(OUTCOMES))
        return {name: float(n / counts.sum()) for name, n in zip(OUTCOMES, counts, strict=True)}


@borrowing_kernel
def within(state, bands):
    """Return whether every state is within its band."""
    for i in range(4):
        if not abs(state[i]) <= bands[i]:
            return False
    return True
