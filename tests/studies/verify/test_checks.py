"""The checks look where they say, measure an error as large as it is, and see planted faults."""

import dataclasses
import functools
import math

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.simulation.mujoco_model import SimulatedModel
from afl_mujoco.studies.verify import checks
from afl_mujoco.studies.verify.cases import Settings, closed_loop_runs
from afl_mujoco.studies.verify.checks import CRITERIA
from tests.studies.test_validate import SHORT

RIGHT = 0.97  # of a range that thousands of draws fill
FIXED = afl.CONTROLLERS["fixed"]


@pytest.mark.parametrize(("check", "count", "each", "angle"), [
    (checks.acceleration_error, 2000, 1, np.pi),
    (checks.asymmetry, 1000, 4, 1.5),  # then mirrored, shifted and scaled; where controllers are
])  # fmt: skip
def test_states_are_drawn_all_over_the_space(monkeypatch, check, count, each, angle) -> None:
    asked, accelerations = [], SimulatedModel.accelerations

    def noted(model, state, force):
        asked.append([*state, force])
        return accelerations(model, state, force)

    monkeypatch.setattr(SimulatedModel, "accelerations", noted)
    check(np.random.default_rng(0), count)
    here, ends = asked[::each], np.array([10.0, angle, 10.0, 10.0, 200.0])
    assert np.all(np.max(here, axis=0) > RIGHT * ends)
    assert np.all(np.min(here, axis=0) < -RIGHT * ends) and np.all(np.abs(here) <= ends)


def test_runs_that_cannot_be_compared_are_far_apart_and_falls_are_until_they_lie() -> None:
    assert not any(CRITERIA["B1"].judge(value).passed for value in (math.nan, math.inf, 1.1e-9))
    run = afl.simulate_ode(SHORT, FIXED)
    coarse = afl.simulate_ode(SHORT, FIXED, sample_period=2e-3)
    fallen = dataclasses.replace(SHORT, initial_state=(0.0, -1.6, 0.0, 0.0))
    at_once = afl.simulate_ode(fallen, FIXED)
    assert at_once.outcome == afl.Outcome("fell", 0.0)
    fell = dataclasses.replace(run, outcome=afl.Outcome("fell", 1.0))
    for pair in ((at_once, at_once), (run, fell), (run, coarse)):
        assert checks.state_difference(*pair) == math.inf
    fell = dataclasses.replace(run, outcome=afl.Outcome("fell", float(run.time[-1])))
    shifted = fell.state.copy()
    shifted[:, 0] += np.where(np.abs(shifted[:, 1]) > 0.9, 1e-3, 0.0)  # where it has tipped far
    other = dataclasses.replace(fell, state=shifted)
    assert checks.state_difference(fell, other) == pytest.approx(1e-3)


def test_b1_sees_a_heavier_cart_and_a5_and_b3_a_schedule_half_a_step_late() -> None:
    schedule = SHORT.cart_mass
    heavier = afl.Schedule(schedule.times, tuple(v * (1.0 + 1e-6) for v in schedule.values))
    heavy = dataclasses.replace(SHORT, schedule={**SHORT.schedule, "cart_mass": heavier})
    exact = afl.simulate_mujoco(heavy, FIXED, "exact")
    difference = checks.state_difference(exact, afl.simulate_ode(SHORT, FIXED))
    assert not CRITERIA["B1"].judge(difference).passed
    own = SHORT.half_length
    later = afl.Schedule(tuple(t + 5e-4 for t in own.times), own.values)
    late = dataclasses.replace(SHORT, schedule={**SHORT.schedule, "half_length": later})
    runs = closed_loop_runs(SHORT, FIXED, Settings())
    runs["mujoco sampled"] = afl.simulate_mujoco(late, FIXED, "sampled")
    passed = {c.id: c.passed for c in checks.closed_loop_checks(SHORT, FIXED, runs)}
    assert passed == {"A5": False, "B1": True, "B2": True, "B2b": True, "B3": False}


def test_a1_sees_an_inertia_a_millionth_off_and_a3_a_field_that_was_not_mutated(monkeypatch):
    rows, write = SimulatedModel.rows, SimulatedModel.write

    def inflated(model: SimulatedModel, values: np.ndarray) -> np.ndarray:
        found = rows(model, values)
        pole = [str(one).startswith("body pole inertia") for one in model.writer.targets]
        found[:, pole] *= 1.0 + 1e-6
        return found

    def forget_the_tip(model: SimulatedModel, values: np.ndarray) -> None:
        before = model.mj_model.site_pos.copy()
        write(model, values)
        model.mj_model.site_pos[:] = before

    with monkeypatch.context() as patch:
        patch.setattr(SimulatedModel, "rows", inflated)
        error = checks.acceleration_error(np.random.default_rng(0), states=100)
    assert not CRITERIA["A1"].judge(error).passed
    monkeypatch.setattr(SimulatedModel, "write", forget_the_tip)
    assert checks.stale_numbers(np.random.default_rng(0), plants=3) == 3


@pytest.mark.slow
def test_every_reference_check_holds_and_imperfections_make_constraints_act() -> None:
    model = afl.CartPoleModel(afl.CartPoleParameters(), edit=checks.add_passive_physics)
    checks._qacc(model.mj_model, model.mj_data, np.array([1.5, 2.0, 0.0, 0.0]))
    kinds = set(model.mj_data.efc_type.tolist())  # friction loss, joint limit, contact
    assert model.mj_data.ncon > 0 and len(kinds) >= 3
    found = checks.reference_checks()
    assert [check.id for check in found] == ["A4", "A4e", "A8", "A8m", "A8x", "A10"]
    assert all(check.passed for check in found)


@pytest.mark.slow
def test_a10_sees_a_run_that_depends_on_what_ran_before(monkeypatch: pytest.MonkeyPatch) -> None:
    ran = []

    def stateful(*arguments: object, **options: object) -> object:
        run = original(*arguments, **options)
        ran.append(run)
        return dataclasses.replace(run, input=run.force + 1e-12 * len(ran))

    original = checks.simulate_ode
    monkeypatch.setattr(checks, "simulate_ode", stateful)
    assert not CRITERIA["A10"].judge(checks.differing_runs()).passed


def test_a8_sees_one_method_at_a_loose_tolerance(monkeypatch: pytest.MonkeyPatch) -> None:
    loose = functools.partial(checks.simulate_ode, rtol=1e-6, atol=1e-8)
    monkeypatch.setattr(checks, "simulate_ode", loose)
    monkeypatch.setattr("afl_mujoco.simulation.integrator.MAX_STEP", 1.0)
    assert not CRITERIA["A8"].judge(checks.second_method_difference()).passed
