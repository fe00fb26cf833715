"""A campaign: the same bits on any worker, every failure replayed, controllers that break down."""

from __future__ import annotations

import math
import sys
import time

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.control.own.loading import load_python_controller
from afl_mujoco.control.own.python_controller import ControllerError, PythonController
from afl_mujoco.report.markdown import to_markdown
from afl_mujoco.errors import AflMujocoError
from afl_mujoco.execution.executors import open_executor
from afl_mujoco.scenario.files import load_scenario
from afl_mujoco.scenario.imperfections import Imperfections
from afl_mujoco.scenario.laboratory import HARDWARE_RANGES
from afl_mujoco.scenario.ranges import Ranges
from afl_mujoco.scenario.requirements import Requirements
from afl_mujoco.scenario.sample_space import SampleSpace
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.schedules import constant
from afl_mujoco.simulation.judgement import CONTROLLER_FAILED, Judgement
from afl_mujoco.simulation.trajectory import FALL_ANGLE
from afl_mujoco.studies.monte_carlo import campaign as module
from afl_mujoco.studies.monte_carlo.campaign import Campaign, run_campaign
from afl_mujoco.studies.monte_carlo.files import write
from afl_mujoco.studies.monte_carlo.result import result_of
from afl_mujoco.studies.monte_carlo.sections import sections
from afl_mujoco.studies.monte_carlo.trial import Settings, Trial, run_trials
from tests.sample_spaces import near_laboratory

pytestmark = pytest.mark.slow

ADAPTIVE, LQR = afl.CONTROLLERS["adaptive"], afl.CONTROLLERS["lqr"]
SHORT = near_laboratory(
    duration=2.0, last_change=1.0, cart_mass=(0.1, 0.5), phi=(-1.4, 1.4),
    imperfections=dict(HARDWARE_RANGES) | {"rail_damping": (2.0, 8.0)},
)  # fmt: skip
"""Rigs on which both fall, and soon."""


def run(
    controllers=(ADAPTIVE, LQR), *, samples=30, workers=1, seed=1, space=SHORT, settings=None
) -> Campaign:
    with open_executor(workers) as executor:
        return run_campaign(
            controllers, space, samples=samples, seed=seed, settings=settings or Settings(),
            executor=executor,
        )  # fmt: skip


@pytest.fixture(scope="module")
def thirty() -> Campaign:
    found = run()
    assert all(3 <= len(found.failures(name)) <= 27 for name in found.trials)
    return found


def same(one, other) -> bool:
    return repr(one) == repr(other)  # repr tells floats apart to the last bit, and NaN from none


def test_two_processes_and_a_repetition_give_the_same_bits(thirty: Campaign) -> None:
    assert same(run(workers=2).trials, thirty.trials)


def test_the_chunks_change_no_bit(thirty: Campaign, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "CHUNK", 7)
    assert same(run().trials, thirty.trials)


def test_sample_i_is_the_same_whatever_their_number_and_the_company(thirty: Campaign) -> None:
    few = run(controllers=[LQR], samples=12)
    assert same(few.trials["lqr"], thirty.trials["lqr"][:12])


def test_another_seed_is_another_campaign(thirty: Campaign) -> None:
    assert not same(
        run(controllers=[LQR], samples=5, seed=2).trials["lqr"], thirty.trials["lqr"][:5]
    )


def test_every_failure_replays_from_its_file_to_the_same_bits(thirty: Campaign, tmp_path) -> None:
    result = result_of(thirty, [])
    write(result, tmp_path)
    for controller, rates in zip((ADAPTIVE, LQR), result.controllers, strict=True):
        assert [failure.index for failure in rates.failures] == thirty.failures(controller.name)
        for failure in rates.failures:
            trial = thirty.trials[controller.name][failure.index]
            scenario = load_scenario(tmp_path / failure.file)
            alone = afl.simulate_mujoco(scenario, controller, "sampled")
            assert (alone.outcome.kind, alone.outcome.time) == (trial.outcome, trial.end_time)
            z, phi = np.abs(alone.state[:, :2]).max(axis=0)
            assert (z, phi) == (trial.peak_z, trial.peak_phi)
            assert alone.metrics["max_force"] == trial.max_force


def test_the_counts_are_those_of_the_trials(thirty: Campaign) -> None:
    result = result_of(thirty, [])
    for rates in result.controllers:
        trials = thirty.trials[rates.controller]
        assert rates.passed == sum(t.outcome == "completed" for t in trials)
        assert rates.settled == sum(not math.isnan(t.settling_time) for t in trials)
        assert rates.rate == rates.passed / 30
        assert rates.interval[0] < rates.rate < rates.interval[1]
        peaks = sorted(t.peak_z for t in trials if t.passed)
        assert peaks[0] < rates.median_displacement < rates.largest_displacement == peaks[-1]
        assert sum(rates.failures_by_kind.values()) == len(rates.failures)
        assert len(rates.failures) == 30 - rates.passed
    (pairing,) = result.comparisons
    assert (pairing.first, pairing.second) == ("adaptive", "lqr")
    assert pairing.both + pairing.only_first == result.controllers[0].passed
    assert pairing.both + pairing.only_second == result.controllers[1].passed


def test_a_run_that_settles_is_distinguished_from_one_that_survives() -> None:
    none = dict.fromkeys(
        ("rail_friction", "rail_damping", "noise_phi", "noise_phi_dot"), (0.0, 0.0)
    )
    calm = near_laboratory(
        phi=(0.1, 0.2), cart_mass=(1.0, 1.0), half_length=(0.5, 0.5), duration=8.0, last_change=1.0,
        imperfections=dict(HARDWARE_RANGES) | none,
    )  # fmt: skip
    found = run([LQR], samples=3, space=calm)
    assert found.success("lqr").count == found.settling("lqr").count == 3


# Controllers that break down


def raises(t, state, belief):
    if t > 0.1 and state[1] > 0.0:
        raise RuntimeError("no idea")
    return ADAPTIVE.force(state, belief)


def not_a_number(t, state, belief):
    return math.nan


def wrong_shape(t, state, belief):
    return np.zeros(2)


def hangs(t, state, belief):
    while True:
        pass


BROKEN = {
    "raises": (raises, r"^controller 'raises' raised RuntimeError at t = \S+ s: no idea$"),
    "wrong shape": (
        wrong_shape,
        r"must return one number at t = 0 s, got an array of shape \(2,\)$",
    ),
    "hangs": (hangs, r"must answer within 0.05 s \(--call-limit\), but did not at t = 0 s$"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_controller_that_breaks_down_fails_its_runs_and_says_how(name: str) -> None:
    function, message = BROKEN[name]
    limit = 5.0 if name == "raises" else 0.05
    controller = PythonController(
        name=name, function=function, call_limit=limit, first_call_limit=limit
    )
    started = time.perf_counter()
    found = run([controller, LQR], samples=4)
    assert time.perf_counter() - started < 60.0
    failed = [trial for trial in found.trials[name] if trial.outcome == CONTROLLER_FAILED]
    assert failed
    if name != "raises":
        assert len(failed) == 4
    for trial in failed:
        with pytest.raises(ControllerError, match=message):
            raise ControllerError(trial.message or "", "")
        assert not trial.passed
        assert not trial.settled
    rates, lqr = result_of(found, []).controllers
    assert rates.failures_by_kind[CONTROLLER_FAILED] == len(failed)
    assert CONTROLLER_FAILED not in lqr.failures_by_kind
    with pytest.raises(ControllerError):
        first = found.failures(name)[0]
        afl.simulate_mujoco(module.sample_scenario(SHORT, first, 1), controller, "sampled")


def test_a_controller_without_a_force_ends_the_run_as_a_failure() -> None:
    controller = PythonController(name="nan", function=not_a_number)
    found = run([controller], samples=3)
    assert {trial.outcome for trial in found.trials["nan"]} == {"diverged"}
    assert found.success("nan").count == found.settling("nan").count == 0
    assert found.failures("nan") == [0, 1, 2]


def test_a_controller_of_a_users_module_goes_to_the_workers(tmp_path, monkeypatch) -> None:
    (tmp_path / "mine_for_montecarlo.py").write_text(
        "def controller(t, state, belief):\n    return 1 / 0\n"
    )
    monkeypatch.chdir(tmp_path)
    controller = load_python_controller("mine_for_montecarlo:controller")
    try:
        trials = run([controller], samples=2, workers=2).trials[controller.name]
    finally:
        sys.modules.pop("mine_for_montecarlo")
    assert [trial.outcome for trial in trials] == [CONTROLLER_FAILED] * 2
    assert "raised ZeroDivisionError at t = 0 s" in trials[0].message


UNDONE = Judgement(requirement="completes", limit=20.0, value=15.0, left=-5.0)


def test_severity_ranks_failures_before_survivors_and_early_falls_first() -> None:
    calm = Trial(outcome="completed", end_time=20.0, peak_phi=0.1, iae_phi=0.1)
    rough = Trial(outcome="completed", end_time=20.0, peak_phi=1.5, iae_phi=20.0)
    late = Trial(outcome="fell", end_time=19.0, requirements=(UNDONE,))
    early = Trial(outcome="diverged", end_time=0.5, requirements=(UNDONE,))
    broken = Trial(outcome=CONTROLLER_FAILED)
    order = [trial.severity(20.0) for trial in (calm, rough, late, early, broken)]
    assert order == sorted(order)
    assert len(set(order)) == 5
    assert order[1] < 1.0 < order[2]


def test_severity_is_what_its_words_say() -> None:
    survivor = Trial(outcome="completed", end_time=20.0, peak_phi=1.2, iae_phi=8.0)
    assert survivor.severity(20.0) == pytest.approx(0.5 * (1.2 + 0.4) / FALL_ANGLE)
    fell = Trial(outcome="fell", end_time=15.0, requirements=(UNDONE,))
    assert fell.severity(20.0) == pytest.approx(2.25)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"samples": 0}, "samples must be at least 1, got 0"),
        ({"seed": -1}, "seed must lie in 0 to 2**63 - 1, got -1"),
        ({"controllers": []}, "controllers must be at least one, got 0"),
        ({"controllers": [LQR, LQR]}, "controller names must differ, got 'lqr' twice"),
        ({"space": near_laboratory(control_period=1.5e-3), "settings": Settings(timestep=1e-3)},
         "timestep 0.001 s must divide control_period 0.0015 s"),
        ({"controllers": [ADAPTIVE], "space": near_laboratory(half_length=(1e-3, 1.0))},
         "switching of the gain function at M = 0.1 kg, l = 0.001 m must be positive, got -"),
    ],
    ids=str,
)  # fmt: skip
def test_what_cannot_be_run_is_refused_before_it_begins(changes, message: str) -> None:
    with pytest.raises(AflMujocoError) as raised:
        run(**changes)
    assert str(raised.value).startswith(message)


# A scenario of one's own, with requirements


HEAVY = Scenario(
    name="heavy",
    pole_mass=0.2,
    duration=4.0,
    initial_state=(0.0, 0.2, 0.0, 0.0),
    cart_mass=constant(8.0),
    half_length=constant(1.5),
    imperfections=Imperfections(control_period=0.01, delay=0.004),
    requirements=Requirements(max_position=0.5, max_force=150.0),
    ranges=Ranges(varied={"phi": (-0.4, 0.4), "cart_mass": (6.0, 12.0)}, cart_mass_rate=4.0),
)


@pytest.fixture(scope="module")
def heavy() -> Campaign:
    return run([LQR], samples=20, space=SampleSpace(HEAVY))


def test_the_requirements_decide_which_runs_pass(heavy: Campaign, tmp_path) -> None:
    result = result_of(heavy, [])
    assert result.judged
    (rates,) = result.controllers
    assert 0 < rates.passed < 20
    assert rates.passed == 20 - len(rates.failures)
    for i, trial in enumerate(heavy.trials["lqr"]):
        alone = afl.simulate_mujoco(module.sample_scenario(heavy.space, i, 1), LQR, "sampled")
        assert trial.completed
        too_far = bool(np.abs(alone.state[:, 0]).max() > 0.5)
        hardest = alone.metrics["max_force"]
        too_hard = bool(hardest > 150.0)
        assert trial.missed == ("max_position",) * too_far + ("max_force",) * too_hard
        assert trial.passed == (not too_far and not too_hard) == (trial.severity(4.0) <= 1.0)
        left = min(1.0 - trial.peak_z / 0.5, 1.0 - hardest / 150.0)
        assert trial.margin == trial.robustness == pytest.approx(left)
    assert rates.missed == {
        name: sum(name in trial.missed for trial in heavy.trials["lqr"])
        for name in ("max_force", "max_position")
        if any(name in trial.missed for trial in heavy.trials["lqr"])
    }
    write(result, tmp_path)
    first = rates.failures[0]
    again = run_trials([load_scenario(tmp_path / first.file)], LQR, Settings())[0]
    assert same(again, heavy.trials["lqr"][first.index])


def test_the_words_are_those_of_requirements(heavy: Campaign) -> None:
    text = to_markdown(sections(result_of(heavy, [])))
    assert "lqr meets all requirements on" in text
    assert "| Misses “\\|z\\| at most 0.5 m” |" in text
    assert "| Settles |" in text and "urviv" not in text


def test_severity_of_a_judged_run_follows_its_tightest_limit() -> None:
    def judged(*left: float, outcome: str = "completed", time: float = 20.0) -> Trial:
        made = tuple(
            Judgement(requirement=name, limit=2.0, value=2.0 - x, left=x)
            for name, x in zip(("max_position", "max_force"), left, strict=False)
        )
        return Trial(outcome=outcome, end_time=time, requirements=made)

    order = [
        judged(1.5, 1.0), judged(0.5, 1.5), judged(0.0), judged(1.5, -0.1), judged(-10.0, 1.0),
        judged(-1.0, outcome="fell", time=19.0), judged(-0.1, outcome="fell", time=1.0),
    ]  # fmt: skip
    severities = [trial.severity(20.0) for trial in order]
    assert severities == sorted(severities)
    assert severities[:3] == pytest.approx([0.5, 0.75, 1.0])
    assert [trial.passed for trial in order] == [True] * 3 + [False] * 4
