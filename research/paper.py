"""What the paper leaves open as unknowns, its Table 3 under each reading, and its Tables 1 and 2.

The paper prints neither the values and times of the schedules nor the horizon and the scales of
the objective, and it contradicts itself on two columns (decisions D2 to D5). A reading is a choice
of all these. Its schedules have the shapes that the paper names: two steps between three levels,
and a trapezoid between two.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from afl_mujoco.control.catalogue import CONTROLLERS, AFLController
from afl_mujoco.control.gains import GainFunction, scheduled_gain
from afl_mujoco.scenario.catalogue import CART_MASS_RANGE, HALF_LENGTH_RANGE
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.schedules import Schedule, staircase, trapezoid
from afl_mujoco.studies.verify.claims import CASES, NEAR, TABLE_3
from research.scheduled import scheduled_terms

__all__ = ["CASES", "NEAR", "TABLE_3"]

Array = NDArray[np.float64]

PUBLISHED = np.array([row[:2] for row in TABLE_3.values()])
PUBLISHED_IMPROVEMENTS = np.array([row[2] for row in TABLE_3.values()])

HORIZONS = (10.0, 30.0)
"""Range of the horizon [s]."""

FACTORS = (-1.0, 1.0)
"""Range of log10 of the factors that multiply the scales of D4 for the integrals of z and phi,
relative to that for the force."""

GAP = 0.01
"""Least time between two changes of a schedule [s]."""

STEP, TRAPEZOID = "step", "trapezoid"
_SHAPES = {STEP: (2, 3), TRAPEZOID: (4, 2)}
"""Numbers of times and of levels."""

_RANGES = {"M": CART_MASS_RANGE, "l": HALF_LENGTH_RANGE}


@dataclass(frozen=True, slots=True)
class Axis:
    """One unknown of a reading; `low` and `high` are its range, [0, 1] for two choices."""

    name: str
    low: float
    high: float
    kind: str


def _axes() -> Iterator[Axis]:
    """Yield the unknowns."""
    for (symbol, levels), (shape, (times, count)) in product(_RANGES.items(), _SHAPES.items()):
        for k in range(times):
            yield Axis(f"{shape} {symbol}, time {k + 1}", 0.0, 1.0, "time")
        for k in range(count):
            yield Axis(f"{shape} {symbol}, level {k + 1}", *levels, kind=symbol)
    yield Axis("horizon", *HORIZONS, kind="horizon")
    yield Axis("scale of ∫|z| dt", *FACTORS, kind="scale")
    yield Axis("scale of ∫|φ| dt", *FACTORS, kind="scale")
    yield Axis("labels of K and Φ", 0.0, 1.0, "choice")
    yield Axis("max F or max |F|", 0.0, 1.0, "choice")


AXES = tuple(_axes())
"""The unknowns, in the order of a point."""

_AT = {axis.name: k for k, axis in enumerate(AXES)}
HORIZON, SCALE_Z, SCALE_PHI = _AT["horizon"], _AT["scale of ∫|z| dt"], _AT["scale of ∫|φ| dt"]
LABELS, SIGNED = _AT["labels of K and Φ"], _AT["max F or max |F|"]


def _columns(symbol: str, shape: str) -> tuple[list[int], list[int]]:
    """Return the columns of the times and of the levels of a schedule."""
    times, levels = _SHAPES[shape]
    first = _AT[f"{shape} {symbol}, time 1"]
    return [*range(first, first + times)], [*range(first + times, first + times + levels)]


SCHEDULES = {key: _columns(*key) for key in product(_RANGES, _SHAPES)}
"""Columns of times and levels, by symbol and shape."""


def readings_at(points: ArrayLike) -> Array:
    """Return the readings at points of the unit cube, shape (N, unknowns).

    A reading has its times in s, increasing and `GAP` apart, levels in kg and m, the horizon in s,
    log10 of the factors of the scales, and 0 or 1: 1 for the labels of Table 1's header (D2), and
    for the largest F with its sign instead of the largest abs(F) (D5).
    """
    u = np.atleast_2d(np.asarray(points, dtype=np.float64))
    low, high = (np.array([getattr(axis, end) for axis in AXES]) for end in ("low", "high"))
    found = low + u * (high - low)
    for times, _ in SCHEDULES.values():
        spare = found[:, HORIZON, None] - GAP * (len(times) + 1)
        gaps = GAP * np.arange(1, len(times) + 1)
        found[:, times] = np.sort(u[:, times], axis=1) * spare + gaps
    found[:, [LABELS, SIGNED]] = u[:, [LABELS, SIGNED]] >= 0.5
    return np.asarray(found)


@dataclass(frozen=True, slots=True, eq=False)
class Terms:
    """The terms of (O1) of readings in the four cases."""

    # integrals of abs(z) and abs(phi) and the largest force, each divided by its scale of D4; shape
    # (N, 4, 2, 3): reading, case, fixed or adaptive gains, term
    values: Array

    def objectives(self, readings: Array) -> Array:
        """Return the objectives, shape (N, 4, 2), up to a common factor."""
        weights = np.ones((len(readings), 3))
        weights[:, :2] = 10.0 ** -readings[:, [SCALE_Z, SCALE_PHI]]
        return np.asarray(np.einsum("ncgt,nt->ncg", self.values, weights))


def terms_of(readings: Array, threads: int = 1) -> Terms:
    """Return the terms of readings; infinite where a loop fell or diverged."""
    count = len(readings)
    knots = {key: _knots(readings, *key) for key in SCHEDULES}
    cases = [(*case.split("-"), gains) for case in CASES for gains in ("fixed", "adaptive")]
    masses = np.stack([knots["M", shape] for shape, _, _ in cases], axis=1)
    lengths = np.stack([knots["l", shape] for _, shape, _ in cases], axis=1)
    named = np.array([_coefficients(gains) for _, _, gains in cases])
    headed = named[:, ::-1]  # K and Phi exchanged, as Table 1's header has them
    coefficients = np.stack([named, headed])[readings[:, LABELS].astype(int)]
    found = scheduled_terms(
        masses.reshape(-1, 4, 2),
        lengths.reshape(-1, 4, 2),
        coefficients.reshape(-1, 3, 5),
        np.repeat(readings[:, HORIZON], len(cases)),
        threads=threads,
    )
    signed = np.repeat(readings[:, SIGNED] > 0.5, len(cases))
    force = np.where(signed, found.max_force, found.peak_force)
    terms = np.stack([found.iae_z, found.iae_phi, force], axis=1) / nominal_terms()
    terms[found.lost] = np.inf
    return Terms(terms.reshape(count, len(CASES), 2, 3))


@cache
def nominal_terms() -> Array:
    """Return the scales of D4: the terms of the fixed gains on the nominal plant over 20 s."""
    plant = [[[0.0, value]] for value in (1.0, 0.5)]
    found = scheduled_terms([plant[0]], [plant[1]], _coefficients("fixed"), [20.0])
    return np.array([found.iae_z[0], found.iae_phi[0], found.peak_force[0]])


def improvements(objectives: Array) -> Array:
    """Return by how much adaptive gains lower the objectives [%], shape (N, 4)."""
    with np.errstate(invalid="ignore"):
        return 100.0 * (1.0 - objectives[..., 1] / objectives[..., 0])


def improvement_error(objectives: Array) -> Array:
    """Return the rms difference from Table 3's improvements [percentage points], shape (N,)."""
    return _rms(improvements(objectives) - PUBLISHED_IMPROVEMENTS, (1,))


def value_error(objectives: Array) -> Array:
    """Return the rms relative difference from Table 3's values [%] at the best common scale."""
    return _rms(100.0 * (scaled(objectives) / PUBLISHED - 1.0), (1, 2))


def scaled(objectives: Array) -> Array:
    """Return objectives with the common factor that brings them nearest to Table 3's values."""
    ratio = objectives / PUBLISHED
    with np.errstate(invalid="ignore"):
        best = ratio.sum(axis=(1, 2)) / (ratio**2).sum(axis=(1, 2))
        return np.asarray(objectives * best[:, None, None])


def both_errors(objectives: Array) -> Array:
    """Return the root of the sum of the squares of both errors."""
    return np.hypot(improvement_error(objectives), value_error(objectives))


def _rms(errors: Array, axes: tuple[int, ...]) -> Array:
    """Return the root mean square over axes; infinite where a run was lost."""
    found = np.sqrt(np.mean(errors**2, axis=axes))
    return np.asarray(np.where(np.isfinite(found), found, np.inf))


def _coefficients(name: str) -> Array:
    """Return the coefficients of (G1) of a controller of the paper."""
    controller = CONTROLLERS[name]
    assert isinstance(controller, AFLController)
    return controller.gain_function.coefficients


def _knots(readings: Array, symbol: str, shape: str) -> Array:
    """Return the knots (time, value) of a schedule, shape (N, 4, 2)."""
    times, levels = SCHEDULES[symbol, shape]
    if shape == STEP:
        (a, b), (p, q, r) = times, levels
        return np.stack([readings[:, [a, a, b, b]], readings[:, [p, q, q, r]]], axis=2)
    low, high = levels
    return np.stack([readings[:, times], readings[:, [low, high, high, low]]], axis=2)


def schedule_of(one: Array, symbol: str, shape: str) -> Schedule:
    """Return a schedule of a reading."""
    times, levels = (one[columns].tolist() for columns in SCHEDULES[symbol, shape])
    if shape == STEP:
        return staircase(times, levels)
    return trapezoid(times, low=levels[0], high=levels[1])


def scenario_of(one: Array, case: str, name: str) -> Scenario:
    """Return a case of a reading as a scenario, named ``name-case``."""
    mass, length = case.split("-")
    return Scenario(
        name=f"{name}-{case}",
        schedule={
            "cart_mass": schedule_of(one, "M", mass),
            "half_length": schedule_of(one, "l", length),
        },
        duration=float(one[HORIZON]),
    )


def random_readings(count: int, seed: int) -> Array:
    """Return readings drawn uniformly."""
    return readings_at(np.random.default_rng(seed).random((count, len(AXES))))


PAIRS = 400
"""Pairs (M, l) of the paper's table, of which it prints 40."""

PUBLISHED_RMSE = {"switching": 0.7862, "slope": 0.1550, "boundary_layer": 6.6458}
"""RMSE of the fits over all pairs, from Table 2."""

OPTIMAL = 1e-2
"""Relative excess over the optimum up to which a published row counts as one."""

COLUMNS = {"table2": (0, 1, 2), "table1": (2, 1, 0)}
"""Columns of Table 1 that hold K, lambda and Phi, by the reading of its header (D2)."""


def published_rows() -> NDArray[np.float64]:
    """Return Table 1 as the paper heads it: (Phi, lambda, K, objective, M, l), shape (40, 6)."""
    file = Path(__file__).parent / "data" / "published_table.json"
    return np.array(json.loads(file.read_text(encoding="utf-8"))["rows"])


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """One published fit beside the rows that are printed."""

    gain: str  # the gain, and the reading of the columns (D2)
    labels: str
    rmse: float  # RMSE of the published function over the printed rows
    least: float  # least RMSE that it can have over all pairs: the others may be met exactly
    published: float  # the RMSE that the paper gives for all pairs

    @property
    def possible(self) -> bool:
        """Whether the published RMSE can be right: it is printed to four decimals."""
        return self.least <= self.published + 5e-5


def published_fits() -> tuple[Fit, ...]:
    """Return the published fits of each gain under each reading of the columns."""
    rows, function = published_rows(), GainFunction.published()
    found = []
    for labels, columns in COLUMNS.items():
        for gain, column in zip(PUBLISHED_RMSE, columns, strict=True):
            values: NDArray[np.float64] = scheduled_gain(
                rows[:, 4], rows[:, 5], getattr(function, gain)
            )
            rmse = float(np.sqrt(np.mean((values - rows[:, column]) ** 2)))
            least = rmse * float(np.sqrt(len(rows) / PAIRS))
            published = PUBLISHED_RMSE[gain]
            found.append(Fit(gain=gain, labels=labels, rmse=rmse, least=least, published=published))
    return tuple(found)
