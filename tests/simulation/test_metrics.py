"""Metrics against closed forms."""

import sys
import types
from dataclasses import replace

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.simulation.metrics import label_of, metric_names, metrics, unit_of
from afl_mujoco.simulation.trajectory import Layout
from afl_mujoco.studies.verify.claims import TERMS, ObjectiveScales, with_objective

TRAPEZOID_ERROR = 2e-6  # (h^2 / 12) times the change of slope: h = 1 ms, slopes change by <= 20


def decaying_run(outcome: str = "completed") -> afl.Trajectory:
    """z = exp(-t), phi = -exp(-2 t), F = 5 - t over 10 s."""
    time = np.linspace(0.0, 10.0, 10_001)
    state = np.zeros((time.size, 4))
    state[:, 0], state[:, 1] = np.exp(-time), -np.exp(-2.0 * time)
    return afl.Trajectory(
        time=time, state=state, input=5.0 - time,
        parameters={"cart_mass": np.ones_like(time), "half_length": np.full_like(time, 0.5)},
        outcome=afl.Outcome(outcome, 10.0),
    )  # fmt: skip


def measured(run: afl.Trajectory) -> dict[str, float | None]:
    return metrics(afl.SCENARIOS["nominal"], afl.CONTROLLERS["fixed"], run)


@pytest.mark.parametrize(("name", "expected"), [
    ("iae_z", 1.0 - np.exp(-10.0)), ("iae_phi", 0.5 * (1.0 - np.exp(-20.0))),
    ("itae_z", 1.0 - 11.0 * np.exp(-10.0)), ("itae_phi", 0.25 - (5.0 + 0.25) * np.exp(-20.0)),
    ("force_squared", 250.0 / 3.0), ("max_force", 5.0),
    ("force_variation", 15.0),  # 5 N at t = 0, where it was at rest before, then to -5 N
    ("peak_z", 1.0), ("peak_phi", 1.0),
])  # fmt: skip
def test_integrals_and_peaks_match_their_closed_forms(name: str, expected: float) -> None:
    assert measured(decaying_run())[name] == pytest.approx(expected, abs=TRAPEZOID_ERROR)


@pytest.mark.parametrize("simulate", [afl.simulate_mujoco, afl.simulate_ode_held])
def test_a_held_force_is_integrated_as_the_staircase_it_is(simulate) -> None:
    scenario = afl.Scenario(name="pushed", initial_state=(0.0, 0.01, 0.0, 0.0), duration=0.3)
    run = simulate(scenario, lambda time, *_: 3.0 if time < 0.199 else -2.0, control_period=0.1)
    assert run.outcome.kind == "completed"
    figures = run.metrics
    assert figures["force_squared"] == pytest.approx(9.0 * 0.2 + 4.0 * 0.1, rel=1e-12)
    assert figures["force_variation"] == pytest.approx(3.0 + 5.0, rel=1e-12)


def test_settling_is_for_good_and_overshoot_is_beyond_the_target() -> None:
    figures = measured(run := decaying_run())
    found = [figures[name] for name in ("settling_2pc_z", "settling_5pc_phi")]
    assert found == pytest.approx([np.log(50.0), np.log(20.0) / 2.0], abs=1e-3)  # a sample
    assert figures["settling_2pc_z_dot"] == figures["overshoot_phi"] == 0.0  # it never passes it
    state = run.state.copy()
    state[:, 1] = -np.cos(run.time) * np.exp(-run.time)
    swung = replace(run, state=state)
    at_peak = 0.75 * np.pi  # where the derivative of cos(t) exp(-t) vanishes
    expected = -np.cos(at_peak) * np.exp(-at_peak)
    assert measured(swung)["overshoot_phi"] == pytest.approx(expected, abs=1e-7)  # curvature h^2/8


def test_what_a_run_did_not_show_is_none() -> None:
    run = afl.simulate_ode(afl.Scenario(name="short", duration=0.5), "fixed", sample_period=1e-2)
    assert measured(run)["settling_2pc_z"] is None  # it ends outside the band
    scales = ObjectiveScales(iae_z=1.0, iae_phi=1.0, max_force=1.0)
    figures = with_objective(measured(decaying_run("fell")), scales)
    assert figures["iae_z"] is figures["settling_5pc_z"] is figures["objective"] is None
    fallen = afl.Scenario(name="fallen", initial_state=(0.0, -1.6, 0.0, 0.0))
    figures = measured(afl.simulate_ode(fallen, "fixed"))
    assert (figures["max_force"], figures["peak_phi"]) == (None, 1.6)


def test_the_objective_of_its_own_scales_is_three_and_saturation_counts_time() -> None:
    figures, gains = measured(run := decaying_run()), afl.FIXED_GAINS
    scored = with_objective(figures, ObjectiveScales(**{name: figures[name] for name in TERMS}))
    assert scored["objective"] == 3.0 and scored.keys() == {*metric_names()}
    sliding = afl.sliding_variable(run.state, afl.CartPoleParameters(), gains)
    share = np.trapezoid((np.abs(sliding) >= gains.boundary_layer).astype(float), run.time) / 10.0
    assert figures["saturated_share"] == pytest.approx(share, abs=1e-12)  # same sum


def test_a_metric_of_an_input_has_its_own_unit_and_name() -> None:
    units = {"a": "rad", "e": "N m", "force": "N", "peak": ""}
    layout = Layout(("a",), ("e", "force", "peak"), units, (0.0,), ())
    assert [unit_of(f"max_{name}", layout) for name in layout.inputs] == ["N m", "N", ""]
    assert label_of("peak_squared", layout) == "∫peak² dt" and unit_of("peak_a", layout) == "rad"


def test_a_run_goes_to_pandas_or_says_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    made = {"DataFrame": lambda columns, index: columns, "Index": lambda *_, name: 0}
    monkeypatch.setitem(sys.modules, "pandas", types.SimpleNamespace(**made))
    made = (run := decaying_run()).to_pandas()
    assert [*made] == "z phi z_dot phi_dot force command cart_mass half_length".split()
    np.testing.assert_array_equal(made["phi"], run.state[:, 1])
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(afl.AflMujocoError, match="pandas must be installed: pip install pandas"):
        run.to_pandas()


def test_a_run_knows_its_figures_and_says_what_it_is() -> None:
    controller = afl.CONTROLLERS["lqr"]
    short = afl.Scenario(name="<short>", duration=1.0)
    run = afl.simulate_mujoco(short, controller, "sampled")
    expected = metrics(short, controller, run)
    assert run.metrics == {k: v for k, v in expected.items() if k != "saturated_share"}
    assert repr(run) == "<Trajectory: <short>, lqr, mujoco sampled: completed, 1001 instants>"
    assert [line.get_xdata()[-1] for line in run.plot().axes[0].lines] == [1.0]


def test_the_share_outside_the_boundary_layer_is_by_what_the_controller_is_told() -> None:
    start, wrong = {"z": 20.0, "phi": -1.4}, {"half_length": {"error": -0.5}}
    scenario = afl.Scenario(name="wrong", initial_state=start, belief=wrong, duration=5.0)
    fixed = afl.CONTROLLERS["fixed"]
    run = afl.simulate_mujoco(scenario, fixed)
    s = afl.sliding_variable(run.state, afl.CartPoleParameters(half_length=0.25), afl.FIXED_GAINS)
    outside = (np.abs(s) >= afl.FIXED_GAINS.boundary_layer).astype(float)
    expected = np.trapezoid(outside, run.time) / 5.0
    assert 0.0 < expected < 0.01  # by the true length it is 0.03
    assert metrics(scenario, fixed, run)["saturated_share"] == pytest.approx(expected)
