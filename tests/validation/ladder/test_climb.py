"""The ladder against runs made another way: peaks, single simulations, laws made to fail."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.control.user_law.python_law import PythonLaw
from afl_mujoco.errors import InvalidValueError, UnknownNameError
from afl_mujoco.scenario.realism import Realism
from afl_mujoco.validation.ladder.climb import (
    END_STOP,
    REFUSED,
    Settings,
    climb,
    climb_together,
    climbed,
    judge,
)
from afl_mujoco.validation.ladder.ladder import require_climbable, run_ladder, unit_count
from afl_mujoco.validation.ladder.rungs import RUNGS
from afl_mujoco.validation.ladder.thresholds import ABOVE, BETWEEN

CASE = replace(afl.SCENARIOS["step-step"], duration=8.0)
SETTINGS = Settings(scenarios=(CASE,), seeds=2, scan=5, tolerance=0.05)
LQR, ADAPTIVE = afl.CONTROLLERS["lqr"], afl.CONTROLLERS["adaptive"]


def simulated(law, **options: float) -> afl.Trajectory:
    return afl.simulate_mujoco(replace(CASE, realism=Realism(**options)), law, "sampled")


def test_the_rail_must_be_as_long_as_the_ideal_run_needs():
    rise = climb(("rail", LQR, SETTINGS))
    peak = np.abs(simulated(LQR).state[:, 0]).max()
    assert rise.survives.fails_at < peak <= rise.survives.holds_at
    assert rise.survives.holds_at / rise.survives.fails_at <= 1.05
    assert not rise.typical.survives
    assert rise.failure.failure == rise.typical.failure == END_STOP
    z = np.abs(simulated(LQR).state[:, 0])
    at_typical = np.flatnonzero(z >= RUNGS["rail"].typical)[0] * 1e-3
    assert rise.typical.time == pytest.approx(at_typical, abs=1e-9)


@pytest.mark.parametrize(("name", "field"), [("delay", "delay"), ("force-limit", "force_limit")])
def test_either_side_of_a_threshold_a_single_run_does_what_the_ladder_says(name, field):
    rise = climb((name, ADAPTIVE, SETTINGS))
    assert rise.survives.place == BETWEEN
    assert simulated(ADAPTIVE, **{field: rise.survives.holds_at}).outcome.kind == "completed"
    beyond = simulated(ADAPTIVE, **{field: rise.survives.fails_at}).outcome
    assert (beyond.kind, beyond.time) == (rise.failure.failure, rise.failure.time)


def test_the_typical_verdict_has_the_figures_of_the_run():
    verdict = climb(("actuator-lag", LQR, SETTINGS)).typical
    run = simulated(LQR, actuator_lag=RUNGS["actuator-lag"].typical)
    assert verdict.metrics["peak_z"] == np.abs(run.state[:, 0]).max()
    # The peak of the force falls in the first second, long before the run ends early.
    assert verdict.metrics["max_force"] == np.abs(run.force).max()
    assert (verdict.failure, verdict.scenario, verdict.time) == ("", None, None)


def test_the_worst_of_the_scenarios_and_seeds_counts():
    gentle = replace(CASE, name="gentle", initial_state=(0.0, -0.01, 0.0, 0.0))
    both = replace(SETTINGS, scenarios=(gentle, CASE))
    alone = climb(("force-limit", LQR, SETTINGS))
    together = climb(("force-limit", LQR, both))
    assert together.survives == alone.survives
    assert together.failure.scenario == "step-step"
    easy = climb(("force-limit", LQR, replace(SETTINGS, scenarios=(gentle,))))
    assert easy.survives.fails_at is None or easy.survives.fails_at < alone.survives.fails_at


def test_the_figures_of_a_verdict_are_the_largest_of_any_run():
    starts = {"gentle": -0.01, "harsh": 0.5, "middling": 0.1}
    cases = tuple(
        replace(CASE, name=name, initial_state=(0.0, phi, 0.0, 0.0), duration=2.0)
        for name, phi in starts.items()
    )
    settings = replace(SETTINGS, scenarios=cases)
    metrics = judge(1.0, [Realism()], 1e-3, LQR, settings).metrics
    runs = [afl.simulate_mujoco(case, LQR, "sampled") for case in cases]
    assert metrics["peak_z"] == max(np.abs(run.state[:, 0]).max() for run in runs)
    assert metrics["peak_phi"] == max(np.abs(run.state[:, 1]).max() for run in runs)
    assert metrics["max_force"] == max(np.abs(run.force[:-1]).max() for run in runs)
    assert metrics["settling_time"] is None  # the harsh one does not settle in 2 s


def test_a_law_without_force_for_what_it_is_told_fails_and_says_so():
    rise = climb(("length-under", ADAPTIVE, replace(SETTINGS, scan=9)))
    assert rise.survives.place in (ABOVE, BETWEEN)

    def broken(time, state, belief):
        if belief.cart_mass > 2.0:
            raise RuntimeError("too heavy")
        return LQR.force(state, belief)

    law = PythonLaw(name="broken", function=broken)
    short = replace(SETTINGS, scenarios=(replace(CASE, duration=2.0),), scan=3, tolerance=0.5)
    found = climb(("mass-over", law, short))
    assert found.failure.failure == REFUSED
    assert found.survives.place == BETWEEN
    assert found.typical.survives


def test_together_goes_rung_by_rung_and_ends_with_the_rail():
    names = [rung.name for rung in climbed()]
    assert names[0] == "control-period" and names[-1] == "rail"
    verdicts = climb_together((LQR, SETTINGS))
    assert len(verdicts) == len(names)
    assert verdicts[0].settles
    assert verdicts[-1].failure == END_STOP
    first_two = simulated(LQR, control_period=2e-3, delay=2e-3)
    assert verdicts[1].metrics["peak_z"] == np.abs(first_two.state[:, 0]).max()


def test_the_numbers_do_not_depend_on_the_workers():
    rungs, done = ("delay", "noise"), []
    short = (replace(CASE, duration=2.0),)
    settings = replace(SETTINGS, scenarios=short, scan=3, tolerance=0.5)
    one = run_ladder([LQR, ADAPTIVE], settings, rungs, progress=done.append)
    two = run_ladder([LQR, ADAPTIVE], settings, rungs, workers=2)
    assert one == two
    assert done == list(range(1, unit_count([LQR, ADAPTIVE], rungs) + 1))
    data = one.to_dict()
    assert json.loads(json.dumps(data, allow_nan=False)) == data
    assert one.rise("noise", "adaptive").rung == "noise"
    assert [m.controller for m in one.margins] == ["lqr", "adaptive"]
    lowest = one.margins[0]
    assert 0.0 < lowest.margin < one.rise("delay", "lqr").survives.fails_at


@pytest.mark.parametrize(
    ("changes", "rungs", "message"),
    [
        ({"seeds": 0}, (), "seeds must be at least 1, got 0"),
        ({"scan": 1}, (), "scan must be at least 2, got 1"),
        ({"tolerance": 0.0}, (), "tolerance must lie in 1e-4 to 1, got 0.0"),
        ({"integrator": "RK5"}, (), "integrator must be one of "),
        ({"scenarios": ()}, (), "scenarios must be at least one, got 0"),
        ({"scenarios": (CASE, CASE)}, (), "scenario names must differ, got 'step-step' twice"),
        ({}, ("delay", "delay"), "rung names must differ, got 'delay' twice"),
        (
            {"scenarios": (replace(CASE, realism=Realism(delay=0.1)),)},
            (),
            "scenario 'step-step' must be ideal: what departs from it is for the rungs to say",
        ),
    ],
)
def test_a_setting_that_breaks_its_rule_is_named(changes, rungs, message):
    with pytest.raises((InvalidValueError, UnknownNameError)) as error:
        require_climbable([LQR], replace(SETTINGS, **changes), rungs)
    assert str(error.value).startswith(message)
