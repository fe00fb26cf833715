"""The gain function (G1) fitted to a table of gains, by the paper's search and least squares."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from afl_mujoco.control.gain_function import GAIN_NAMES, scheduled_gain
from afl_mujoco.control.gain_table import GainTable
from afl_mujoco.files import write_text
from afl_mujoco.scenario.parameters import NOMINAL
from afl_mujoco.studies.gain_tuning.genetic import minimise
from afl_mujoco.studies.gain_tuning.settings import Box, GeneticSettings

FloatArray = NDArray[np.float64]

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
    """One fit of (G1).

    Attributes
    ----------
    gain
        Name of the gain.
    method
        How the fit was found.
    coefficients
        (w1, ..., w5).
    rmse
        Root mean square error over the table, Eq. (G2), in the unit of the gain.
    """

    gain: str
    method: str
    coefficients: tuple[float, ...]
    rmse: float

    def line(self) -> str:
        """Return the fit as one line."""
        w = ", ".join(f"{x:.6g}" for x in self.coefficients)
        return f"{self.gain:<14} {self.method:<21} RMSE {self.rmse:.4g}  w = ({w})"


def rmse(
    coefficients: FloatArray, cart_mass: FloatArray, half_length: FloatArray, gain: FloatArray
) -> FloatArray:
    """Return the error of (G1) over a table, Eq. (G2).

    Parameters
    ----------
    coefficients
        (w1, ..., w5) of each candidate, shape (P, 5).
    cart_mass, half_length, gain
        The table, shape (N,) each.
    """
    w = coefficients.T[:, :, None]
    with np.errstate(over="ignore", invalid="ignore"):
        fitted = w[0] + w[1] * cart_mass ** w[2] + w[3] * half_length ** w[4]
        error: FloatArray = np.sqrt(np.mean((fitted - gain) ** 2, axis=-1))
    return error


def coefficient_box(gain: FloatArray) -> Box:
    """Return the box in which the coefficients of a gain are sought: factors up to twice its size.

    Parameters
    ----------
    gain
        Its column of the table, shape (N,).
    """
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
    """Fit by the paper's genetic algorithm on (G2), as the paper does.

    Parameters
    ----------
    cart_mass, half_length, gain
        The table, shape (N,) each.
    """
    found = minimise(
        lambda w: rmse(w, cart_mass, half_length, gain), coefficient_box(gain), settings, seed
    )
    return Fit(gain=name, method="search", coefficients=tuple(found.best.tolist()), rmse=found.cost)


def fit_by_least_squares(
    name: str, cart_mass: FloatArray, half_length: FloatArray, gain: FloatArray, seed: int
) -> Fit:
    """Fit by SciPy's least squares from many starts in the same box, as a check.

    Parameters
    ----------
    cart_mass, half_length, gain
        The table, shape (N,) each.
    """
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
    """Return the fits of every gain: the paper's search, least squares, and the damped slope.

    Parameters
    ----------
    settings
        Settings of the searches; the paper's by default.
    """
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
        "source": "afl-mujoco tune fit: (G1) fitted to the gain table",
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
