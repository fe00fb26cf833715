import json
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.errors import FileError
from afl_mujoco.plants.cartpole import CART_POLE
from afl_mujoco.report import terminal
from afl_mujoco.report.blocks import Cell, Matrix, Section
from afl_mujoco.simulation.judgement import Judgement
from afl_mujoco.studies.shared.contract import find_study
from afl_mujoco.studies.shared.record import load_record, save_record
from afl_mujoco.studies.shared.run import Run as Row
from afl_mujoco.studies.shared.run import columns_of
from afl_mujoco.studies.validate import Request, Result, report, run, verdict_of
from afl_mujoco.studies.verify.cases import REPORTED, Settings
from afl_mujoco.studies.verify.checks import CRITERIA
from tests.messages import line
from tests.study_results import record
from tests.verification_result import make_result

PULSE = afl.ForcePulse(force=-10.0, start=0.5, duration=0.1)
HITS = {"disturbances": (PULSE, afl.Impulse(momentum=-1.0, time=0.8))}
SHORT = replace(afl.SCENARIOS["step-trapezoid"], name="short", duration=1.2, **HITS)


def test_every_check_holds_on_a_short_scenario_with_everything_in_it() -> None:
    short = run(Request([SHORT], [afl.CONTROLLERS[name] for name in ("fixed", "adaptive")]))
    assert short.failed_checks == [] and short.passed
    once, each = ("A1", "A2", "A3", "A7", "A7z"), ("A5", "B1", "B2", "B2b", "B3", "B5")
    pairs = [*product(["any"], once), *product(("fixed", "adaptive"), each)]
    assert [(c.controller, c.id) for c in short.checks] == pairs
    runs = [(r.controller, r.simulator) for r in short.runs]
    assert runs == [*product(("fixed", "adaptive"), REPORTED)]
    rows = [(row.controller, row.failure) for row in short.rows]
    assert rows == [("fixed", ""), ("adaptive", "")]
    assert list(short.curves) == ["short/fixed", "short/adaptive"]
    for name, (time, states) in short.curves.items():
        one = afl.simulate_mujoco(SHORT, name.split("/")[1])
        np.testing.assert_array_equal(states, one.state[np.searchsorted(one.time, time - 1e-9)])
        assert time[0] == 0.0 and time[-1] == one.time[-1] and np.diff(time).max() < 0.021
    assert short.settings == Settings(timestep=1e-3, control_period=1e-3, full=False)
    assert short.omissions == short.claims == ()


def matrix(result: Result, caption: str) -> list[list[Cell]]:
    walked = Section("", "", report(result).blocks).walk()
    (found,) = (one for one in walked if isinstance(one, Matrix) and caption in one.caption)
    return found.cells


def test_the_headline_says_whether_the_codes_agree_and_what_became_of_the_claims() -> None:
    assert report(make_result(full=False)).headline == "CODES AGREE 22/22"
    found = report(make_result())
    assert found.passed
    said = "CODES AGREE 22/22; of the paper's 12 claims 4 hold, 4 not, 2 in part, 2 open"
    assert found.headline == said
    wrong = report(make_result(b3=3.4e-7))
    said = "CODES DIFFER, 18/22 checks hold: B3 3.4×10⁻⁷ > 10⁻⁸ on step-step with fixed; of the "
    assert not wrong.passed and wrong.headline.startswith(said)
    assert "B3 none > 10⁻⁸" in report(make_result(b3=None)).headline and verdict_of(()) == "fail"
    assert not report(replace(make_result(), checks=(), verdict="fail")).passed


def test_a_verdict_on_two_codes_does_not_hide_that_the_pole_fell() -> None:
    fell = make_result(outcome="fell at t = 1.2 s", fell_at=1200, full=False)
    said = "CODES AGREE 22/22; 4 of 4 cases did not complete"
    assert report(fell).headline == f"{said}: step-step with fixed fell at t = 1.2 s, ode"
    whole = make_result(full=False)
    pairs = zip(fell.runs, whole.runs, strict=True)
    runs = tuple(one if one.simulator == "mujoco sampled" else other for one, other in pairs)
    assert "4 of 4 cases did not complete" in report(replace(whole, runs=runs)).headline


def test_a_requirement_that_is_missed_fails_and_is_shown() -> None:
    whole = Judgement(requirement="completes", limit=2.0, value=0.7, margin=-0.65)
    fell = {"outcome": "fell", "failure": "fell", "settled": False, "time": 0.7}
    row = Row(scenario="step-step", controller="adaptive", requirements=(whole,), **fell,
              metrics=dict.fromkeys(columns_of(CART_POLE)))  # fmt: skip
    verdict = verdict_of(make_result().checks, (row,))
    result = replace(make_result(full=False), rows=(row,), verdict=verdict)
    found = report(result)
    assert not found.passed and result.verdict == "fail"
    assert found.headline == "1 of 1 runs fail: adaptive on step-step falls; CODES AGREE 22/22"
    assert isinstance(found.blocks[0], Matrix) and "step-step" in found.blocks[0].caption
    assert not isinstance(report(make_result()).blocks[0], Matrix)
    with pytest.raises(ValueError, match="verdict must be 'fail'"):
        replace(result, verdict="pass")


def test_every_criterion_stands_with_its_worst_value_limit_margin_and_reason() -> None:
    result = make_result(b3=3.4e-7)
    rows = {row[0].text: row for row in matrix(result, "at its worst")}
    assert list(rows) == ["A1", "A3", "A5", "B1", "B2", "B3", "B5"]
    shown = [(cell.text, cell.status) for cell in rows["B3"][2:]]
    assert shown == [("3.4×10⁻⁷", "bad"), ("10⁻⁸", ""), ("0.029×", "")]
    for row in matrix(result, "The criteria"):
        assert row[1].text == CRITERIA[row[0].text].reason


def test_a_terminal_of_80_columns_shows_it_in_60_lines(monkeypatch) -> None:
    monkeypatch.setattr(terminal, "WIDTH", 80)
    usual = "A1 A2 A3 A5 A7 A7z B1 B2 B2b B3 B5".split()
    checks = tuple(CRITERIA[id].judge(CRITERIA[id].limit / 15e3) for id in usual)
    shown = report(replace(make_result(full=False), checks=checks))
    assert len(terminal.to_text(shown.blocks).splitlines()) < 60 - 1  # and the headline


def test_the_claims_and_the_budget_stand_with_their_numbers() -> None:
    result = make_result()
    rows = matrix(result, "C9 to C12")
    assert [row[0].text for row in rows] == [claim.id for claim in result.claims]
    assert [row[4].text for row in rows[:4]] == ["holds", "not", "in part", "open"]
    assert [cell.text for cell in rows[2][2:4]] == ["38.03 %", "15.4 %"]
    assert (rows[1][2].text, rows[4][3].text) == ("–", "–")
    rows = {row[0].text: row for row in matrix(make_result(), "as deployed minus the equations")}
    assert rows["inputs held"][1].text.startswith("−1.4×10⁻²")
    assert rows["total"][2].text == "1.4×10⁻²"


def write(result: Result, folder):
    return save_record(replace(record("validate"), result=result), folder, figures=False)[0]


@pytest.mark.parametrize(("b3", "verdict"), [(1e-10, "pass"), (None, "fail")], ids=["pass", "fail"])
def test_report_json_has_its_public_form(b3: float | None, verdict: str, tmp_path) -> None:
    path = write(make_result(b3=b3), tmp_path)
    assert path.name == "report.json"
    data = json.loads(path.read_text())
    assert data["schema"] == 1 and data["verdict"] == verdict
    assert {"afl_mujoco", "mujoco", "python"} <= set(data["versions"])
    keys = "id scenario controller quantity unit value limit comparison passed reason".split()
    assert set(data["checks"][0]) == {*keys}
    assert set(data["runs"][0]) == {"scenario", "controller", "simulator", "outcome", "metrics"}
    assert data["runs"][0]["metrics"]["settling_2pc_phi"] is None
    assert {"id", "paper", "here", "verdict", "why"} <= set(data["claims"][2])


@pytest.mark.parametrize(("spoil", "words"), [
    (lambda x: x.update(verdict="fail"), "verdict must be 'pass'"),
    (lambda x: x["scenarios"].pop(1), "scenarios must be"),
    (lambda x: x.update(curves={}), "curves must hold"),
    (lambda x: x["checks"][0].pop("value"), "checks[0].value is missing"),
    (lambda x: x["checks"][0].update(value=5.0), "passed must follow from value and limit"),
    (lambda x: x.update(runs=[]), "scenarios must be those of the runs"),
    (lambda x: x.update(schema=7), "schema 1"),
], ids=lambda x: x if isinstance(x, str) else "")  # fmt: skip
def test_a_report_that_would_mislead_is_refused_in_one_line(spoil, words, tmp_path) -> None:
    path = write(make_result(), tmp_path)
    spoil(data := json.loads(path.read_text()))
    path.write_text(json.dumps(data))
    said = line(..., "report.json", ..., words, ..., "run afl-mujoco validate")
    with pytest.raises(FileError, match=said):
        load_record(find_study("validate"), tmp_path)
