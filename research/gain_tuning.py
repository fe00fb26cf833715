"""The gain table: gains that minimise (O1) on each of the paper's plants, and (G1) fitted to it.

The cost is the objective on the ideal ODE inside the box of decision D8, the search the paper's.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from importlib.resources.abc import Traversable
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from afl_mujoco.control.gains import FIXED_GAINS, GAIN_NAMES, Gains, scheduled_gain, shipped_file
from afl_mujoco.errors import InvalidValueError, UnknownNameError, reading
from afl_mujoco.files import read_json, write_json, write_text
from afl_mujoco.scenario.parameters import NOMINAL
from afl_mujoco.studies.verify.claims import ObjectiveScales
from afl_mujoco.values import require_positive
from research.batch import closed_loop_terms, penalised_objective
from research.genetic import Box, FloatArray, GeneticSettings, minimise, require_seed

HORIZON = 20.0
"""Horizon of the objective [s], decision D4."""

GAIN_BOX = Box(lower=(100.0, 1.0, 90.0), upper=(200.0, 5.0, 110.0))
"""Box of (K, lambda, Phi), decision D8."""

Cost = Callable[[NDArray[np.float64]], NDArray[np.float64]]


@functools.cache
def paper_scales() -> ObjectiveScales:
    """Return the scales of (O1): its terms for the fixed gains on the nominal plant (D4)."""
    gains = [[getattr(FIXED_GAINS, name) for name in GAIN_NAMES]]
    plant = (NOMINAL.cart_mass, NOMINAL.half_length)
    terms = closed_loop_terms(gains, plant, duration=HORIZON)
    return ObjectiveScales(
        iae_z=float(terms.iae_z[0]),
        iae_phi=float(terms.iae_phi[0]),
        max_force=float(terms.max_force[0]),
    )


def gain_cost(cart_mass: float, half_length: float) -> Cost:
    """Return the cost of gains (K, lambda, Phi), shape (N, 3), on one plant."""

    def cost(gains: NDArray[np.float64]) -> NDArray[np.float64]:
        terms = closed_loop_terms(gains, (cart_mass, half_length), duration=HORIZON)
        return penalised_objective(terms, paper_scales(), HORIZON)

    return cost


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
    """Tuned gains by plant."""

    # one row of `COLUMNS` for each plant, shape (N, 7), read-only; the objective in MuJoCo is NaN
    # (``null`` in the file) where the pole fell there
    rows: NDArray[np.float64]
    provenance: Mapping[str, Any]  # how it was made, as plain data

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


_PACKAGES = ("afl_mujoco", "mujoco", "numba", "numpy")


@dataclass(frozen=True, slots=True, kw_only=True)
class PairSearch:
    """One unit of the table: the search on one plant."""

    cart_mass: float  # M [kg] and l [m]
    half_length: float
    settings: GeneticSettings  # settings and box of the search
    box: Box
    seed: tuple[int, int]  # seed of the table, and of the unit within it
    # file that the search writes as it runs and resumes from; ``None`` to write none
    checkpoint: Path | None = None


def pair_searches(
    cart_masses: Sequence[float],
    half_lengths: Sequence[float],
    settings: GeneticSettings,
    seed: int,
    *,
    box: Box = GAIN_BOX,
    checkpoints: Path | None = None,
) -> list[PairSearch]:
    """Return the units of a table, half-lengths first, each seeded by its position."""
    grid = {"cart mass": cart_masses, "half-length": half_lengths}
    for name, values in grid.items():
        if not values:
            raise InvalidValueError(f"{name} of the grid", "must have at least one value")
        for value in values:
            require_positive(f"{name} of the grid", value)
            if list(values).count(value) > 1:
                raise InvalidValueError(f"{name} of the grid", "must differ", f"{value} twice")
    require_seed(seed)
    for gene, bound in zip(GAIN_NAMES, box.lower, strict=True):
        require_positive(f"lower bound of {gene}", bound)
    stiffest = np.array([[box.upper[0], box.upper[1], box.lower[2]]])
    gain_cost(cart_masses[0], min(half_lengths))(stiffest)  # refuses what would never finish
    pairs = [(mass, length) for length in half_lengths for mass in cart_masses]
    return [
        PairSearch(
            cart_mass=mass,
            half_length=length,
            settings=settings,
            box=box,
            seed=(seed, index),
            checkpoint=checkpoints and checkpoints / f"pair-{index:04d}-M{mass:g}-l{length:g}",
        )
        for index, (mass, length) in enumerate(pairs)
    ]


def search_pair(unit: PairSearch) -> list[float]:
    """Run one unit and return its row of the table."""
    found = minimise(
        gain_cost(unit.cart_mass, unit.half_length),
        unit.box,
        unit.settings,
        unit.seed,
        checkpoint=unit.checkpoint,
        resume=unit.checkpoint is not None,
    )
    return [unit.cart_mass, unit.half_length, *found.best.tolist(), found.cost]


def table_provenance(units: Sequence[PairSearch]) -> dict[str, Any]:
    """Return what decides the table, as plain data: grid, settings, box, seed and versions."""
    first = units[0]
    return {
        "cart_masses": list(dict.fromkeys(unit.cart_mass for unit in units)),
        "half_lengths": list(dict.fromkeys(unit.half_length for unit in units)),
        "pole_mass": NOMINAL.pole_mass,
        "gravity": NOMINAL.gravity,
        "horizon": HORIZON,
        "scales": asdict(paper_scales()),
        "settings": asdict(first.settings),
        "box": {"lower": list(first.box.lower), "upper": list(first.box.upper)},
        "seed": first.seed[0],
        "versions": {name: version(name) for name in _PACKAGES},
    }


LARGEST_EXPONENT = 4.0
"""Bound of the exponents w3 and w5; the paper's largest is 3.9393."""

SQUARES = "least squares"
ROUND_OFF = 1e-9
"""Relative spread of a gain below which it counts as constant: the search leaves this much."""

STARTS = 100
"""Number of random starts of the least squares."""

FITS = 2 * len(GAIN_NAMES) + 1
"""Number of fits of a table."""

DAMPED = "damped least squares"
DAMPING = 0.4
"""Exponent of the damped slope, chosen on random schedules of seed 1; C9 uses those of seed 0."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """One fit of (G1)."""

    gain: str  # name of the gain
    method: str  # how the fit was found
    coefficients: tuple[float, ...]  # (w1, ..., w5)
    rmse: float  # root mean square error over the table, Eq. (G2), in the unit of the gain

    def line(self) -> str:
        """Return the fit as one line."""
        w = ", ".join(f"{x:.6g}" for x in self.coefficients)
        return f"{self.gain:<14} {self.method:<21} RMSE {self.rmse:.4g}  w = ({w})"


def rmse(
    coefficients: FloatArray, cart_mass: FloatArray, half_length: FloatArray, gain: FloatArray
) -> FloatArray:
    """Return the error of (G1) over a table, Eq. (G2)."""
    w = coefficients.T[:, :, None]
    with np.errstate(over="ignore", invalid="ignore"):
        fitted = w[0] + w[1] * cart_mass ** w[2] + w[3] * half_length ** w[4]
        error: FloatArray = np.sqrt(np.mean((fitted - gain) ** 2, axis=-1))
    return error


def coefficient_box(gain: FloatArray) -> Box:
    """Return the box in which coefficients of a gain are sought: factors up to twice its size."""
    size, exponent = 2.0 * float(np.abs(gain).max()), LARGEST_EXPONENT
    upper = (size, size, exponent, size, exponent)
    return Box(tuple(-x for x in upper), upper)


def fit_by_search(
    name: str,
    cart_mass: FloatArray,
    half_length: FloatArray,
    gain: FloatArray,
    settings: GeneticSettings,
    seed: int,
) -> Fit:
    """Fit by the paper's genetic algorithm on (G2), as the paper does."""
    found = minimise(
        lambda w: rmse(w, cart_mass, half_length, gain), coefficient_box(gain), settings, seed
    )
    return Fit(gain=name, method="search", coefficients=tuple(found.best.tolist()), rmse=found.cost)


def fit_by_least_squares(
    name: str, cart_mass: FloatArray, half_length: FloatArray, gain: FloatArray, seed: int
) -> Fit:
    """Fit by SciPy's least squares from many starts in the same box, as a check."""
    box = coefficient_box(gain)
    lower, upper = np.array(box.lower), np.array(box.upper)
    rng = np.random.default_rng(seed)

    def residual(w: FloatArray) -> FloatArray:
        return np.asarray(scheduled_gain(cart_mass, half_length, w) - gain)

    constant = np.array([gain.mean(), 0.0, 1.0, 0.0, 1.0])
    flat = float(rmse(constant[None], cart_mass, half_length, gain)[0])
    if flat <= ROUND_OFF * abs(constant[0]):  # nothing to fit
        return Fit(gain=name, method=SQUARES, coefficients=tuple(constant.tolist()), rmse=flat)
    starts = [constant, *(rng.uniform(lower, upper) for _ in range(STARTS))]
    runs = [
        least_squares(residual, start, bounds=(lower, upper), x_scale="jac") for start in starts
    ]
    best = min(runs, key=lambda run: float(run.cost))
    error = float(rmse(best.x[None], cart_mass, half_length, gain)[0])
    return Fit(gain=name, method=SQUARES, coefficients=tuple(best.x.tolist()), rmse=error)


def fit_table(
    table: GainTable,
    seed: int,
    settings: GeneticSettings | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> list[Fit]:
    """Return the fits of every gain: the paper's search, least squares, and the damped slope."""
    plants = table.column("cart_mass"), table.column("half_length")
    slope = damped_slope(table)
    fits: list[Fit] = []
    for place, name in enumerate(GAIN_NAMES):
        gain, searched = table.column(name), settings or GeneticSettings()
        fits.append(fit_by_search(name, *plants, gain, searched, seed + place))
        progress(len(fits))
        fits.append(fit_by_least_squares(name, *plants, gain, seed + place))
        progress(len(fits))
    damped = fit_by_least_squares("slope", *plants, slope, seed)
    progress(FITS)
    return [*fits, replace(damped, method=DAMPED)]


def damped_slope(table: GainTable) -> FloatArray:
    """Return the table's lambda with its ratio to that of the nominal plant damped.

    A schedule changes M and l while the pole is already nearly upright, where the best slope is not
    that of a start from -60 degrees. A gain function that follows the table only to the power
    `DAMPING` loses less there than it gains at the start.
    """
    nominal = table.gains(NOMINAL.cart_mass, NOMINAL.half_length).slope
    damped: FloatArray = nominal * (table.column("slope") / nominal) ** DAMPING
    return damped


def save_fits(path: Path, table: GainTable, fits: Sequence[Fit], seed: int) -> None:
    """Write the fits, and the gains of the retuned controllers made from them, as JSON."""
    chosen = {fit.gain: fit for fit in fits if fit.method != "search"}  # the damped slope is last
    nominal = table.gains(NOMINAL.cart_mass, NOMINAL.half_length)
    content = {
        "source": "make tune: (G1) fitted to the gain table",
        "provenance": {
            "seed": seed,
            "damping": DAMPING,
            "versions": {name: version(name) for name in ("afl_mujoco", "numpy", "scipy")},
            "table": dict(table.provenance),
        },
        "fits": [asdict(fit) for fit in fits],
        "fixed": {name: getattr(nominal, name) for name in GAIN_NAMES},
        "coefficients": {name: list(chosen[name].coefficients) for name in GAIN_NAMES},
    }
    write_text(path, json.dumps(content, indent=1) + "\n")
