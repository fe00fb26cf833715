"""How well M and l are estimated: the figures of merit by hand, and the study's own run."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.errors import InvalidValueError, UnknownNameError
from afl_mujoco.report.old import figures_of
from afl_mujoco.scenario.imperfections import Imperfections
from afl_mujoco.studies.estimation.loops import (
    ESTIMATED,
    NOMINAL,
    TRUE,
    Runs,
    Unit,
    require_study,
    run_case,
)
from afl_mujoco.studies.estimation.result import UNTIL, case_of, result_of
from afl_mujoco.studies.estimation.sections import sections
from afl_mujoco.studies.estimation.tracking import tracking

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
def case() -> Runs:
    return run_case(Unit("step-step", "adaptive", seeds=3))


def test_the_estimated_loop_is_as_good_as_the_one_with_the_true_parameters(case):
    loops = {(loop.parameters, loop.noise): loop for loop in case.loops}
    assert {loop.completed for loop in loops.values()} == {1, 3}
    true, estimated = loops[TRUE, False], loops[ESTIMATED, True]
    nominal = loops[NOMINAL, False]
    assert estimated.runs == 3
    for name in ("iae_z", "iae_phi"):  # what it is worth: the nominal parameters cost far more
        assert estimated.metrics[name] < 1.15 * true.metrics[name]
        assert estimated.metrics[name] < nominal.metrics[name]


def test_a_noisy_loop_is_the_median_of_its_own_runs_and_its_largest_force_their_largest(case):
    (loop,) = (loop for loop in case.loops if (loop.parameters, loop.noise) == (TRUE, True))
    noises = [Imperfections(noise_z=1e-4, noise_phi=5e-4, seed=seed) for seed in range(3)]
    noisy = [replace(afl.SCENARIOS["step-step"], imperfections=noise) for noise in noises]
    adaptive = afl.CONTROLLERS["adaptive"]
    runs = [afl.simulate_mujoco(one, adaptive, "sampled") for one in noisy]
    peaks = sorted(float(np.abs(run.force).max()) for run in runs)
    assert peaks[0] < peaks[1] < peaks[2]
    assert loop.metrics["max_force"] == pytest.approx(peaks[1])
    assert loop.largest_force == pytest.approx(peaks[2])


def test_no_run_saw_the_truth_by_mistake(case):
    assert case.estimated.run.provenance["controller"]["belief"] == "estimated"
    assert case.oracle.provenance["controller"]["belief"] == "true"
    first, second, _ = case.cart_mass
    assert first.rms != second.rms  # another noise
    for one in (*case.cart_mass, *case.half_length):
        assert 0.0 < one.rms["0.05-1 s"] < 0.1
        assert all(step.reached_after is not None for step in one.steps)


def test_the_curves_are_of_the_runs_and_the_words_of_their_numbers(case):
    result = result_of("adaptive", case.noise, [case_of(case)])
    curves = result.cases[0].curves
    assert curves.time[-1] == pytest.approx(UNTIL)
    np.testing.assert_array_equal(curves.true_angle[::5], case.oracle.state[:12001:20, 1])
    assert (result.noise_z, result.noise_phi) == (1e-4, 5e-4)
    (figure,) = figures_of(sections(result))
    assert "stepped at 1 s is first within 10 %" in figure.alt
    assert "nan" not in figure.alt
    assert len(figure.draw().axes) == 3


@pytest.mark.parametrize(
    ("settings", "error", "said"),
    [
        (("adaptive", ["step-step"], 0), InvalidValueError, "seeds must be at least 1, got 0"),
        (("adaptive", ["steps"], 1), UnknownNameError, "scenario must be one of nominal, "),
        (("pid", ["step-step"], 1), UnknownNameError, "controller must be one of fixed, "),
        (("adaptive-estimated", [], 1), InvalidValueError, "controller 'adaptive-estimated' must"),
    ],
    ids=["seeds", "scenario", "controller", "estimated"],
)
def test_what_cannot_be_studied_is_refused(settings, error, said):
    with pytest.raises(error) as caught:
        require_study(*settings)
    assert str(caught.value).startswith(said)


@pytest.mark.slow
def test_two_workers_write_the_same_bytes_as_one(tmp_path, command_line):
    for workers in ("1", "2"):
        options = ["--seeds", "1", "--workers", workers, "--out", workers]
        code, output, _ = command_line("estimation", "step-step", "nominal", *options)
        assert code == 0
    assert "Completed" in output and "estimated, with noise" in output
    data = json.loads((tmp_path / "2" / "estimation.json").read_text())
    assert data["command"] == "afl-mujoco estimation step-step nominal --seeds 1"
    for one in (tmp_path / "1").iterdir():
        assert one.read_bytes() == (tmp_path / "2" / one.name).read_bytes()
    suffixes = {path.suffix for path in (tmp_path / "2").iterdir()}
    assert suffixes == {".json", ".npz", ".md", ".svg", ".png", ".html"}
