import json
from dataclasses import replace

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.films.listing import load_listing
from afl_mujoco.pool import on_threads
from afl_mujoco.report.blocks import Matrix
from afl_mujoco.scenario.imperfections import IDEAL, Imperfections
from afl_mujoco.studies.compare import Options, Result, compare, prepare, report, run
from afl_mujoco.studies.shared.contract import find_study
from afl_mujoco.studies.shared.record import load_record
from afl_mujoco.studies.shared.tables import metrics_matrix
from tests.plants.plants import idle, known

RIG = """
name = "rig"
duration = 6.0
initial_state = [0.0, 0.2, 0.0, 0.0]
schedule = {pole_mass = 0.2, cart_mass = 8.0, half_length = 1.5}
imperfections = {control_period = 0.01, delay = 0.005, noise = {phi = 0.001}}
[requirements]
max.z = 1.0
settling_time = 5.5
"""
OWN = """
class Counting:
    calls = 0
    def __call__(self, time, state, belief):
        self.calls += 1
        return 40.0 * state[0] - 600.0 * state[1] + 80.0 * state[2] - 250.0 * state[3]
def zero(time, state, belief):
    return 0.0
def late(time, state, belief):
    return 0.0 if time < 0.5 else 1 / 0
"""


@pytest.fixture
def rig(tmp_path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("sys.dont_write_bytecode", True)
    (tmp_path / "rig.toml").write_text(RIG)
    (tmp_path / "compared.py").write_text(OWN)
    return tmp_path


@pytest.fixture
def result(rig) -> Result:
    return compare(rig / "rig.toml", ["lqr", "adaptive"], draws=1)


def test_each_run_is_that_of_the_simulator_with_its_imperfections(rig, result) -> None:
    for name in ("lqr", "adaptive"):
        run = afl.simulate_mujoco(rig / "rig.toml", name)
        curves = result.curves[f"rig/{name}"]
        np.testing.assert_array_equal(curves.state, run.state)
        np.testing.assert_array_equal(curves.force, run.force)
        (row,) = (row for row in result.table if row["controller"] == name)
        assert (row["outcome"], row["time"]) == (run.outcome.kind, run.outcome.time)
        assert row["peak_z"] == np.abs(run.state[:, 0]).max()
        assert row["force_squared"] == run.metrics["force_squared"]


def test_remarks_are_of_gains_beyond_their_table_and_of_end_stops(result) -> None:
    assert [*result.remarks] == ["rig/adaptive"]  # lqr is designed for this plant
    said = " ".join(result.remarks["rig/adaptive"])
    assert "found for M 0.1 to 2 kg, and M reaches 8 kg here" in said
    assert "found for l 0.05 to 1 m, and l reaches 1.5 m here" in said
    for end, remark in ((3.0, "z hits the end stop, 3 m"), (30.0, "")):
        rail = Imperfections(end_stops={"z": end})
        scenario = replace(afl.SCENARIOS["nominal"], duration=2.0, imperfections=rail)
        found = compare(scenario, "fixed").remarks
        assert bool(found) == bool(remark) and remark in str(found)


@pytest.mark.parametrize(("period", "told"), [(0.005, False), (0.02, True)])
def test_an_lqr_that_is_too_fast_for_held_inputs_is_remarked_on(period, told) -> None:
    plant, held = known("double_pendulum.py:plant"), Imperfections(control_period=period)
    scenario = afl.Scenario(name="two", plant=plant, duration=0.2, imperfections=held)
    said = f"its linear loop is unstable with inputs held for {1e3 * period:g} ms"
    assert (said in str(compare(scenario, "lqr").remarks)) == told

    def lqr(time, state, belief):
        return 0.0, 0.0

    assert "its linear loop" not in str(compare(scenario, lqr).remarks)  # of one's own design


def test_a_comparison_says_in_print_and_in_a_notebook_who_meets_what(result) -> None:
    printed, shown = str(result), result._repr_markdown_()
    for said in ("settles within 5.5 s", "Its gains are extrapolated: they were found for M"):
        assert said in printed and said in shown
    missed = sum(not row["met"] for row in result.requirements)
    assert printed.count("✗") == shown.count("✗") == missed > 0
    assert printed.count("✓") == shown.count("✓") == len(result.requirements) - missed > 0
    assert "\x1b" not in printed and repr(result) == "<lqr 3 of 3 · adaptive 1 of 3>"
    found = report(result)
    assert (found.title, found.headline) == ("rig: lqr, adaptive", "lqr 3 of 3 · adaptive 1 of 3")
    assert found.passed is False and isinstance(found.blocks[0], Matrix)


def test_the_command_compares_controllers_of_one_s_own(rig, command_line) -> None:
    code, output, errors = command_line(
        "compare", "rig.toml", "--controllers", "lqr", "compared:Counting", "compared:zero",
        "compared:late", "--draws", "1", "--out", "out",
    )  # fmt: skip
    assert (code, errors) == (1, "")
    names = ("lqr", "compared.Counting", "compared.zero", "compared.late")
    met = (3, 3, 0, 0)
    said = " · ".join(f"{name} {count} of 3" for name, count in zip(names, met, strict=True))
    assert output.splitlines()[-1] == f"2 OF 4 PASS: {said}"
    made = {"compare.json", "compare.npz", "compare.md", "compare-1.replay.json", "report.html"}
    assert made <= {path.name for path in (rig / "out").iterdir()}
    assert (rig / "out" / "report.html").stat().st_size < 2_000_000
    record = load_record(find_study("compare"), rig / "out")
    assert [*record.inputs] == ["scenario rig", *(f"controller {name}" for name in names)]
    assert record.result.remarks["rig/compared.zero"] == ("force is 0 throughout",)
    (late,) = (run for run in record.result.rows if run.controller == "compared.late")
    assert late.message == "raised ZeroDivisionError at t = 0.5 s: division by zero"
    assert late.message in output and late.failure == "controller failed"
    assert "rig/compared.late" not in record.result.curves
    data = json.loads((rig / "out" / "compare.json").read_text())
    assert data["scenarios"][0]["requirements"]["max"]["z"] == 1.0
    assert [row["controller"] for row in data["rows"]] == [*names]


@pytest.mark.parametrize(("hardware", "draws", "count"), [
    ({}, None, 1), ({"noise.phi": 1e-4}, None, 10), ({"noise.phi": 1e-4}, 1, 1),
    ({"encoder_step.phi": 1e-3}, 3, 3),
])  # fmt: skip
def test_where_noise_or_encoders_act_several_draws_are_judged(
    hardware, draws, count, monkeypatch
) -> None:
    scenario = afl.Scenario(
        name="drawn", duration=0.5, initial_state=(0.0, 0.1, 0.0, 0.0),
        requirements=afl.Requirements(max={"phi": 0.12}),
        imperfections=IDEAL.changed({**hardware, "seed": 7, "input_limit": 2.0}),
    )  # fmt: skip
    found = compare(scenario, "lqr", draws=draws)
    assert ("in draw 1, the drive is at its limit" in str(found.remarks)) == (count > 1)
    assert [row["draw"] for row in found.table] == list(range(count))
    peaks = {row["peak_phi"] for row in found.table}
    assert len(peaks) == (count if "encoder_step.phi" in hardware else 1)
    assert len({row["force_squared"] for row in found.table}) == count
    alone = afl.simulate_mujoco(scenario, "lqr").metrics
    assert found.table[0]["peak_z"] == alone["peak_z"]  # the first draw is the file's own
    assert ("draws" in report(found).headline) == (count > 1)
    again = prepare(Options(controllers=("lqr",)))._replace(scenarios=[scenario], draws=draws)
    shared, threads = [], "afl_mujoco.studies.shared.run.on_threads"
    monkeypatch.setattr(threads, lambda *of: shared.append(of[2]) or on_threads(*of))
    assert run(again, workers=2).table == found.table and max(shared) == min(count, 2)


def test_the_library_takes_functions_classes_and_names(rig) -> None:
    class Own:
        def __call__(self, time, state, belief):
            return np.dot((40.0, -600.0, 80.0, -250.0), state)

    found = afl.compare(rig / "rig.toml", ["lqr", Own, idle], draws=1)
    assert repr(found) == "<lqr 3 of 3 · Own 3 of 3 · idle 0 of 3>"
    missed = [row for row in found.requirements if not row["met"]]
    assert {row["controller"] for row in missed} == {"idle"} and len(found.plot("rig").axes) == 3
    with pytest.raises(afl.AflMujocoError, match="scenario must be one of rig, got 'rug'"):
        found.plot("rug")


@pytest.mark.slow
def test_a_film_shows_the_controllers_side_by_side_as_they_were_run(rig, command_line, graphics):
    (rig / "rig.toml").write_text(RIG.replace("duration = 6.0", "duration = 0.4").split("[req")[0])
    controllers = ("lqr", "adaptive", "compared:Counting")
    asked = ("compare", "rig.toml", "--controllers", *controllers, "--film")
    code, _, errors = command_line(*asked, "--out", "out")
    assert (code, errors) == (0, "")
    (film,) = load_listing(rig / "out")
    assert (rig / "out" / film.file).stat().st_size > 1000
    assert film.controllers == ("lqr", "adaptive", "compared.Counting")
    assert film.deployment.control_period == 0.01  # the scenario's, not a step
    assert film.command == " ".join(("afl-mujoco", *asked))
    page = (rig / "out" / "report.html").read_text()
    assert "rig, lqr beside adaptive beside compared.Counting" in page


def test_a_controller_that_fails_or_falls_at_the_very_end_is_a_row_that_meets_nothing() -> None:
    falling = afl.Scenario(name="falling", initial_state=(0.0, 1.4, 0.0, 0.0), duration=2.0)
    end = afl.simulate_mujoco(falling, idle).outcome
    found = afl.compare(replace(falling, duration=end.time), idle)
    assert found.rows[0].outcome == end.kind == "fell" and found.rows[0].time == end.time
    assert not found.passed
    free = afl.Scenario(name="free", duration=1.0, requirements=afl.Requirements(completes=False))

    def broken(time, state, belief):
        raise ArithmeticError

    found = afl.compare(free, ["lqr", broken])
    assert [bool(run.missed) for run in found.rows] == [False, True] and not found.passed
    believed = {"cart_mass": {"error": 0.5}}
    heavy = afl.Scenario(name="heavy", schedule={"cart_mass": 70.0}, duration=1.0, belief=believed)
    lqr, adaptive = afl.compare(heavy, ["lqr", "adaptive"]).rows
    assert not lqr.message
    assert adaptive.message.startswith("switching of the gain function at M = 105 kg")


def test_the_figure_draws_every_limit_where_it_is_judged() -> None:
    """Of coordinates about their target, of rates that are limited, of commands, `min` as it is."""
    upper = {"z": 0.5, "phi_dot": 4.0, "force": 90.0, "force_command": 100.0}
    asked = afl.Requirements(target={"z": 0.25}, max=upper, min={"phi": -0.7})
    scenario = afl.Scenario(name="s", duration=0.2, initial_state={"phi": 0.1}, requirements=asked)
    figure = compare(scenario, ["lqr"]).plot()
    dashed = [[line.get_ydata()[0] for line in axis.lines if line.get_linestyle() == "--"]
              for axis in figure.axes]  # fmt: skip
    names = [axis.get_ylabel().split()[0] for axis in figure.axes]
    assert dict(zip(names, map(sorted, dashed), strict=True)) == {
        "z": [-0.25, 0.75], "φ": [-0.7], "φ′": [-4.0, 4.0], "force": [-100, -90, 90, 100],
    }  # fmt: skip


def test_draws_without_a_number_count_in_medians_and_a_share_is_of_the_controller_that_ran():
    often, seldom = [{"end_time": x} for x in (1.0, 2.0, None)], [{}, {}, {"end_time": 3}]
    (row,) = metrics_matrix({"often": often, "seldom": seldom}, ["end_time"]).rows
    assert row[1:] == ["2 (1 to 2; 2 of 3)", "– (1 of 3)"]
    asked = afl.Requirements(target={"z": 60.0})
    away = afl.Scenario(name="away", initial_state={"z": 60.0}, duration=0.5, requirements=asked)
    (figures,) = compare(away, "fixed").metrics
    assert figures["saturated_share"] == 0.0  # about z = 0 it is 1
