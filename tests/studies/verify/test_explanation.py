"""The explanation of a difference closes, and each of its checks can fail."""

import dataclasses
import math

import pytest

import afl_mujoco as afl
from afl_mujoco.simulation.ode_fixed_step import Holds
from afl_mujoco.studies.verify import explanation
from afl_mujoco.studies.verify.cases import Settings, closed_loop_runs
from afl_mujoco.studies.verify.checks import CRITERIA
from afl_mujoco.studies.verify.convergence import STEPS, Study, sampled_study
from tests.feedback import feedback

PULSE = afl.ForcePulse(force=-10.0, start=0.5, duration=0.1)
STEP = afl.SCENARIOS["step-trapezoid"].with_schedule(cart_mass=afl.staircase((0.305,), (0.5, 1.0)))
HITS = (PULSE, afl.Impulse(momentum=0.3, time=0.7))
SHORT = dataclasses.replace(STEP, duration=2.0, disturbances=HITS)
ADAPTIVE = afl.CONTROLLERS["adaptive"]


@pytest.fixture(scope="module")
def runs():
    return closed_loop_runs(SHORT, ADAPTIVE, Settings())


def test_everything_holds_and_the_budget_names_the_held_control_and_adds_up(runs):
    checks, budget, _ = explanation.explain(SHORT, ADAPTIVE, runs, full=True)
    assert [c.id for c in checks if not c.passed] == []
    assert {c.id for c in checks} == {*"A6e A6p B2o B4 B4r B4s B5 B6 B7".split()}
    parts = (budget.model_form, budget.integrator, budget.schedule_sampling)
    assert budget.control_hold > 100.0 * max(parts)
    assert budget.total == pytest.approx(budget.control_hold, rel=0.05)  # B5
    worst = dataclasses.asdict(budget.at_worst)
    assert worst.pop("unit") == "rad/s"
    assert (worst.pop("state"), 0.0 < worst.pop("time") < SHORT.duration) == ("phi_dot", True)
    total = worst.pop("total")
    assert abs(total) == budget.total and sum(worst.values()) == pytest.approx(total, rel=1e-12)


def test_the_budget_stays_open_without_a_source_and_an_order_is_an_exponent(runs, monkeypatch):
    monkeypatch.setattr(explanation, "Holds", lambda control_period=None, **x: Holds(None, **x))
    budget = explanation.error_budget(SHORT, ADAPTIVE, runs)
    assert not CRITERIA["B5"].judge(budget.residual_share).passed
    steps = (0.4, 0.2, 0.1, 0.05)
    for errors in ((math.inf, 1.0, 0.5, 0.25), (2.0, 1.0, 0.5, 0.0)):
        assert math.isnan(Study(steps, errors).deviation(1.0))
    study = Study(steps, tuple(3.0 * h**2.5 for h in steps))
    assert study.deviation(0.0) == pytest.approx(2.5, rel=1e-12)
    assert study.reduction == pytest.approx(4.0**-2.5, rel=1e-12)


def test_the_ledger_closes_at_a_hit_with_a_jump_and_stays_open_without_the_ramps(monkeypatch):
    hit = afl.Impulse(momentum=0.3, time=0.305)  # where M jumps
    struck = dataclasses.replace(SHORT, duration=0.5, disturbances=(hit,))
    energy, momentum = explanation.ledger(struck, ADAPTIVE)
    assert CRITERIA["A6e"].judge(energy).passed and CRITERIA["A6p"].judge(momentum).passed
    monkeypatch.setattr(explanation, "_ramp_power", lambda *_: (0.0, 0.0))
    energy, momentum = explanation.ledger(SHORT, ADAPTIVE)
    assert not CRITERIA["A6e"].judge(energy).passed and not CRITERIA["A6p"].judge(momentum).passed


def test_the_plateau_check_fails_on_a_match_and_a_run_that_fell_is_not_explained(monkeypatch, runs):
    assert explanation.plateau_check().passed
    monkeypatch.setattr(explanation, "CAPSULE_EXCESS", 0.0)
    assert not explanation.plateau_check().passed
    fell = afl.Outcome("fell", 1.0)
    fallen = {name: dataclasses.replace(run, outcome=fell) for name, run in runs.items()}
    assert explanation.error_budget(SHORT, ADAPTIVE, fallen) is None
    assert explanation.explain(SHORT, ADAPTIVE, fallen, full=True) == ((), None, None)


def test_a_breakpoint_off_the_largest_step_is_no_instant_of_a_sampled_study():
    start = {"initial_state": (0.0, 0.0, 2.0, 0.0), "duration": 0.4}
    gliding = dataclasses.replace(afl.SCENARIOS["nominal"], **start)
    gliding = gliding.with_schedule(cart_mass=afl.staircase((0.101,), (0.5, 1.0)))
    nothing = feedback(0.0, 0.0, 0.0, 0.0)
    reference = afl.simulate_ode(gliding, nothing, sample_period=STEPS[0])
    assert 0.101 in reference.time.tolist()
    study, residue = sampled_study(gliding, nothing, reference)
    assert max(*study.errors, residue) < 1e-9
