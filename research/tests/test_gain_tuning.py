import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from afl_mujoco.control.catalogue import CONTROLLERS
from research import gain_tuning, tune
from research.command import run_command
from research.genetic import GeneticSettings
from tests.program import interrupt


def test_the_shipped_table_is_the_paper_s_grid_confirmed_by_mujoco_and_in_use() -> None:
    table = gain_tuning.GainTable.shipped()
    assert len(table.rows) == 400
    assert sorted(set(table.column("cart_mass"))) == [k / 10 for k in range(1, 21)]
    assert sorted(set(table.column("half_length"))) == [k / 20 for k in range(1, 21)]
    assert {"settings", "box", "seed", "versions"} <= set(table.provenance)
    found, said = table.column("objective_mujoco"), table.column("objective")
    np.testing.assert_allclose(found, said, rtol=1e-4)  # 1 ms: a kinked peak may lie between two
    assert CONTROLLERS["fixed-retuned"].gain_function.gains(0.3, 0.9) == table.gains(1.0, 0.5)


def test_a_search_finds_what_a_bounded_scalar_search_finds_on_the_edge_of_the_box() -> None:
    small = GeneticSettings(population_size=120, generations=40)
    unit = gain_tuning.pair_searches((1.0,), (0.5,), small, seed=0)[0]
    _, _, switching, slope, layer, found = gain_tuning.search_pair(unit)
    cost = gain_tuning.gain_cost(1.0, 0.5)
    how = {"bounds": (1.0, 5.0), "method": "bounded"}
    best = minimize_scalar(lambda x: cost(np.array([[100.0, x, 90.0]])).item(), **how)
    assert (switching, layer) == pytest.approx((100.0, 90.0), abs=1e-6)
    assert slope == pytest.approx(best.x, abs=1e-2)  # the bottom is flat: cost within 1e-6
    assert found == pytest.approx(best.fun, rel=1e-6)


def test_least_squares_recovers_a_gain_function_and_the_paper_s_search_comes_close() -> None:
    at = np.array([(j / 10, k / 20) for j in range(1, 21) for k in range(1, 21)]).T
    true = np.array([4.0, -0.3, 0.9, -1.5, 0.6])
    gain = true[0] + true[1] * at[0] ** true[2] + true[3] * at[1] ** true[4]
    fit = gain_tuning.fit_by_least_squares("slope", *at, gain, seed=0)
    assert fit.rmse < 1e-8 and fit.coefficients == pytest.approx(true, rel=1e-3)
    noisy = gain + 0.05 * np.sin(40.0 * at[0] * at[1])
    settings = GeneticSettings(population_size=400, generations=150)
    searched = gain_tuning.fit_by_search("slope", *at, noisy, settings, seed=0)
    reference = gain_tuning.fit_by_least_squares("slope", *at, noisy, seed=0)
    assert reference.rmse <= searched.rmse < 1.5 * reference.rmse


ROOT = Path(__file__).parents[2]
SMALL = "--cart-masses 0.5 1.0 --half-lengths 0.5 --population 60 --workers 1".split()


def refused(capsys: pytest.CaptureFixture[str], message: str, *arguments: str) -> None:
    with pytest.raises(SystemExit) as end:
        run_command(lambda: tune.main(arguments))
    said = capsys.readouterr()
    assert (end.value.code, said.out) == (2, "") and message in said.err
    assert len(said.err.splitlines()) == 1


@pytest.mark.slow
def test_an_interrupted_table_goes_on_to_the_same_bytes(tmp_path: Path, capsys) -> None:
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    table = (*SMALL, "--generations", "1500")
    tune.main((*table, "--out", str(whole)))
    interrupt(
        *table, "--out", str(broken), cwd=ROOT, command=(sys.executable, "-m", "research.tune"),
        name="research", once=lambda: list((broken / "searches" / "checkpoints").glob("*")),
    )  # fmt: skip
    assert not (broken / "gain_table.json").exists()

    capsys.readouterr()
    refused(capsys, "has a search: pass --resume to continue it", *table, "--out", str(broken))
    other = (*SMALL, "--generations", "1501", "--resume", "--out", str(whole))
    refused(capsys, "settings.generations is 1500 there and 1501 here", *other)
    tune.main((*table, "--resume", "--out", str(broken)))
    one, other_one = (folder / "gain_table.json" for folder in (whole, broken))
    assert one.read_bytes() == other_one.read_bytes()
    assert len(gain_tuning.GainTable.load(one).rows) == 2


@pytest.mark.parametrize(("arguments", "message"), [
    (("--lower", "100", "5", "90", "--upper", "200", "1", "110"), "not be below lower 5.0"),
    (("--cart-masses",), "cart mass of the grid must have at least one value"),
    (("--upper", "1e12", "5", "110"), "would take as many steps"),
    (("--population", "x"), "make tune cannot take that: argument --population: invalid int"),
])  # fmt: skip
def test_bad_input_is_one_line(capsys, arguments: tuple[str, ...], message: str) -> None:
    refused(capsys, message, *arguments)
