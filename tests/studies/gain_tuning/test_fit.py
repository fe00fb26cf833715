"""The fits of (G1): what was put in comes out."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from afl_mujoco.control.gain_function import GAIN_NAMES
from afl_mujoco.control.gain_table import GainTable
from afl_mujoco.studies.gain_tuning.fit import (
    DAMPED,
    DAMPING,
    coefficient_box,
    fit_by_least_squares,
    fit_by_search,
    fit_table,
    rmse,
    save_fits,
)
from afl_mujoco.studies.gain_tuning.settings import GeneticSettings

GRID = np.array([(j / 10, k / 20) for j in range(1, 21) for k in range(1, 21)])
MASS, LENGTH = GRID.T
TRUE = np.array([4.0, -0.3, 0.9, -1.5, 0.6])
GAIN = TRUE[0] + TRUE[1] * MASS ** TRUE[2] + TRUE[3] * LENGTH ** TRUE[4]


def table(slope: np.ndarray) -> GainTable:
    rows = np.stack([MASS, LENGTH, 100 + 0 * MASS, slope, 90 + 0 * MASS, slope, slope], axis=1)
    return GainTable(rows, {})


def test_the_error_is_the_root_mean_square_of_g2() -> None:
    candidates = np.array([TRUE, TRUE + np.array([0.5, 0.0, 0.0, 0.0, 0.0])])
    assert rmse(candidates, MASS, LENGTH, GAIN) == pytest.approx([0.0, 0.5], abs=1e-12)


def test_least_squares_recovers_a_gain_function() -> None:
    fit = fit_by_least_squares("slope", MASS, LENGTH, GAIN, seed=0)
    assert fit.rmse < 1e-8
    assert fit.coefficients == pytest.approx(TRUE, rel=1e-3)


def test_the_paper_s_search_comes_close_and_never_beats_least_squares() -> None:
    noisy = GAIN + 0.05 * np.sin(40.0 * MASS * LENGTH)
    settings = GeneticSettings(population_size=400, generations=150)
    searched = fit_by_search("slope", MASS, LENGTH, noisy, settings, seed=0)
    reference = fit_by_least_squares("slope", MASS, LENGTH, noisy, seed=0)
    assert reference.rmse <= searched.rmse < 1.5 * reference.rmse


def test_a_constant_gain_is_fitted_by_its_constant() -> None:
    fit = fit_by_least_squares("switching", MASS, LENGTH, np.full(400, 100.0), seed=0)
    assert fit.coefficients[0] == pytest.approx(100.0, rel=1e-12)
    assert (fit.coefficients[1], fit.coefficients[3]) == (0.0, 0.0)


def test_the_box_holds_the_paper_s_coefficients_of_lambda() -> None:
    box = coefficient_box(np.array([1.0, 5.0]))
    published = (5.3627, -6.2571, -0.0328, 1.8963, -0.2129)
    assert all(a <= w <= b for a, w, b in zip(box.lower, published, box.upper, strict=True))


@pytest.mark.slow
def test_the_file_has_every_fit_and_what_the_retuned_controllers_use(tmp_path: Path) -> None:
    settings = GeneticSettings(population_size=60, generations=20)
    fits = fit_table(table(GAIN), seed=0, settings=settings)
    save_fits(tmp_path / "fits.json", table(GAIN), fits, seed=0)
    content = json.loads((tmp_path / "fits.json").read_text())
    assert {(fit["gain"], fit["method"]) for fit in content["fits"]} == {
        *((name, method) for name in GAIN_NAMES for method in ("search", "least squares")),
        ("slope", DAMPED),
    }
    nominal = float(GAIN[(MASS == 1.0) & (LENGTH == 0.5)][0])
    assert content["fixed"] == {"switching": 100.0, "slope": nominal, "boundary_layer": 90.0}
    w = np.array([content["coefficients"]["slope"]])
    damped = nominal * (GAIN / nominal) ** DAMPING
    assert rmse(w, MASS, LENGTH, damped)[0] < 0.02
