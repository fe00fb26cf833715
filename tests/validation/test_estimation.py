"""How well M and l are estimated: the figures of merit by hand, and the study's own run."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.cli.main import main
from afl_mujoco.errors import InvalidValueError, UnknownNameError
from afl_mujoco.reporting.survival.estimation_figures import draw_estimation
from afl_mujoco.scenario.realism import Realism
from afl_mujoco.validation.estimation.study import describe, study_estimation
from afl_mujoco.validation.estimation.tracking import tracking

TIME = np.arange(0, 10_001) * 1e-3


def test_a_perfect_estimate_has_no_error_and_finds_a_step_at_once():
    truth = afl.staircase((1.0,), (0.5, 1.0))
    found = tracking(truth, TIME, truth(TIME))
    assert found.rms == {"0.05-1 s": 0.0, "1-6 s": 0.0, "6 s to the end": 0.0}
    (step,) = found.steps
    assert (step.at, step.reached_after, step.found_after) == (1.0, 0.0, 0.0)
    assert found.ramps == ()


def test_a_step_is_reached_first_and_found_for_good_later():
    truth = afl.staircase((1.0, 3.0), (0.5, 1.0, 2.0))
    estimate = truth(TIME).copy()
    estimate[1000:1200] = 0.5  # late
    estimate[1500:1700] = 1.2  # and lost again
    estimate[3000:] = 1.0  # never
    one, two = tracking(truth, TIME, estimate).steps
    assert (one.reached_after, one.found_after) == (pytest.approx(0.2), pytest.approx(0.7))
    assert (two.reached_after, two.found_after) == (None, None)


def test_a_delayed_ramp_lags_by_its_delay_up_and_down():
    truth = afl.trapezoid((0.0, 2.0, 6.0, 8.0), low=0.2, high=1.0)
    estimate = truth(np.maximum(TIME - 0.05, 0.0))
    found = tracking(truth, TIME, estimate)
    up, down = found.ramps
    assert found.steps == ()  # a ramp that ends a rounding off its plateau is no step
    assert (up.start, up.end, down.start, down.end) == (0.0, 2.0, 6.0, 8.0)
    assert up.lag == pytest.approx(0.05)
    assert down.lag == pytest.approx(0.05)


def test_the_error_is_that_of_the_logarithm_in_each_window():
    truth = afl.constant(2.0)
    estimate = np.where(TIME < 6.0, 2.2, 1.0)
    found = tracking(truth, TIME, estimate)
    assert found.rms["0.05-1 s"] == pytest.approx(math.log(1.1))
    assert found.rms["6 s to the end"] == pytest.approx(math.log(2.0))
    assert tracking(truth, TIME[:500], estimate[:500]).rms["1-6 s"] is None


@pytest.fixture(scope="module")
def study():
    return study_estimation(cases=("step-step",), seeds=3)


def test_the_estimated_loop_is_as_good_as_the_one_that_is_told(study):
    (case,) = study
    loops = {(loop.told, loop.noise): loop for loop in case.loops}
    assert {loop.completed for loop in loops.values()} == {1, 3}
    truth, estimated = loops["truth", False], loops["estimator", True]
    nominal = loops["nominal plant", False]
    assert estimated.runs == 3
    for name in ("iae_z", "iae_phi"):  # what it is worth: the nominal belief costs far more
        assert estimated.figures[name] < 1.15 * truth.figures[name]
        assert estimated.figures[name] < nominal.figures[name]


def test_a_noisy_loop_is_the_median_of_its_own_runs_and_its_largest_force_their_largest(study):
    (case,) = study
    (loop,) = (loop for loop in case.loops if (loop.told, loop.noise) == ("truth", True))
    noises = [Realism(noise_z=1e-4, noise_phi=5e-4, seed=seed) for seed in range(3)]
    noisy = [replace(afl.SCENARIOS["step-step"], realism=noise) for noise in noises]
    adaptive = afl.CONTROLLERS["adaptive"]
    runs = [afl.simulate_mujoco(one, adaptive, "sampled") for one in noisy]
    peaks = sorted(float(np.abs(run.force).max()) for run in runs)
    assert peaks[0] < peaks[1] < peaks[2]
    assert loop.figures["max_force"] == pytest.approx(peaks[1])
    assert loop.largest_force == pytest.approx(peaks[2])


def test_the_study_has_no_run_that_saw_the_truth_by_mistake(study):
    (case,) = study
    assert case.estimated.run.provenance["controller"]["belief"] == "estimated"
    assert case.oracle.provenance["controller"]["belief"] == "true"
    first, second, _ = case.cart_mass
    assert first.rms != second.rms  # another noise
    for one in (*case.cart_mass, *case.half_length):
        assert 0.0 < one.rms["0.05-1 s"] < 0.1
        assert all(step.reached_after is not None for step in one.steps)


def test_it_is_plain_data_and_a_figure_with_words(study):
    data = json.loads(json.dumps(describe(study), allow_nan=False))
    assert data["noise"] == {"z": 1e-4, "phi": 5e-4}
    assert [case["scenario"] for case in data["cases"]] == ["step-step"]
    drawn = draw_estimation(study)
    assert "stepped at 1 s is first within 10 %" in drawn.alt
    assert "nan" not in drawn.alt


@pytest.mark.parametrize(
    ("settings", "error", "said"),
    [
        ({"seeds": 0}, InvalidValueError, "seeds must be at least 1, got 0"),
        ({"cases": ("steps",)}, UnknownNameError, "scenario must be one of nominal, step-step, "),
        ({"controller": "pid"}, UnknownNameError, "controller must be one of fixed, adaptive, "),
    ],
    ids=["seeds", "scenario", "controller"],
)
def test_what_cannot_be_studied_is_refused(settings, error, said):
    with pytest.raises(error) as caught:
        study_estimation(**settings)
    assert str(caught.value).startswith(said)


def test_the_command_writes_study_and_figure(tmp_path, capsys):
    rest = ["--out", str(tmp_path / "out"), "--validation", str(tmp_path)]
    assert main(["estimation", "step-step", "--seeds", "1", *rest]) == 0
    data = json.loads((tmp_path / "out" / "estimation.json").read_text())
    assert (data["study"], data["controller"]) == ("estimation", "adaptive")
    assert data["command"] == "afl-mujoco estimation step-step --seeds 1"
    assert {path.suffix for path in (tmp_path / "out").iterdir()} == {".json", ".svg", ".png"}
