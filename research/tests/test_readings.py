import json
from dataclasses import replace

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.control.gains import GAIN_NAMES
from afl_mujoco.simulation.metrics import metrics
from afl_mujoco.studies.shared.search import Budget
from afl_mujoco.studies.verify.claims import nominal_scales, with_objective
from research import paper, readings
from research.claims import result_of
from research.figures import draw_sensitivity
from research.gain_tuning import GainTable


def test_a_search_is_the_same_again_and_finds_better_than_its_start() -> None:
    unit = ("improvements-d4", 1, 0, Budget(generations=3, population=8))
    first = readings.nearest(unit)
    assert readings.nearest(unit) == first
    values, error, tried = first
    assert tried == 25
    one = np.array([values])
    assert error == pytest.approx(paper.improvement_error(paper.terms_of(one).objectives(one))[0])
    assert paper.HORIZONS[0] <= one[0, paper.HORIZON] <= paper.HORIZONS[1]
    assert not one[0, [paper.SCALE_Z, paper.SCALE_PHI]].any()
    assert readings.nearest(("improvements-d4", 2, 0, unit[3])) != first


def test_our_own_optima_are_optimal_under_their_scales_and_the_papers_are_not(monkeypatch) -> None:
    found = readings.judge_optima(("table2", 20.0, 16, 9))
    assert found.as_decided == 0 and found.best < 40
    assert found.column_error == pytest.approx(0.384, abs=2e-3) and np.isfinite(found.scales).all()
    rows, table = readings.published_rows(), GainTable.shipped()
    for k, (mass, length) in enumerate(rows[:, [4, 5]]):
        gains = table.gains(mass, length)
        rows[k, :3] = gains.switching, gains.slope, gains.boundary_layer
    monkeypatch.setattr(readings, "published_rows", lambda: rows)
    found = readings.judge_optima(("table2", 20.0, 16, 5))
    assert found.as_decided == found.best == 40 and found.median_excess < 1e-3


@pytest.mark.slow
def test_each_case_of_each_named_reading_is_a_scenario_file(tmp_path, monkeypatch, capsys) -> None:
    one, find = [], readings.find_readings
    few = {"restarts": 1, "generations": 2, "population": 4, "draws": 20, "descents": 0}
    tiny = replace(readings.QUICK, **few, samples=50, base=4, slopes=8, steps=3)
    monkeypatch.setattr(readings, "find_readings", lambda *x: one.append(find(*x)) or one[0])
    monkeypatch.setattr(readings, "QUICK", tiny)
    readings.main(["--quick", "--workers", "1", "--out", str(tmp_path)])
    assert "four improvements are within 5 points of Table 3" in capsys.readouterr().out
    found = json.loads((tmp_path / "readings.json").read_text())
    names = [one["name"] for one in found["readings"]]
    assert names == [f"{kind}-{goal}" for kind in ("nearest", "round") for goal in readings.GOALS]
    files = {path.name for path in tmp_path.glob("*.toml")}
    assert files == {f"{name}-{case}.toml" for name in names for case in paper.CASES}
    first = found["readings"][0]
    scenario = afl.load_scenario(tmp_path / f"{first['name']}-{paper.CASES[0]}.toml")
    assert scenario.duration == first["values"]["horizon"]
    run = afl.simulate_ode(scenario, afl.CONTROLLERS["fixed"], sample_period=0.01)
    assert run.outcome.kind == "completed" and draw_sensitivity(found["sensitivity"]["cases"]).axes
    assert one == [find(tiny, 0, workers=2)]  # for any number of workers


def test_improvements_are_those_of_the_simulated_scenarios() -> None:
    one = paper.random_readings(40, 1)[0].copy()
    one[[paper.SCALE_Z, paper.SCALE_PHI, paper.SIGNED]] = 0.0
    found = paper.improvements(paper.terms_of(one[None]).objectives(one[None]))[0]
    scales = nominal_scales(1e-3)
    for case, here in zip(paper.CASES, found, strict=True):
        scenario = paper.scenario_of(one, case, "replayed")
        objectives = []
        for name in ("fixed", "adaptive"):
            function = afl.CONTROLLERS[name].gain_function
            w = function.coefficients[::-1] if one[paper.LABELS] else function.coefficients
            gains = afl.GainFunction(**dict(zip(GAIN_NAMES, w, strict=True)))
            controller = afl.AFLController(name=name, gain_function=gains)
            run = afl.simulate_ode(scenario, controller, sample_period=1e-3)
            figures = with_objective(metrics(scenario, controller, run), scales)
            objectives.append(figures["objective"])
        fixed, adaptive = objectives
        assert here == pytest.approx(100.0 * (1.0 - adaptive / fixed), abs=0.02)


def test_the_papers_own_values_have_no_error_but_table_1s_header() -> None:
    own = 7.0 * paper.PUBLISHED[None]
    assert paper.scaled(own)[0] == pytest.approx(paper.PUBLISHED)
    assert paper.value_error(own)[0] == pytest.approx(0.0, abs=1e-9)
    assert paper.improvement_error(own)[0] < 0.01  # both are printed with four digits
    assert paper.value_error(own * np.array([1.0, 1.1]))[0] > 4.0
    found = {(fit.labels, fit.gain): fit.possible for fit in paper.published_fits()}
    assert not found["table1", "switching"]
    assert all(found["table2", gain] for gain in paper.PUBLISHED_RMSE)


def test_the_result_of_the_site_holds_what_it_says() -> None:
    told = result_of("readings")["readings"]
    rows = np.array([[one["values"][axis.name] for axis in paper.AXES] for one in told])
    here = paper.improvements(paper.terms_of(rows).objectives(rows))
    assert here == pytest.approx(np.array([one["improvements"] for one in told]), abs=1e-6)
    free = next(one for one in told if one["name"] == "nearest-improvements-d4")
    assert np.abs(np.array(free["improvements"]) - paper.PUBLISHED_IMPROVEMENTS).max() < 5.0
