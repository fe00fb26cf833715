"""The files of a verification: the public form of its JSON, JUnit, what contradicts itself."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from afl_mujoco.errors import FileError
from afl_mujoco.simulation.judgement import JudgedRun, Judgement
from afl_mujoco.studies.record import load_record, save_record
from afl_mujoco.studies.registry import find_study
from afl_mujoco.studies.verification.files import junit
from afl_mujoco.studies.verification.result import Result
from tests.study_results import record
from tests.verification_result import make_result


def write(result: Result, folder: Path) -> Path:
    """Write a verification without its figures; return its JSON."""
    return save_record(replace(record("validate"), result=result), folder, figures=False)[0]


@pytest.mark.parametrize(("b3", "verdict"), [(1e-10, "pass"), (None, "fail")], ids=["pass", "fail"])
def test_report_json_has_its_public_form(b3: float | None, verdict: str, tmp_path: Path) -> None:
    path = write(make_result(b3=b3), tmp_path)
    assert path.name == "report.json"
    data = json.loads(path.read_text())
    assert data["schema"] == 1
    assert data["verdict"] == verdict
    assert {"afl_mujoco", "mujoco", "python"} <= set(data["versions"])
    assert set(data["checks"][0]) == {
        "id", "scenario", "controller", "quantity", "unit", "value", "limit", "comparison",
        "passed", "reason",
    }  # fmt: skip
    assert set(data["runs"][0]) == {"scenario", "controller", "simulator", "outcome", "metrics"}
    assert data["runs"][0]["metrics"]["settling_2pc_phi"] is None
    assert {"id", "paper", "here", "verdict", "why"} <= set(data["claims"][2])


@pytest.mark.parametrize(("b3", "failing"), [(1e-10, 0), (None, 4)])
def test_junit_has_a_case_for_each_check_and_a_failure_for_each_that_fails(
    b3: float | None, failing: int
) -> None:
    result = make_result(b3=b3)
    suite = ElementTree.fromstring(junit(result))
    assert len(suite.findall("testcase")) == len(result.checks)
    assert len(suite.findall("testcase/failure")) == failing
    assert suite.attrib["failures"] == str(failing)


def test_junit_has_a_case_for_each_requirement() -> None:
    requirement = Judgement(requirement="completes", limit=2.0, value=0.7, left=-1.3)
    fell = JudgedRun(
        scenario="step-step",
        controller="fixed",
        outcome="fell at t = 0.7 s",
        requirements=(requirement,),
        failure="fell",
        settled=False,
    )
    result = replace(make_result(), requirements=(fell,), verdict="fail")
    suite = ElementTree.fromstring(junit(result))
    (case,) = (one for one in suite.findall("testcase") if one.attrib["classname"] == "completes")
    assert case.attrib["name"] == "step-step/fixed"
    assert case.find("failure").attrib["message"] == "The controller `fixed` fell at t = 0.7 s."
    assert suite.attrib["failures"] == "1"


BROKEN: dict[str, tuple[Any, str]] = {
    "a verdict that its checks deny": (lambda d: d | {"verdict": "fail"}, "verdict must be 'pass'"),
    "a run of no scenario": (lambda d: d | {"scenarios": d["scenarios"][:1]}, "scenarios must be"),
    "a run without curves": (lambda d: d | {"curves": {}}, "curves must hold"),
    "no checks": (lambda d: {k: v for k, v in d.items() if k != "checks"}, "checks"),
    "a check without value": (
        lambda d: d | {"checks": [{k: v for k, v in d["checks"][0].items() if k != "value"}]},
        "checks[0].value is missing",
    ),
    "a text for a number": (
        lambda d: d | {"error_budgets": [d["error_budgets"][0] | {"total": "much"}]},
        "error_budgets[0].total must be a number",
    ),
    "a check that passes beyond its limit": (
        lambda d: d | {"checks": [d["checks"][0] | {"value": 5.0}]},
        "passed must follow from value and limit",
    ),
    "a check of another version": (
        lambda d: d | {"checks": [d["checks"][0] | {"id": "Z9"}]},
        "check must be one of A1, ",
    ),
    "a state that there is not": (
        lambda d: (
            d
            | {
                "error_budgets": [
                    d["error_budgets"][0]
                    | {"at_worst": d["error_budgets"][0]["at_worst"] | {"state": "x"}}
                ]
            }
        ),
        "state must be one of z, phi",
    ),
    "no runs": (lambda d: d | {"runs": []}, "scenarios must be those of the runs"),
    "a simulator missing": (lambda d: d | {"runs": d["runs"][1:]}, "each simulator once"),
    "a metric missing": (
        lambda d: d | {"runs": [d["runs"][0] | {"metrics": {}}, *d["runs"][1:]]},
        "metrics of a run must hold",
    ),
    "an unknown key": (lambda d: d | {"colour": "red"}, "colour is not a known key"),
    "a text for a flag": (
        lambda d: d | {"checks": [d["checks"][0] | {"passed": "yes"}]},
        "must be true or false",
    ),
    "no published gains": (
        lambda d: d | {"random_schedules": {"retuned": d["random_schedules"]["retuned"]}},
        "must hold the published gains",
    ),
    "another schema": (lambda d: d | {"schema": 7}, "schema 1"),
}


@pytest.mark.parametrize("case", BROKEN, ids=str)
def test_a_report_that_would_mislead_is_refused_in_one_line(case: str, tmp_path: Path) -> None:
    path = write(make_result(), tmp_path)
    change, words = BROKEN[case]
    path.write_text(json.dumps(change(json.loads(path.read_text()))))
    with pytest.raises(FileError) as refusal:
        load_record(find_study("validate"), tmp_path)
    said = str(refusal.value)
    assert words in said
    assert "report.json" in said
    assert said.endswith("run afl-mujoco validate")
    assert "\n" not in said


def test_curves_of_another_shape_are_refused(tmp_path: Path) -> None:
    path = write(make_result(), tmp_path)
    data = json.loads(path.read_text())
    first = next(iter(data["curves"].values()))
    first["push"] = first["states"]["ode"]
    path.write_text(json.dumps(data))
    with pytest.raises(FileError, match="curve push must have shape"):
        load_record(find_study("validate"), tmp_path)
