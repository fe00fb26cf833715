import json

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from afl_mujoco.control.catalogue import CONTROLLERS
from afl_mujoco.control.gains import GAIN_NAMES
from research import gain_tuning
from research.genetic import GeneticSettings

ROW = [1.0, 0.5, 100.0, 3.5, 90.0, 2.1, 2.2]


def test_a_table_comes_back_from_its_file_bit_for_bit(tmp_path) -> None:
    rows = np.array([ROW, [2.0, 0.1, 1 / 3, 0.1, 1e-7, 3.3, 4.4]])
    table = gain_tuning.GainTable(rows, {"seed": 7})
    table.save(tmp_path / "table.json")
    loaded = gain_tuning.GainTable.load(tmp_path / "table.json")
    np.testing.assert_array_equal(loaded.rows, rows)
    assert loaded.provenance == {"seed": 7} and loaded.gains(2.0, 0.1).slope == 0.1


def test_the_shipped_table_is_the_paper_s_grid_confirmed_by_mujoco_and_in_use() -> None:
    table = gain_tuning.GainTable.shipped()
    assert len(table.rows) == 400
    assert sorted(set(table.column("cart_mass"))) == [k / 10 for k in range(1, 21)]
    assert sorted(set(table.column("half_length"))) == [k / 20 for k in range(1, 21)]
    assert {"settings", "box", "seed", "versions"} <= set(table.provenance)
    table = gain_tuning.GainTable.shipped()
    found, said = table.column("objective_mujoco"), table.column("objective")
    np.testing.assert_allclose(found, said, rtol=1e-4)  # 1 ms: a kinked peak may lie between two
    nominal = gain_tuning.GainTable.shipped().gains(1.0, 0.5)
    assert CONTROLLERS["fixed-retuned"].gain_function.gains(0.3, 0.9) == nominal


SMALL = GeneticSettings(population_size=120, generations=40)


def test_a_search_finds_what_a_bounded_scalar_search_finds_on_the_edge_of_the_box() -> None:
    unit = gain_tuning.pair_searches((1.0,), (0.5,), SMALL, seed=0)[0]
    _, _, switching, slope, layer, found = gain_tuning.search_pair(unit)
    cost = gain_tuning.gain_cost(1.0, 0.5)

    def along(x):
        return float(cost(np.array([[100.0, x, 90.0]]))[0])

    best = minimize_scalar(along, bounds=(1.0, 5.0), method="bounded")
    assert (switching, layer) == pytest.approx((100.0, 90.0), abs=1e-6)
    assert slope == pytest.approx(best.x, abs=1e-2)  # the bottom is flat: cost within 1e-6
    assert found == pytest.approx(best.fun, rel=1e-6)


def test_the_shipped_optima_are_not_beaten_along_the_slope() -> None:
    table = gain_tuning.GainTable.shipped()
    slopes = np.linspace(gain_tuning.GAIN_BOX.lower[1], gain_tuning.GAIN_BOX.upper[1], 401)
    for row in table.rows[::37]:
        gains = np.stack([np.full(401, row[2]), slopes, np.full(401, row[4])], axis=1)
        assert gain_tuning.gain_cost(row[0], row[1])(gains).min() > row[5] * (1.0 - 1e-6)


GRID = np.array([(j / 10, k / 20) for j in range(1, 21) for k in range(1, 21)])
MASS, LENGTH = GRID.T
TRUE = np.array([4.0, -0.3, 0.9, -1.5, 0.6])
GAIN = TRUE[0] + TRUE[1] * MASS ** TRUE[2] + TRUE[3] * LENGTH ** TRUE[4]


def table(slope: np.ndarray) -> gain_tuning.GainTable:
    rows = np.stack([MASS, LENGTH, 100 + 0 * MASS, slope, 90 + 0 * MASS, slope, slope], axis=1)
    return gain_tuning.GainTable(rows, {})


def test_the_error_is_the_root_mean_square_of_g2() -> None:
    candidates = np.array([TRUE, TRUE + np.array([0.5, 0.0, 0.0, 0.0, 0.0])])
    assert gain_tuning.rmse(candidates, MASS, LENGTH, GAIN) == pytest.approx([0.0, 0.5], abs=1e-12)


def test_least_squares_recovers_a_gain_function_and_the_paper_s_search_comes_close() -> None:
    fit = gain_tuning.fit_by_least_squares("slope", MASS, LENGTH, GAIN, seed=0)
    assert fit.rmse < 1e-8 and fit.coefficients == pytest.approx(TRUE, rel=1e-3)
    noisy = GAIN + 0.05 * np.sin(40.0 * MASS * LENGTH)
    settings = GeneticSettings(population_size=400, generations=150)
    searched = gain_tuning.fit_by_search("slope", MASS, LENGTH, noisy, settings, seed=0)
    reference = gain_tuning.fit_by_least_squares("slope", MASS, LENGTH, noisy, seed=0)
    assert reference.rmse <= searched.rmse < 1.5 * reference.rmse


@pytest.mark.slow
def test_the_file_has_every_fit_and_what_the_retuned_controllers_use(tmp_path) -> None:
    settings = GeneticSettings(population_size=60, generations=20)
    fits = gain_tuning.fit_table(table(GAIN), seed=0, settings=settings)
    gain_tuning.save_fits(tmp_path / "fits.json", table(GAIN), fits, seed=0)
    content = json.loads((tmp_path / "fits.json").read_text())
    assert {(fit["gain"], fit["method"]) for fit in content["fits"]} == {
        *((name, method) for name in GAIN_NAMES for method in ("search", "least squares")),
        ("slope", gain_tuning.DAMPED),
    }
    nominal = float(GAIN[(MASS == 1.0) & (LENGTH == 0.5)][0])
    assert content["fixed"] == {"switching": 100.0, "slope": nominal, "boundary_layer": 90.0}
    w = np.array([content["coefficients"]["slope"]])
    damped = nominal * (GAIN / nominal) ** gain_tuning.DAMPING
    assert gain_tuning.rmse(w, MASS, LENGTH, damped)[0] < 0.02
