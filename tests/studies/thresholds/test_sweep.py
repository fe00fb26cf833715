"""The sweeps against runs made another way: peaks, single simulations, controllers made to fail."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.control.own.python_controller import PythonController
from afl_mujoco.errors import InvalidValueError, UnknownNameError
from afl_mujoco.scenario.imperfections import Imperfections
from afl_mujoco.studies.bisection import BRACKETED, LOWER
from afl_mujoco.studies.thresholds.imperfections import BY_NAME
from afl_mujoco.studies.thresholds.result import END_STOP, REFUSED
from afl_mujoco.studies.thresholds.sweep import (
    Settings,
    added,
    find_thresholds,
    judge,
    require,
    sweep,
    sweep_combined,
)

pytestmark = pytest.mark.slow

CASE = replace(afl.SCENARIOS["step-step"], duration=8.0)
CASES = (CASE,)
SETTINGS = Settings(seeds=2, scan=5, tolerance=0.05)
LQR, ADAPTIVE = afl.CONTROLLERS["lqr"], afl.CONTROLLERS["adaptive"]


def simulated(controller, **options: float) -> afl.Trajectory:
    return afl.simulate_mujoco(
        replace(CASE, imperfections=Imperfections(**options)), controller, "sampled"
    )


def test_the_rail_must_be_as_long_as_the_ideal_run_needs():
    found = sweep(("rail", LQR, CASES, SETTINGS))
    peak = np.abs(simulated(LQR).state[:, 0]).max()
    assert found.survives.fails_at < peak <= found.survives.holds_at
    assert found.survives.holds_at / found.survives.fails_at <= 1.05
    assert not found.reference.survives
    assert found.failure.failure == found.reference.failure == END_STOP
    z = np.abs(simulated(LQR).state[:, 0])
    at_reference = np.flatnonzero(z >= BY_NAME["rail"].reference)[0] * 1e-3
    assert found.reference.time == pytest.approx(at_reference, abs=1e-9)


@pytest.mark.parametrize(("name", "field"), [("delay", "delay"), ("force-limit", "force_limit")])
def test_either_side_of_a_threshold_a_single_run_does_what_the_sweep_says(name, field):
    found = sweep((name, ADAPTIVE, CASES, SETTINGS))
    assert found.survives.bound == BRACKETED
    assert simulated(ADAPTIVE, **{field: found.survives.holds_at}).outcome.kind == "completed"
    beyond = simulated(ADAPTIVE, **{field: found.survives.fails_at}).outcome
    assert (beyond.kind, beyond.time) == (found.failure.failure, found.failure.time)


def test_the_reference_verdict_has_the_figures_of_the_run():
    verdict = sweep(("actuator-lag", LQR, CASES, SETTINGS)).reference
    run = simulated(LQR, actuator_lag=BY_NAME["actuator-lag"].reference)
    assert verdict.metrics["peak_z"] == np.abs(run.state[:, 0]).max()
    # The peak of the force falls in the first second, long before the run ends early.
    assert verdict.metrics["max_force"] == np.abs(run.force).max()
    assert (verdict.failure, verdict.scenario, verdict.time) == ("", None, None)


def test_the_worst_of_the_scenarios_and_seeds_counts():
    gentle = replace(CASE, name="gentle", initial_state=(0.0, -0.01, 0.0, 0.0))
    alone = sweep(("force-limit", LQR, CASES, SETTINGS))
    combined = sweep(("force-limit", LQR, (gentle, CASE), SETTINGS))
    assert combined.survives == alone.survives
    assert combined.failure.scenario == "step-step"
    easy = sweep(("force-limit", LQR, (gentle,), SETTINGS))
    assert easy.survives.fails_at is None or easy.survives.fails_at < alone.survives.fails_at


def test_the_figures_of_a_verdict_are_the_largest_of_any_run():
    starts = {"gentle": -0.01, "harsh": 0.5, "middling": 0.1}
    cases = tuple(
        replace(CASE, name=name, initial_state=(0.0, phi, 0.0, 0.0), duration=2.0)
        for name, phi in starts.items()
    )
    metrics = judge(1.0, cases, LQR, SETTINGS).metrics
    runs = [afl.simulate_mujoco(case, LQR, "sampled") for case in cases]
    assert metrics["peak_z"] == max(np.abs(run.state[:, 0]).max() for run in runs)
    assert metrics["peak_phi"] == max(np.abs(run.state[:, 1]).max() for run in runs)
    assert metrics["max_force"] == max(np.abs(run.force[:-1]).max() for run in runs)
    assert metrics["settling_time"] is None  # the harsh one does not settle in 2 s


def test_a_controller_that_computes_no_force_fails_and_says_so():
    found = sweep(("length-under", ADAPTIVE, CASES, replace(SETTINGS, scan=9)))
    assert found.survives.bound in (LOWER, BRACKETED)

    def broken(time, state, belief):
        if belief.cart_mass > 2.0:
            raise RuntimeError("too heavy")
        return LQR.force(state, belief)

    controller = PythonController(name="broken", function=broken)
    short = (replace(CASE, duration=2.0),)
    found = sweep(("mass-over", controller, short, replace(SETTINGS, scan=3, tolerance=0.5)))
    assert found.failure.failure == REFUSED
    assert found.survives.bound == BRACKETED
    assert found.reference.survives


def test_imperfections_are_added_one_by_one_and_ends_with_the_rail():
    names = [one.name for one in added()]
    assert names[0] == "control-period" and names[-1] == "rail"
    verdicts = sweep_combined((LQR, CASES, SETTINGS))
    assert len(verdicts) == len(names)
    assert verdicts[0].settles
    assert verdicts[-1].failure == END_STOP
    first_two = simulated(LQR, control_period=2e-3, delay=2e-3)
    assert verdicts[1].metrics["peak_z"] == np.abs(first_two.state[:, 0]).max()


def test_the_numbers_do_not_depend_on_the_workers():
    names, done = ("delay", "noise"), []
    short = (replace(CASE, duration=2.0),)
    asked = ([LQR, ADAPTIVE], short, replace(SETTINGS, scan=3, tolerance=0.5), names)
    one = find_thresholds(*asked, progress=lambda *step: done.append(step))
    two = find_thresholds(*asked, workers=2)
    assert one == two
    assert done == [("sweeping", k, 6) for k in range(7)]
    assert one.sweep("noise", "adaptive").imperfection == "noise"
    assert [m.controller for m in one.delay_margins] == ["lqr", "adaptive"]
    lowest = one.delay_margins[0]
    assert 0.0 < lowest.margin < one.sweep("delay", "lqr").survives.fails_at


@pytest.mark.parametrize(
    ("changes", "names", "message"),
    [
        ({"seeds": 0}, (), "seeds must be at least 1, got 0"),
        ({"scan": 1}, (), "scan must be at least 2, got 1"),
        ({"tolerance": 0.0}, (), "tolerance must lie in 1e-4 to 1, got 0.0"),
        ({"integrator": "RK5"}, (), "integrator must be one of "),
        ({"scenarios": ()}, (), "scenarios must be at least one, got 0"),
        ({"scenarios": (CASE, CASE)}, (), "scenario names must differ, got 'step-step' twice"),
        ({}, ("delay", "delay"), "imperfection names must differ, got 'delay' twice"),
        (
            {"scenarios": (replace(CASE, imperfections=Imperfections(delay=0.1)),)},
            (),
            "scenario 'step-step' must be ideal: remove [imperfections]",
        ),
    ],
)
def test_a_setting_that_breaks_its_rule_is_named(changes, names, message):
    asked = {"scenarios": CASES, **changes}
    with pytest.raises((InvalidValueError, UnknownNameError)) as error:
        require([LQR], asked.pop("scenarios"), replace(SETTINGS, **asked), names)
    assert str(error.value).startswith(message)
