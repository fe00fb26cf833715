import json
from dataclasses import replace

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.simulation.sampled.runs import simulate_estimated
from afl_mujoco.studies import estimation
from afl_mujoco.studies.estimation import report

TRUE, NOMINAL, ESTIMATED = estimation.TRUE, estimation.NOMINAL, estimation.ESTIMATED
STEP, ADAPTIVE = afl.SCENARIOS["step-step"], afl.CONTROLLERS["adaptive"]


@pytest.fixture(scope="module")
def result() -> estimation.Result:
    return estimation.run(estimation.Request([STEP], ADAPTIVE, seeds=3))


@pytest.fixture(scope="module")
def loops(result):
    return {(loop.parameters, loop.noise): loop for loop in result.cases[0].loops}


def noisy(seed: int) -> afl.Scenario:
    noise = afl.Imperfections(noise={"z": 1e-4, "phi": 5e-4}, seed=seed)
    return replace(STEP, imperfections=noise)


def test_the_estimated_loop_is_as_good_as_the_one_with_the_true_parameters(loops):
    assert {loop.completed for loop in loops.values()} == {1, 3}
    true, estimated = loops[TRUE, False], loops[ESTIMATED, True]
    for name in ("iae_z", "iae_phi"):  # what it is worth: the nominal parameters cost far more
        assert true.median(name) != estimated.median(name) < 1.15 * true.median(name)
        assert estimated.median(name) < loops[NOMINAL, False].median(name)


def test_a_noisy_loop_is_the_median_of_its_own_runs(loops):
    runs = [afl.simulate_mujoco(noisy(seed), ADAPTIVE) for seed in range(3)]
    first, middle, last = sorted(float(np.abs(run.force).max()) for run in runs)
    assert first < middle < last and loops[TRUE, True].median("max_force") == pytest.approx(middle)


def test_how_long_m_and_l_are_off_is_said(result, loops):
    seen = simulate_estimated(noisy(1), afl.find_controller("adaptive-estimated"))
    true = np.array([STEP.parameters_at(t).cart_mass for t in seen.time.tolist()])
    off = np.mean((seen.cart_mass > 1.2 * true) | (seen.cart_mass < 0.8 * true))
    shares = loops[ESTIMATED, True].off
    assert len(shares) == 3 and shares[1][0] == off > 0.0
    most = max(x for pair in shares for x in pair)
    assert f"over 20 % off for up to {100 * most:.0f} % of a run" in report(result).headline


def test_the_curves_are_of_the_runs(result):
    curves = result.cases[0].curves
    assert curves["cart mass M [kg]"]["true"][0][-1] == pytest.approx(estimation.UNTIL)
    oracle = afl.simulate_mujoco(STEP, ADAPTIVE)
    angle = curves["pole angle φ [rad]"]["true"][1]
    np.testing.assert_array_equal(angle[::5], oracle.state[:12001:20, 1])


def test_the_cost_is_of_the_worst_run_that_completes(result, loops):
    known, runs = loops[TRUE, False].median("iae_phi"), loops[ESTIMATED, True].runs
    cost = max(run.metrics["iae_phi"] / known for run in runs)
    said = f"completes 3 of 3 noisy runs · ∫|φ| dt at most {cost:.2f} times"
    assert said in report(result).headline
    fell, worst = (
        replace(run, metrics={**run.metrics, "iae_phi": cost})
        for run, cost in ((runs[0], None), (runs[2], 3.0 * known))
    )
    worse = replace(loops[ESTIMATED, True], runs=(fell, runs[1], worst))
    case = replace(result.cases[0], loops=(loops[TRUE, False], worse))
    said = "at most 3 times that with the true M and l, where it completes"
    assert said in report(replace(result, cases=(case,))).headline


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
