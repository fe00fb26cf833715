"""The campaign's verdict: it passes on the true system and fails on planted faults."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.errors import AflMujocoError
from afl_mujoco.studies.cases import REPORTED, Settings, closed_loop_runs
from afl_mujoco.studies.verification.campaign import verify
from afl_mujoco.studies.verification.checks import closed_loop_checks as closed
from afl_mujoco.studies.verification.checks import equation_checks as equations
from afl_mujoco.studies.verification.criteria import CRITERIA
from afl_mujoco.studies.verification.result import Result, verdict_of

SHORT = dataclasses.replace(
    afl.SCENARIOS["step-trapezoid"],
    name="short",
    duration=1.2,
    disturbances=(
        afl.ForcePulse(force=-10.0, start=0.5, duration=0.1),
        afl.Impulse(momentum=-1.0, time=0.8),
    ),
)
SETTINGS = Settings()


@pytest.fixture(scope="module")
def report() -> Result:
    return verify([SHORT], [afl.CONTROLLERS[c] for c in ("fixed", "adaptive")], SETTINGS)


def test_every_check_holds_on_a_short_scenario_with_everything_in_it(report: Result) -> None:
    assert report.failed_checks == ()
    assert report.passed


def test_the_report_has_each_check_of_each_pair_and_the_equation_checks_once(
    report: Result,
) -> None:
    once = ("A1", "A2", "A3", "A7", "A7z")
    ids = ("A5", "B1", "B2", "B2b", "B3", "B5")
    places = [(c.id, c.controller) for c in report.checks]
    assert places == [(id, "any") for id in once] + [
        (id, controller) for controller in ("fixed", "adaptive") for id in ids
    ]
    assert [(r.controller, r.simulator) for r in report.runs] == [
        (controller, simulator) for controller in ("fixed", "adaptive") for simulator in REPORTED
    ]


@pytest.mark.slow
def test_two_workers_give_the_same_report_as_one(report: Result) -> None:
    controllers = [afl.CONTROLLERS[c] for c in ("fixed", "adaptive")]
    assert verify([SHORT], controllers, SETTINGS, workers=2) == report


def test_the_report_has_curves_of_each_case_and_says_what_its_settings_were(
    report: Result,
) -> None:
    assert list(report.curves) == ["short/fixed", "short/adaptive"]
    for one in report.curves.values():
        assert tuple(one.states) == tuple(one.forces) == REPORTED
    assert report.settings == Settings(timestep=1e-3, control_period=1e-3, full=False)
    assert report.scenarios == (SHORT,)
    assert report.studies == report.ledgers == report.omissions == ()
    for budget, curves in zip(report.error_budgets, report.curves.values(), strict=True):
        assert curves.parts["total"].max() == budget.total


def test_at_its_worst_the_parts_of_the_difference_add_up_to_it(report: Result) -> None:
    for budget in report.error_budgets:
        worst = dataclasses.asdict(budget.at_worst)
        assert (worst.pop("state"), 0.0 < worst.pop("time") < SHORT.duration) == ("phi_dot", True)
        total = worst.pop("total")
        assert abs(total) == budget.total
        assert sum(worst.values()) == pytest.approx(total, rel=1e-12)


def test_the_objective_of_the_fixed_gains_on_the_nominal_plant_is_three() -> None:
    nominal = verify([afl.SCENARIOS["nominal"]], [afl.CONTROLLERS["fixed"]], SETTINGS)
    assert nominal.runs[0].metrics["objective"] == 3.0


def test_without_checks_nothing_passes() -> None:
    assert verdict_of(()) == "fail"


@pytest.mark.parametrize("value", [math.nan, math.inf, 1.1e-9], ids=["nan", "inf", "above"])
def test_a_value_that_is_not_below_the_limit_fails(value: float) -> None:
    assert not CRITERIA["B1"].judge(value).passed


def test_nothing_runs_when_a_setting_cannot_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "afl_mujoco.studies.verification.campaign.judge", lambda pair: pytest.fail("ran")
    )
    with pytest.raises(
        AflMujocoError, match=r"^timestep 0\.003 s must divide control_period 0\.01 s"
    ):
        verify([SHORT], [afl.CONTROLLERS["fixed"]], Settings(3e-3, 1e-2))


def test_a_start_beyond_the_fall_is_refused_by_name_and_value() -> None:
    fallen = dataclasses.replace(SHORT, initial_state=(0.0, -1.6, 0.0, 0.0))
    with pytest.raises(
        AflMujocoError, match=r"initial phi must lie inside \(-pi/2, pi/2\).*got -1\.6 rad"
    ):
        verify([fallen], [afl.CONTROLLERS["fixed"]], SETTINGS)


def test_runs_that_fell_at_once_leave_nothing_to_compare_and_fail() -> None:
    fallen = dataclasses.replace(SHORT, initial_state=(0.0, -1.6, 0.0, 0.0))
    run = afl.simulate_ode(fallen, afl.CONTROLLERS["fixed"])
    assert run.outcome == afl.Outcome("fell", 0.0)
    assert closed.state_difference(run, run) == math.inf


def test_runs_that_ended_differently_are_infinitely_apart() -> None:
    run = afl.simulate_ode(SHORT, afl.CONTROLLERS["fixed"])
    fallen = dataclasses.replace(run, outcome=afl.Outcome("fell", 1.0))
    assert closed.state_difference(run, fallen) == math.inf


def test_runs_that_fell_are_compared_until_the_pole_is_nearly_down() -> None:
    run = afl.simulate_ode(SHORT, afl.CONTROLLERS["fixed"])
    fell = dataclasses.replace(run, outcome=afl.Outcome("fell", float(run.time[-1])))
    shifted = fell.state.copy()
    shifted[:, 0] += np.where(np.abs(shifted[:, 1]) > 0.9, 1e-3, 0.0)  # where it has tipped far
    other = dataclasses.replace(fell, state=shifted)
    assert closed.state_difference(fell, other) == pytest.approx(1e-3)


def test_runs_on_different_grids_are_infinitely_apart() -> None:
    fixed = afl.CONTROLLERS["fixed"]
    coarse = afl.simulate_ode(SHORT, fixed, sample_period=2e-3)
    assert closed.state_difference(afl.simulate_ode(SHORT, fixed), coarse) == math.inf


def test_b1_sees_a_cart_that_is_one_part_in_a_million_too_heavy() -> None:
    fixed = afl.CONTROLLERS["fixed"]
    schedule = SHORT.cart_mass
    heavier = afl.Schedule(schedule.times, tuple(v * (1.0 + 1e-6) for v in schedule.values))
    exact = afl.simulate_mujoco(
        dataclasses.replace(SHORT, cart_mass=heavier), afl.CONTROLLERS["fixed"], "exact"
    )
    difference = closed.state_difference(exact, afl.simulate_ode(SHORT, fixed))
    assert not CRITERIA["B1"].judge(difference).passed


def test_a5_and_b3_see_a_schedule_half_a_step_late() -> None:
    fixed = afl.CONTROLLERS["fixed"]
    late = dataclasses.replace(
        SHORT,
        half_length=afl.Schedule(
            tuple(t + 5e-4 for t in SHORT.half_length.times), SHORT.half_length.values
        ),
    )
    runs = closed_loop_runs(SHORT, fixed, SETTINGS)
    runs["mujoco sampled"] = afl.simulate_mujoco(late, fixed, "sampled")
    passed = {c.id: c.passed for c in closed.closed_loop_checks(SHORT, fixed, runs)}
    assert passed == {"A5": False, "B1": True, "B2": True, "B2b": True, "B3": False}


def test_a3_sees_one_field_that_was_not_mutated(monkeypatch: pytest.MonkeyPatch) -> None:
    def forget_the_tip(model: afl.CartPoleModel, parameters: afl.CartPoleParameters) -> None:
        before = model.mj_model.site_pos.copy()
        original(model, parameters)
        model.mj_model.site_pos[:] = before

    original = afl.CartPoleModel.set_parameters
    monkeypatch.setattr(afl.CartPoleModel, "set_parameters", forget_the_tip)
    assert equations.stale_numbers(np.random.default_rng(0), plants=3) == 3


def test_a1_sees_an_inertia_a_millionth_off(monkeypatch: pytest.MonkeyPatch) -> None:
    def inflate(model: afl.CartPoleModel, parameters: afl.CartPoleParameters) -> None:
        original(model, parameters)
        model.mj_model.body_inertia[2] *= 1.0 + 1e-6

    original = afl.CartPoleModel.set_parameters
    monkeypatch.setattr(afl.CartPoleModel, "set_parameters", inflate)
    error = equations.acceleration_error(np.random.default_rng(0), states=100)
    assert not CRITERIA["A1"].judge(error).passed


def test_imperfections_makes_contacts_limits_and_friction_act() -> None:
    model = afl.CartPoleModel(afl.CartPoleParameters(), edit=equations.add_passive_physics)
    equations._qacc(model, np.array([1.5, 2.0, 0.0, 0.0]))
    kinds = set(model.mj_data.efc_type.tolist())
    assert model.mj_data.ncon > 0
    assert len(kinds) >= 3  # friction loss, joint limit, contact
