import json
from dataclasses import replace

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.simulation.sampled.runs import simulate_estimated
from afl_mujoco.studies import estimation
from afl_mujoco.studies.estimation import report, run


@pytest.fixture(scope="module")
def result() -> estimation.Result:
    step = afl.SCENARIOS["step-step"]
    return run(estimation.Request([step], afl.CONTROLLERS["adaptive"], seeds=3))


def test_the_estimated_loop_is_as_good_as_the_one_with_the_true_parameters(result):
    (case,) = result.cases
    loops = {(loop.parameters, loop.noise): loop for loop in case.loops}
    assert {loop.completed for loop in loops.values()} == {1, 3}
    true, estimated = loops[estimation.TRUE, False], loops[estimation.ESTIMATED, True]
    assert len(estimated.runs) == 3
    for name in ("iae_z", "iae_phi"):  # what it is worth: the nominal parameters cost far more
        assert true.median(name) != estimated.median(name) < 1.15 * true.median(name)
        assert estimated.median(name) < loops[estimation.NOMINAL, False].median(name)


def test_a_noisy_loop_is_the_median_of_its_own_runs(result):
    true, loops = (estimation.TRUE, True), result.cases[0].loops
    (loop,) = (x for x in loops if (x.parameters, x.noise) == true)
    noises = [afl.Imperfections(noise={"z": 1e-4, "phi": 5e-4}, seed=seed) for seed in range(3)]
    noisy = [replace(afl.SCENARIOS["step-step"], imperfections=noise) for noise in noises]
    runs = [afl.simulate_mujoco(one, afl.CONTROLLERS["adaptive"], "sampled") for one in noisy]
    peaks = sorted(float(np.abs(run.force).max()) for run in runs)
    assert peaks[0] < peaks[1] < peaks[2] and loop.median("max_force") == pytest.approx(peaks[1])


def test_how_long_m_and_l_are_off_is_said(result):
    noise = afl.Imperfections(noise={"z": 1e-4, "phi": 5e-4}, seed=1)
    scenario = replace(afl.SCENARIOS["step-step"], imperfections=noise)
    seen = simulate_estimated(scenario, afl.find_controller("adaptive-estimated"))
    true = np.array([scenario.parameters_at(t).cart_mass for t in seen.time.tolist()])
    off = np.mean((seen.cart_mass > 1.2 * true) | (seen.cart_mass < 0.8 * true))
    (loop,) = (x for x in result.cases[0].loops if x.off)
    assert len(loop.off) == 3 and loop.off[1][0] == off > 0.0
    most = max(x for pair in loop.off for x in pair)
    assert f"over 20 % off for up to {100 * most:.0f} % of a run" in report(result).headline


def test_the_curves_are_of_the_runs(result):
    curves = result.cases[0].curves
    assert curves["cart mass M [kg]"]["true"][0][-1] == pytest.approx(estimation.UNTIL)
    oracle = afl.simulate_mujoco("step-step", "adaptive", "sampled")
    angle = curves["pole angle φ [rad]"]["true"][1]
    np.testing.assert_array_equal(angle[::5], oracle.state[:12001:20, 1])
    said = estimation.report(result).headline
    cost = max(np.array(iae_of(result, True)) / iae_of(result, False))
    assert f"completes 3 of 3 noisy runs · ∫|φ| dt at most {cost:.2f} times" in said


def iae_of(result, noisy):
    of = (estimation.ESTIMATED, True) if noisy else (estimation.TRUE, False)
    (loop,) = (x for x in result.cases[0].loops if (x.parameters, x.noise) == of)
    return [run.metrics["iae_phi"] for run in loop.runs]


def test_the_cost_is_of_the_worst_run_that_completes(result):
    (case,) = result.cases
    *others, noisy = (x for x in case.loops if x.parameters != estimation.NOMINAL)
    true = iae_of(result, False)[0]
    fell, worst = (
        replace(run, metrics={**run.metrics, "iae_phi": cost})
        for run, cost in ((noisy.runs[0], None), (noisy.runs[2], 3.0 * true))
    )
    loops = (*others, replace(noisy, runs=(fell, noisy.runs[1], worst)))
    said = estimation.report(replace(result, cases=(replace(case, loops=loops),))).headline
    assert "at most 3 times that with the true M and l, where it completes" in said


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
