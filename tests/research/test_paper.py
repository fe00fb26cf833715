import json
from pathlib import Path

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.control.gains import GAIN_NAMES
from afl_mujoco.simulation.metrics import metrics
from afl_mujoco.studies.verify.claims import nominal_scales, with_objective
from research import paper

RESULT = Path(__file__).parents[2] / "docs" / "results" / "readings.json"


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
    told = json.loads(RESULT.read_text(encoding="utf-8"))["readings"]
    rows = np.array([[one["values"][axis.name] for axis in paper.AXES] for one in told])
    here = paper.improvements(paper.terms_of(rows).objectives(rows))
    assert here == pytest.approx(np.array([one["improvements"] for one in told]), abs=1e-6)
    free = next(one for one in told if one["name"] == "nearest-improvements-d4")
    assert np.abs(np.array(free["improvements"]) - paper.PUBLISHED_IMPROVEMENTS).max() < 5.0
