"""How well M and l are estimated: the figures of merit by hand, and the study's own run."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.report.blocks import figures_of
from afl_mujoco.scenario.imperfections import Imperfections
from afl_mujoco.studies.estimation import (
    ESTIMATED,
    NOMINAL,
    TRUE,
    UNTIL,
    Request,
    Result,
    report,
    run,
    tracking,
)

TIME = np.arange(0, 10_001) * 1e-3


def test_a_perfect_estimate_has_no_error_and_finds_a_step_at_once():
    truth = afl.staircase((1.0,), (0.5, 1.0))
    found = tracking(truth, TIME, truth(TIME))
    assert found.rms == {"0.05-1 s": 0.0, "1-6 s": 0.0, "6 s to the end": 0.0}
    (step,) = found.steps
    assert (step.at, step.reached_after, step.found_after) == (1.0, 0.0, 0.0)


def test_a_step_is_reached_first_and_found_for_good_later():
    truth = afl.staircase((1.0, 3.0), (0.5, 1.0, 2.0))
    estimate = truth(TIME).copy()
    estimate[1000:1200] = 0.5  # late
    estimate[1500:1700] = 1.2  # and lost again
    estimate[3000:] = 1.0  # never
    one, two = tracking(truth, TIME, estimate).steps
    assert (one.reached_after, one.found_after) == (pytest.approx(0.2), pytest.approx(0.7))
    assert (two.reached_after, two.found_after) == (None, None)


def test_a_ramp_that_ends_a_rounding_off_its_plateau_is_no_step():
    truth = afl.trapezoid((0.0, 2.0, 6.0, 8.0), low=0.2, high=1.0)
    assert tracking(truth, TIME, truth(np.maximum(TIME - 0.05, 0.0))).steps == ()


def test_the_error_is_that_of_the_logarithm_in_each_window():
    truth = afl.constant(2.0)
    estimate = np.where(TIME < 6.0, 2.2, 1.0)
    found = tracking(truth, TIME, estimate)
    assert found.rms["0.05-1 s"] == pytest.approx(math.log(1.1))
    assert found.rms["6 s to the end"] == pytest.approx(math.log(2.0))
    assert tracking(truth, TIME[:500], estimate[:500]).rms["1-6 s"] is None


@pytest.fixture(scope="module")
def result() -> Result:
    return run(Request([afl.SCENARIOS["step-step"]], afl.CONTROLLERS["adaptive"], seeds=3))


def test_the_estimated_loop_is_as_good_as_the_one_with_the_true_parameters(result):
    (case,) = result.cases
    loops = {(loop.parameters, loop.noise): loop for loop in case.loops}
    assert {loop.completed for loop in loops.values()} == {1, 3}
    true, estimated = loops[TRUE, False], loops[ESTIMATED, True]
    assert estimated.runs == 3
    for name in ("iae_z", "iae_phi"):  # what it is worth: the nominal parameters cost far more
        assert true.metrics[name] != estimated.metrics[name] < 1.15 * true.metrics[name]
        assert estimated.metrics[name] < loops[NOMINAL, False].metrics[name]


def test_a_noisy_loop_is_the_median_of_its_own_runs_and_its_largest_force_their_largest(result):
    (loop,) = (x for x in result.cases[0].loops if (x.parameters, x.noise) == (TRUE, True))
    noises = [Imperfections(noise={"z": 1e-4, "phi": 5e-4}, seed=seed) for seed in range(3)]
    noisy = [replace(afl.SCENARIOS["step-step"], imperfections=noise) for noise in noises]
    runs = [afl.simulate_mujoco(one, afl.CONTROLLERS["adaptive"], "sampled") for one in noisy]
    peaks = sorted(float(np.abs(run.force).max()) for run in runs)
    assert peaks[0] < peaks[1] < peaks[2]
    assert loop.metrics["max_force"] == pytest.approx(peaks[1])
    assert loop.largest_force == pytest.approx(peaks[2])


def test_the_curves_are_of_the_runs(result):
    curves = result.cases[0].curves
    assert curves["cart mass M [kg]"]["true"][0][-1] == pytest.approx(UNTIL)
    oracle = afl.simulate_mujoco("step-step", "adaptive", "sampled")
    angle = curves["pole angle φ [rad]"]["true"][1]
    np.testing.assert_array_equal(angle[::5], oracle.state[:12001:20, 1])
    shown = report(result)
    assert "completes 3 of 3 noisy runs" in shown.headline
    (figure,) = figures_of(shown.blocks)
    axes = figure.draw().axes
    assert len(axes) == 3
    assert not [line for axis in axes for line in axis.lines if line.get_marker() == "x"]


@pytest.mark.slow
def test_two_workers_write_the_same_bytes_as_one(tmp_path, command_line):
    for workers in ("1", "2"):
        options = ["--seeds", "1", "--workers", workers, "--out", workers]
        code, output, _ = command_line("estimation", "step-step", "nominal", *options)
        assert code == 0
    assert "Completed" in output and "estimated, noise" in output
    data = json.loads((tmp_path / "2" / "estimation.json").read_text())
    assert data["command"] == "afl-mujoco estimation step-step nominal --seeds 1"
    for one in (tmp_path / "1").iterdir():
        assert one.read_bytes() == (tmp_path / "2" / one.name).read_bytes()
