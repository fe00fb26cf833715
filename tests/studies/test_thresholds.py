"""The sweeps against runs made another way: peaks, single simulations, controllers made to fail."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

import afl_mujoco as afl
from afl_mujoco.control.own import PythonController
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.report.terminal import to_text
from afl_mujoco.scenario.imperfections import IDEAL, IMPERFECTIONS, Imperfections
from afl_mujoco.scenario.sample_space import draws_of
from afl_mujoco.simulation.judgement import CONTROLLER_FAILED
from afl_mujoco.studies.shared import robustness
from afl_mujoco.studies.shared.loop_margins import linearize
from afl_mujoco.studies.shared.run import run_all
from afl_mujoco.studies.thresholds import Request, report, run
from tests.plants.plants import cart

CASE = replace(afl.SCENARIOS["step-step"], duration=8.0)
CASES = (CASE,)
CALM = replace(CASE, duration=2.0, initial_state=(0.0, 0.1, 0.0, 0.0))
SETTINGS = robustness.Settings(seeds=2, scan=5, tolerance=0.05)
LQR, ADAPTIVE = afl.CONTROLLERS["lqr"], afl.CONTROLLERS["adaptive"]


def swept(name: str, controller=LQR, scenarios=CASES, settings=SETTINGS):
    return robustness.sweep(robustness.SweepUnit(name, controller, scenarios, settings))


def test_all_combined_has_every_imperfection_at_once_and_twice_as_bad_is_twice_as_bad() -> None:
    real = robustness.hardware_at(robustness.COMBINED, 1.0)
    left_out = {one.name for one in IMPERFECTIONS} - {one.name for one in robustness.added()}
    assert left_out == {"cart_mass_error-", "half_length_error-"}  # which contradict those with +
    for one in robustness.added():
        if one.name != robustness.RAIL:
            for field, factor in one.fields.items():
                assert real[field] == pytest.approx(factor * one.reference)
    assert "end_stops.z" not in real
    double = robustness.hardware_at(robustness.COMBINED, 2.0)
    twice = ("delay", "noise.phi", "dry_friction.z", "cart_mass_error", "control_period")
    for field in (*twice, "input_limit", "slew_rate"):
        factor = 2.0 if field in twice else 0.5
        assert double[field] == pytest.approx(factor * real[field])
    worst = robustness.hardware_at(robustness.COMBINED, 1e6)
    for name in ("tip_mass_share", "input_limit"):
        assert worst[name] == robustness.KNOWN[name].harsh


def test_levels_that_a_scenario_cannot_have_are_not_tried_and_the_reader_is_told() -> None:
    aside = replace(CALM, initial_state=(0.3, 0.05, 0.0, 0.0), duration=0.15)
    rail = swept(robustness.RAIL, scenarios=(aside,)).survives
    assert rail.fails_at is None and 0.3 < rail.holds_at < 0.6  # 0.1 m is the harshest
    late = swept("delay", scenarios=(aside,)).survives
    assert late.fails_at is None and 0.03 < late.holds_at < 0.15
    coarse = replace(SETTINGS, timestep=2e-3)
    found = swept("control_period", scenarios=(CALM,), settings=coarse).survives
    assert found.fails_at is not None and round(found.fails_at / 2e-3, 9) % 1.0 == 0.0
    own = afl.Scenario(name="own", plant=replace(cart("damping", 0.1), upright=(0.0,)))
    asked = Request([LQR], (own,), SETTINGS, ("damping.x", "dry_friction.x", "combined")).require()
    assert list(asked.names) == ["dry_friction.x", "combined"]  # which goes without
    assert "damping.x is written by the plant" in asked.left_out["damping of x"]
    assert "damping.x" not in robustness.hardware_at(robustness.COMBINED, 1.0, own.plant)
    assert robustness.find_imperfection("input_limit", own.plant).harsh == 0.01  # of any unit
    damped = replace(own, imperfections=Imperfections(damping=1.0))
    for use in (lambda: afl.simulate_mujoco(damped, "lqr"), lambda: linearize(LQR, damped)):
        with pytest.raises(InvalidValueError, match=r"^imperfections\.damping\.x is written by"):
            use()
    slow = replace(CALM, imperfections=Imperfections(delay=0.25))
    asked = Request([LQR], (slow,), SETTINGS, ("delay", "noise")).require()
    assert list(asked.names) == ["noise"]
    shown = to_text(report(run(asked)).blocks)
    assert "Not swept: transport delay: a scenario has it harsher than all that is tried" in shown
    beyond = replace(CALM, initial_state=(1.5, 0.0, 0.0, 0.0))
    with pytest.raises(afl.AflMujocoError, match=r"must leave one that can be swept \(initial_sta"):
        Request([LQR], (beyond,), SETTINGS, (robustness.RAIL,)).require()


def test_a_draw_starts_where_the_scenario_may() -> None:
    rough = Imperfections(encoder_step={"z": 0.01, "phi": 0.1}, end_stops={"z": 1.0})
    free = afl.Requirements(ends_at={})
    edge = replace(CALM, initial_state=(-0.999, 6.28, 0, 0), imperfections=rough, requirements=free)
    assert len({one.initial_state for one in draws_of(edge, 20)}) == 20


def test_an_encoder_is_judged_by_draws_of_noise_and_start_within_its_own_steps() -> None:
    unit = robustness.SweepUnit("encoder_step", LQR, (CASE,), SETTINGS)
    runs = robustness.run_on(unit, {"encoder_step.phi": 0.02})
    draws = draws_of(CASE.changed({"encoder_step.phi": 0.02}), SETTINGS.seeds)
    assert len({one.initial_state for one in draws}) == SETTINGS.seeds
    expected = [afl.simulate_mujoco(one, "lqr") for one in draws]
    peaks = [run.metrics["peak_phi"] for run in runs]
    assert peaks == pytest.approx([run.metrics["peak_phi"] for run in expected])
    assert [run.draw for run in runs] == [*range(SETTINGS.seeds)]
    both = unit._replace(scenarios=(CASE, replace(CASE, name="again")))
    known = [(run.scenario, run.draw) for run in robustness.run_on(both, {"delay": 0.002})]
    assert known == [(CASE.name, 0), ("again", 0)]  # nothing is random


@pytest.mark.parametrize(("own", "put", "found"), [
    ({"delay": 0.02}, {"delay": 0.002}, {"delay": 0.02}),
    ({"input_limit": 60.0}, {"input_limit": 1000.0}, {"input_limit": 60.0}),
    ({}, {"input_limit": 50.0}, {"input_limit": 50.0}),
    ({"control_period": 0.02}, {"control_period": 0.001}, {"control_period": 0.02}),
    ({"differentiated": True}, {"noise.phi": 0.1}, {"differentiated": True, "noise.phi": 0.1}),
], ids=str)  # fmt: skip
def test_nothing_gets_milder_than_it_is_in_the_scenario(own, put, found) -> None:
    on_top = robustness.on_hardware(replace(CASE, imperfections=IDEAL.changed(own)), put)
    assert on_top.imperfections == IDEAL.changed(found)
    believing = replace(CASE, belief={"cart_mass": {"error": -0.3}})  # errors are added
    for level in (0.01, 0.5, -0.1):
        on_top = robustness.on_hardware(believing, {"cart_mass_error": level})
        assert on_top.belief.error("cart_mass_error") == pytest.approx(level - 0.3)


def test_every_level_is_run_with_every_seed_of_the_noise_and_every_scenario(monkeypatch) -> None:
    asked = []

    def ran(controller, scenarios, deployed):
        asked.append([(s.name, s.imperfections.seed) for s in scenarios])
        return run_all(controller, scenarios[:1], deployed)

    monkeypatch.setattr(robustness, "run_all", ran)
    short = tuple(replace(CALM, duration=0.2, name=name) for name in ("one", "two"))
    swept("noise", scenarios=short, settings=replace(SETTINGS, scan=2, tolerance=1.0))
    every = (("one", 0), ("one", 1), ("two", 0), ("two", 1))
    assert {tuple(sorted(names)) for names in asked} == {every}


def test_what_a_controller_does_not_read_is_no_imperfection_for_it() -> None:
    def deaf(time, state, belief):
        return 1.1 * (3.3 * state[0] + 6.5 * state[2] - 64.0 * state[1] - 29.0 * state[3])

    own = PythonController(name="deaf", function=deaf)
    names = ("delay", "cart_mass_error+", "parameter_delay")
    settings = replace(SETTINGS, scan=2, tolerance=1.0)
    found = run(Request([LQR, own], (replace(CALM, duration=0.5),), settings, names))
    assert [found.sweep(name, "deaf").applies for name in names] == [True, False, False]
    assert found.sweep("cart_mass_error+", "lqr").applies
    lines = to_text(report(found).blocks).splitlines()
    (row,) = [line for line in lines if line.strip().startswith("M assumed too large")]
    assert row.rstrip().endswith("–") and "> 3000" in row  # lqr, that reads it


def test_what_settles_is_at_rest_whether_or_not_requirements_judge_it() -> None:
    lean = replace(CALM, duration=6.0, initial_state=(0.0, -0.2, 0.0, 0.0))
    asked = replace(lean, requirements=afl.Requirements(max={"z": 3.0}))
    settings = robustness.Settings(seeds=1, scan=4, tolerance=0.5)
    free, judged = (swept("dry_friction.z", LQR, (one,), settings) for one in (lean, asked))
    assert judged.settles == free.settles and judged.settles.fails_at < judged.survives.holds_at


def test_a_controller_that_fails_as_it_is_gets_no_threshold() -> None:
    """Neither one that misses a requirement without any imperfection, nor one that raises."""

    def broken(time, state, belief):
        raise ValueError("my own problem")

    limits = afl.Requirements(max={"force": 3.0, "phi": 1.0})
    near = replace(CALM, duration=3.0, requirements=limits)
    controllers = [
        LQR, PythonController(name="mine", function=broken),
        PythonController(name="weak", function=lambda time, x, belief: -4.0 * x[1]),
    ]  # fmt: skip
    settings = robustness.Settings(scan=3, tolerance=0.5, seeds=1)
    found = run(Request(controllers, (near,), settings, ["delay"]))
    assert found.controllers == [] and found.sweeps == ()
    failures = {name: found.runs(places)[0].failure for name, places in found.bare.items()}
    assert failures == {"lqr": "max.force", "mine": CONTROLLER_FAILED, "weak": "fell"}
    text = report(found).headline + to_text(report(found).blocks)
    assert "No controller passes step-step as it is." in text
    assert "my own problem" in text and "misses “|F| exerted at most " in text

    mild = replace(near, requirements=afl.Requirements(max={"force": 60.0}))
    found = run(Request(controllers, (mild,), settings, ["delay"]))
    assert found.controllers == ["lqr"] and "lqr passes the reference" in report(found).headline
    assert found.sweep("delay", "lqr").survives.fails_at is not None
    text = to_text(report(found).blocks)
    assert "weak falls" in text and "my own problem" in text


@pytest.mark.slow
def test_the_worst_of_the_scenarios_counts_for_any_number_of_workers() -> None:
    gentle = replace(CASE, name="gentle", initial_state=(0.0, -0.01, 0.0, 0.0))
    alone, both = swept("input_limit"), swept("input_limit", scenarios=(gentle, CASE))
    assert both.survives == alone.survives
    assert [one.scenario for one in both.failure if one.failure] == ["step-step"]
    done: list[tuple] = []
    settings = replace(SETTINGS, scan=3, tolerance=0.5)
    asked = Request([LQR, ADAPTIVE], (replace(CASE, duration=2.0),), settings, ("delay", "noise"))
    one = run(asked, progress=lambda *step: done.append(step))
    assert one == run(asked, workers=2)
    assert [step[1:] for step in done[3:]] == [(k, 4) for k in range(5)]
    assert done[4][0] == "sweeping: lqr, transport delay"
    assert one.sweep("noise", "adaptive").imperfection == "noise"


@pytest.mark.slow
def test_the_command_writes_rows_a_figure_and_a_table(tmp_path: Path, command_line) -> None:
    pushing = "def push(time, state, belief):\n    return 20.0 * state[1] + 4.0 * state[3]\n"
    (tmp_path / "pushing.py").write_text(pushing)
    (tmp_path / "short.toml").write_text("duration = 0.5\ninitial_state = [0.0, 0.02, 0.0, 0.0]\n")
    asked = "thresholds short.toml --controllers lqr pushing:push --seeds 1 --scan 3"
    swept = ("--tolerance", "0.5", "--imperfections", "input_limit", "end_stops.z", "--out", "out")
    code, output, errors = command_line(*asked.split(), *swept)
    assert (code, errors) == (0, "")
    assert "Level at which each controller fails on short. In brackets: the reference " in output
    content = json.loads((tmp_path / "out" / "thresholds.json").read_text())
    assert [*content["bare"]] == ["lqr", "pushing.push"]
    assert [r["name"] for r in content["imperfections"]] == ["input_limit", "end_stops.z"]
    assert "--tolerance 0.5" in content["command"] and "--out" not in content["command"]
    for one in content["sweeps"]:
        for place in (*one["reference"], *one["failure"]):
            assert content["rows"][place]["controller"] == one["controller"]
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written == {*(f"thresholds.{x}" for x in "svg png json md".split()), "report.html"}
