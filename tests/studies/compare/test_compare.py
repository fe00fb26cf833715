"""Controllers compared: whose run is which, what they need, and who meets the requirements."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.control.catalogue import as_controller
from afl_mujoco.report.old import Finding, Table
from afl_mujoco.report.markdown import to_markdown
from afl_mujoco.report.numbers import short
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.films.listing import load_listing
from afl_mujoco.scenario.imperfections import Imperfections
from afl_mujoco.scenario.requirements import Requirements
from afl_mujoco.simulation.judgement import Judgement
from afl_mujoco.studies.compare.comparison import compare
from afl_mujoco.studies.compare.sections import sections, verdict
from afl_mujoco.studies.record import load_record
from afl_mujoco.studies.registry import find_study
from afl_mujoco.studies.requirements_table import finding

RIG = """
name = "rig"
pole_mass = 0.2
duration = 6.0
initial_state = [0.0, 0.2, 0.0, 0.0]
[schedule]
cart_mass = 8.0
half_length = 1.5
[imperfections]
control_period = 0.01
delay = 0.005
noise_phi = 0.001
[requirements]
max_position = 1.0
settling_time = 5.5
"""
OWN = """
class Counting:
    made = 0

    def __init__(self):
        Counting.made += 1
        self.calls = 0

    def __call__(self, time, state, belief):
        self.calls += 1
        return 40.0 * state[0] - 600.0 * state[1] + 80.0 * state[2] - 250.0 * state[3]


def zero(time, state, belief):
    return 0.0


def late(time, state, belief):
    return 0.0 if time < 0.5 else 1 / 0
"""


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a scenario and controllers of one's own."""
    monkeypatch.setattr("sys.dont_write_bytecode", True)
    (tmp_path / "rig.toml").write_text(RIG)
    (tmp_path / "compared.py").write_text(OWN)
    return tmp_path


@pytest.fixture
def result(rig: Path):
    scenario = afl.load_scenario(rig / "rig.toml")
    return compare([scenario], [as_controller(name) for name in ("lqr", "adaptive")], draws=1)


def test_each_run_is_that_of_the_simulator_with_its_imperfections(rig: Path, result) -> None:
    scenario = afl.load_scenario(rig / "rig.toml")
    for name in ("lqr", "adaptive"):
        run = afl.simulate_mujoco(scenario, name, "sampled")
        curves = result.curves[f"rig/{name}"]
        np.testing.assert_array_equal(curves.state, run.state)
        np.testing.assert_array_equal(curves.force, run.force)
        (compared,) = (one for one in result.runs if one.controller == name)
        assert compared.outcome == str(run.outcome)
        assert compared.metrics["peak_z"] == np.abs(run.state[:, 0]).max()


def test_a_gain_beyond_its_table_is_remarked_on(result) -> None:
    remarks = {run.controller: " ".join(run.remarks) for run in result.runs}
    assert remarks["lqr"] == ""  # designed for this plant
    assert "found for M 0.1 to 2 kg, and M reaches 8 kg here" in remarks["adaptive"]
    assert "found for l 0.05 to 1 m, and l reaches 1.5 m here" in remarks["adaptive"]


def test_a_comparison_says_in_print_and_in_a_notebook_who_meets_what(result) -> None:
    printed, shown = str(result), result._repr_markdown_()
    for said in ("misses", "Its gains are extrapolated: they were found for M", "settles within"):
        assert said in printed and said in shown
    for row in result.requirements:
        left = row["left"]
        assert not left or f"{short(left, 3)} {row['unit']}" in printed
    missed = sum(not row["met"] for row in result.requirements)
    assert printed.count("✗") == shown.count("✗") == missed > 0
    assert shown.count("✓") == len(result.requirements) - missed > 0
    assert "\x1b" not in printed


@pytest.mark.parametrize(("end", "remark"), [(3.0, "the cart hits the end stop, 3 m"), (30.0, "")])
def test_a_cart_that_hits_its_end_stop_is_remarked_on(end: float, remark: str) -> None:
    rail = Imperfections(rail_half_length=end)
    scenario = replace(afl.SCENARIOS["nominal"], duration=2.0, imperfections=rail)
    (run,) = afl.compare(scenario, "fixed").runs
    assert " ".join(run.remarks).startswith(remark) and bool(run.remarks) == bool(remark)


def test_the_command_compares_controllers_of_one_s_own(rig: Path, command_line) -> None:
    code, output, errors = command_line(
        "compare", "rig.toml", "--controllers", "lqr", "compared:Counting", "compared:zero",
        "compared:late", "--draws", "1", "--out", "out",
    )  # fmt: skip
    assert (code, errors) == (1, "")
    last = output.splitlines()[-1]
    assert "compared.zero on rig (fell at t = " in last
    assert last.endswith(
        " and compared.late on rig (failed); see what is remarked on compared.zero"
    )
    written = {path.name for path in (rig / "out").iterdir()}
    assert {"compare.json", "compare.npz", "compare.md", "report.html"} <= written
    record = load_record(find_study("compare"), rig / "out")
    names = ("lqr", "compared.Counting", "compared.zero", "compared.late")
    assert [*record.inputs] == ["scenario rig", *(f"controller {name}" for name in names)]
    found = record.result
    by_name = {run.controller: run for run in found.runs}
    assert by_name["lqr"].missed == []
    assert by_name["compared.zero"].remarks == ("the force is 0 N throughout",)
    assert by_name["compared.late"].outcome == (
        "failed: raised ZeroDivisionError at t = 0.5 s: division by zero"
    )
    assert len(by_name["compared.late"].missed) == 3
    assert "rig/compared.late" not in found.curves
    data = json.loads((rig / "out" / "compare.json").read_text())
    assert data["scenarios"][0]["requirements"]["max_position"] == 1.0


def test_three_controllers_that_do_what_is_asked_pass(rig: Path, command_line) -> None:
    (rig / "rig.toml").write_text(RIG.replace("settling_time = 5.5", "max_force = 200"))
    code, output, _ = command_line(
        "compare", "rig.toml", "--controllers", "lqr", "compared:Counting", "--no-page"
    )
    said = (f"{name} on rig passes 10 of 10 draws" for name in ("lqr", "compared.Counting"))
    assert (code, output.splitlines()[-1]) == (0, f"PASS: {'; '.join(said)}")


def test_the_same_object_with_memory_makes_the_same_run_twice(rig: Path) -> None:
    class Integrating:
        def __init__(self) -> None:
            self.sum = 0.0

        def reset(self) -> None:
            self.sum = 0.0

        def __call__(self, time, state, belief):
            self.sum += state[0]
            return 40 * state[0] - 600 * state[1] + 80 * state[2] - 250 * state[3] + 0.01 * self.sum

    scenario, own = afl.load_scenario(rig / "rig.toml"), as_controller(Integrating())
    one, two = (compare([scenario], [own]).curves["rig/Integrating"] for _ in range(2))
    np.testing.assert_array_equal(one.state, two.state)


def test_the_words_are_those_of_the_runs(result) -> None:
    (section,) = sections(result)
    findings = [block for block in section.walk() if isinstance(block, Finding)]
    assert "Of 2 controllers `lqr` meets every requirement; `adaptive` misses" in findings[0].text
    assert "“settles within 5.5 s”" in findings[0].text
    tables = [block for block in section.walk() if isinstance(block, Table)]
    rows = [[getattr(cell, "text", cell) for cell in row] for row in tables[0].rows]
    assert rows[0] == ["lqr", "runs to the end 6 s", "6 s", "–"]
    assert [row[0] for row in rows] == ["lqr"] * 3 + ["adaptive"] * 3
    assert not verdict(result).passed


def test_controllers_that_all_meet_every_requirement_are_counted(result) -> None:
    good = next(run for run in result.runs if not run.missed)
    for count, said in ((1, "The controller"), (2, "Both controllers"), (3, "All 3 controllers")):
        runs = [replace(good, controller=f"number {i}") for i in range(count)]
        assert finding(runs).startswith(f"{said} ")


def test_a_run_that_never_settles_is_said_to(result) -> None:
    missed = next(run for run in result.runs if run.missed)
    never = Judgement(requirement="settling_time", limit=5.5, value=None, left=None, graded=-0.1)
    said = finding([replace(missed, requirements=(never,))])
    assert said == "The controller `adaptive` misses “settles within 5.5 s” (it never does)."


def test_two_controllers_of_one_name_are_told_how_to_get_another() -> None:
    with pytest.raises(InvalidValueError, match=r"got '<lambda>' twice; set __name__ on one"):
        compare("nominal", [lambda *_: 0.0, lambda *_: 1.0])
    with pytest.raises(InvalidValueError, match=r"got 'lqr' twice$"):
        compare("nominal", ["lqr", "lqr"])


def test_the_last_line_says_whose_runs_are_remarked_on(result) -> None:
    assert verdict(result).text.endswith("; see what is remarked on adaptive")
    good = next(run for run in result.runs if not run.missed)
    for remarks, said in (((), "met"), (("it hits the end stop",), "remarked on lqr")):
        runs = (replace(good, remarks=remarks),)
        assert verdict(replace(result, runs=runs, curves={})).text.endswith(said)


@pytest.mark.parametrize(
    ("hardware", "draws", "count", "said"),
    [
        ({}, None, 1, ""),
        ({"noise_phi": 1e-4}, None, 10, "10 draws of noise and start, seeds 7 to 16."),
        ({"noise_phi": 1e-4}, 1, 1, "One draw of noise and start, seed 7."),
        ({"encoder_step_phi": 1e-3}, 3, 3, "3 draws of noise and start, seeds 7 to 9."),
    ],
)
def test_where_noise_or_encoders_act_a_controller_is_judged_by_several_draws(
    hardware, draws, count, said
) -> None:
    asked = Requirements(max_angle=0.12)
    scenario = afl.Scenario(
        name="drawn", duration=0.5, initial_state=(0.0, 0.1, 0.0, 0.0), requirements=asked,
        imperfections=afl.Imperfections(**hardware, seed=7),
    )  # fmt: skip
    found = compare(scenario, "lqr", draws=draws)
    assert [row["draw"] for row in found.table] == list(range(count))
    peaks = {row["peak_phi"] for row in found.table}
    assert len(peaks) == (count if "encoder_step_phi" in hardware else 1)
    assert len({row["force_squared"] for row in found.table}) == count
    alone = afl.simulate_mujoco(scenario, "lqr").metrics
    assert found.table[0]["peak_z"] == alone["peak_z"]  # the first draw is the file's own
    text = to_markdown(sections(found))
    assert said in text
    assert ("lqr on drawn passes" in verdict(found).text) == (count > 1)
    again = compare(scenario, "lqr", draws=draws)
    assert again.table == found.table


def test_the_verdict_counts_the_draws_that_pass_and_says_how_the_others_fail() -> None:
    noisy = afl.Scenario(
        name="noisy", duration=2.0, initial_state=(0.0, 0.1, 0.0, 0.0),
        requirements=Requirements(max_force=14.0),
        imperfections=afl.Imperfections(noise_phi_dot=0.1),
    )  # fmt: skip
    found = compare(noisy, "lqr")
    passing = sum(row["failure"] == "" for row in found.table)
    assert 0 < passing < 10 and not found.passed
    assert verdict(found).text.startswith(
        f"lqr on noisy passes {passing} of 10 draws, else misses “|F| exerted at most”"
    )
    highest = max(row["max_force"] for row in found.table)
    assert f" to {highest:.3g})" in to_markdown(sections(found))


def test_where_a_settling_time_is_required_no_other_is_shown(result) -> None:
    free = replace(result.scenarios[0], requirements=Requirements())
    shown = [
        to_markdown(sections(replace(result, scenarios=(s,)))) for s in (*result.scenarios, free)
    ]
    assert ["of its peak from" in text for text in shown] == [False, True]


def test_without_requirements_a_fall_still_fails() -> None:
    falling = afl.Scenario(name="falling", initial_state=(0.0, 1.5, 0.0, 0.0), duration=2.0)
    assert falling.requirements == Requirements()
    found = compare([falling], [as_controller("lqr")])
    assert not found.passed
    assert "lqr on falling (fell at t = " in verdict(found).text


def test_the_library_takes_functions_classes_and_names(rig: Path) -> None:
    class Own:
        def __call__(self, time, state, belief):
            return 40 * state[0] - 600 * state[1] + 80 * state[2] - 250 * state[3]

    def idle(time, state, belief):
        return 0.0

    found = afl.compare(rig / "rig.toml", ["lqr", Own, idle], draws=1)
    assert repr(found) == "<lqr, Own, idle on rig: 6 of 9 requirements met>"
    assert [row["controller"] for row in found.table] == ["lqr", "Own", "idle"]
    assert found.table[0]["peak_z"] == found.runs[0].metrics["peak_z"]
    missed = [row for row in found.requirements if not row["met"]]
    assert {row["controller"] for row in missed} == {"idle"}
    assert len(found.plot("rig").axes) == 4
    with pytest.raises(afl.AflMujocoError, match="scenario must be one of rig, got 'rug'"):
        found.plot("rug")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("nominal", "nominal"), "scenario names must differ, got 'nominal' twice"),
        (("--controllers", "lqr", "lqr"), "controller names must differ, got 'lqr' twice"),
        (("--integrator", "RK5"), "integrator must be one of RK4, Euler"),
        (
            ("--control-period", "0.0015", "--timestep", "0.001"),
            "timestep 0.001 s must divide control_period 0.0015 s",
        ),
    ],
)
def test_bad_input_is_one_line(rig: Path, command_line, arguments, message: str) -> None:
    code, output, errors = command_line("compare", *arguments, "--out", "out")
    assert (code, output) == (2, "")
    assert errors.startswith(f"afl-mujoco: {message}") and errors.count("\n") == 1
    assert not (rig / "out").exists()


@pytest.mark.slow
def test_a_film_shows_the_controllers_side_by_side_as_they_were_run(
    rig: Path, command_line, graphics: None
) -> None:
    (rig / "rig.toml").write_text(RIG.replace("duration = 6.0", "duration = 0.4").split("[req")[0])
    controllers = ("lqr", "adaptive", "compared:Counting")
    code, _, errors = command_line(
        "compare", "rig.toml", "--controllers", *controllers, "--film", "--out", "out"
    )
    assert (code, errors) == (0, "")
    (film,) = load_listing(rig / "out")
    assert (rig / "out" / film.file).stat().st_size > 1000
    assert film.controllers == ("lqr", "adaptive", "compared.Counting")
    assert film.deployment.control_period == 0.01  # the scenario's, not a step
    asked = " ".join(controllers)
    assert film.command == f"afl-mujoco compare rig.toml --controllers {asked} --film"
    page = (rig / "out" / "report.html").read_text()
    assert "rig, lqr beside adaptive beside compared.Counting" in page
    assert "force held for 10 ms" in page and "force is held for 1 ms" not in page


def test_a_pole_that_falls_at_the_very_end_has_not_completed() -> None:
    start = (0.0, 1.4, 0.0, 0.0)
    falling = afl.Scenario(name="falling", initial_state=start, duration=2.0)

    def idle(time, state, belief):
        return 0.0

    end = afl.simulate_mujoco(falling, idle, "sampled").outcome
    assert end.kind == "fell"
    found = afl.compare(replace(falling, duration=end.time), idle)
    assert found.runs[0].outcome == str(end)
    assert not found.passed


def test_a_controller_that_fails_meets_nothing_even_where_nothing_is_asked() -> None:
    free = afl.Scenario(name="free", duration=1.0, requirements=Requirements(completes=False))

    def broken(time, state, belief):
        raise ArithmeticError

    found = afl.compare(free, ["lqr", broken])
    assert [bool(run.missed) for run in found.runs] == [False, True]
    assert not found.passed


def test_gains_without_a_value_are_a_row_and_not_the_end() -> None:
    believed = {"cart_mass": {"error": 0.5}}
    heavy = afl.Scenario(name="heavy", cart_mass=afl.constant(70.0), duration=1.0, belief=believed)
    found = afl.compare(heavy, ["lqr", "adaptive"])
    outcomes = {run.controller: run.outcome for run in found.runs}
    assert outcomes["lqr"] != "" and not outcomes["lqr"].startswith("failed")
    assert outcomes["adaptive"].startswith("failed: switching of the gain function at M = 105 kg")


def test_remarks_are_of_what_is_assumed_up_to_the_horizon() -> None:
    late = afl.staircase((0.5, 5.0), (1.0, 1.5, 50.0))
    scenario = afl.Scenario(name="late", cart_mass=late, duration=1.0)
    assert scenario.plants.cart_mass == (1.0, 1.5)
    assert afl.find_controller("adaptive-estimated").remarks(scenario.assumed_plants) == []
    wrong = replace(scenario, belief={"cart_mass": {"error": 0.6}})
    for name in ("adaptive", "adaptive-estimated"):
        (remark,) = afl.find_controller(name).remarks(wrong.assumed_plants)
        assert "M reaches 2.4 kg here" in remark


def test_pulses_that_touch_are_recovered_from_together() -> None:
    pulses = tuple(afl.ForcePulse(force=1.0, start=0.1 * k, duration=0.1) for k in (7, 8))
    afl.Scenario(
        name="touching",
        disturbances=pulses,
        duration=3.0,
        requirements=Requirements(recover_within=2.0),
    )
