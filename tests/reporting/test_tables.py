"""The report's four forms say the same."""

from __future__ import annotations

import dataclasses
import io
import json
from pathlib import Path
from xml.etree import ElementTree

import pytest
from rich.console import Console

from afl_mujoco.errors import FileError
from afl_mujoco.reporting.tables import print_report, write_report
from afl_mujoco.studies.verification.campaign import Report, Run
from afl_mujoco.studies.verification.claims.claim import Claim
from afl_mujoco.studies.verification.claims.ledger import Ledger
from afl_mujoco.studies.verification.claims_table import claims_table
from afl_mujoco.studies.verification.criteria import CRITERIA
from afl_mujoco.studies.verification.criteria_table import rewrite


def make_report(b1: float) -> Report:
    values = {"A5": 1e-16, "B1": b1, "B2": 1e-6, "B2b": 1e-15, "B3": 1e-10}
    checks = tuple(CRITERIA[id].judge(v, "step-step", "fixed") for id, v in values.items())
    run = Run(
        scenario="step-step",
        controller="fixed",
        simulator="ode",
        outcome="completed",
        metrics={"objective": 2.5, "settling_2pc_z": None},
    )
    return Report(checks=(CRITERIA["A3"].judge(0), *checks), runs=(run,))


@pytest.fixture(params=[(1e-12, "pass"), (float("nan"), "fail")], ids=["pass", "fail"])
def case(request: pytest.FixtureRequest) -> tuple[Report, str]:
    b1, verdict = request.param
    return make_report(b1), verdict


def test_report_json_follows_its_schema(case: tuple[Report, str], tmp_path: Path) -> None:
    report, verdict = case
    write_report(report, tmp_path)
    data = json.loads((tmp_path / "report.json").read_text())
    assert data["schema"] == 1
    assert data["verdict"] == verdict
    assert {"afl_mujoco", "mujoco", "python"} <= set(data["versions"])
    assert set(data["checks"][0]) == {
        "id", "scenario", "controller", "quantity", "unit", "value", "limit", "comparison",
        "passed", "reason",
    }  # fmt: skip
    assert data["runs"][0]["metrics"]["settling_2pc_z"] is None
    assert isinstance(data["claims"], list)


def test_junit_has_a_case_for_each_check_and_a_failure_for_each_that_fails(
    case: tuple[Report, str], tmp_path: Path
) -> None:
    report, verdict = case
    write_report(report, tmp_path)
    suite = ElementTree.parse(tmp_path / "junit.xml").getroot()
    assert len(suite.findall("testcase")) == len(report.checks)
    assert len(suite.findall("testcase/failure")) == (0 if verdict == "pass" else 1)
    assert suite.attrib["failures"] == str(len(report.failed_checks))


def test_markdown_tables_have_as_many_cells_in_every_row(
    case: tuple[Report, str], tmp_path: Path
) -> None:
    write_report(case[0], tmp_path)
    rows = [line.replace("\\|", "") for line in (tmp_path / "report.md").read_text().splitlines()]
    grid = [row.count("|") for row in rows if row.startswith("| step-step") or "OF" in row]
    assert len(set(grid)) == 1
    checks = [row.count("|") for row in rows if row.startswith(("| A", "| B", "| check"))]
    assert set(checks) == {7}


def test_the_terminal_ends_with_the_verdict(case: tuple[Report, str]) -> None:
    report, verdict = case
    stream = io.StringIO()
    print_report(report, Console(file=stream, width=132))
    last = stream.getvalue().rstrip().splitlines()[-1]
    assert last == ("PASS: all 6 checks hold" if verdict == "pass" else "FAIL: 1 of 6 checks")


def test_a_report_is_written_whole_or_not_at_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "write_text", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_report(make_report(0.0), tmp_path)
    assert list(tmp_path.iterdir()) == []


CLAIM = Claim(
    id="C3", claim="max|F| falls", figure="share [%]", paper=38.03, here=None,
    verdict="cannot be determined", why="nothing ran",
)  # fmt: skip


def test_the_claims_are_in_every_form_and_do_not_decide_the_verdict(tmp_path: Path) -> None:
    report = dataclasses.replace(make_report(1e-12), ledger=Ledger(claims=(CLAIM,)))
    write_report(report, tmp_path)
    assert json.loads((tmp_path / "report.json").read_text())["claims"] == [CLAIM.to_dict()]
    row = "| C3 | max\\|F\\| falls | cannot be determined | share [%] | 38 | - | nothing ran |"
    assert row in (tmp_path / "report.md").read_text()
    console = Console(file=io.StringIO(), width=140)
    print_report(report, console)
    said = console.file.getvalue().splitlines()
    assert "C3   cannot be determined paper 38, here -: max|F| falls" in said
    assert said[-1].startswith("PASS")


def test_a_page_gets_the_claims_of_a_report_between_its_marks(tmp_path: Path) -> None:
    write_report(dataclasses.replace(make_report(1e-12), ledger=Ledger(claims=(CLAIM,))), tmp_path)
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- claims -->\nold\n<!-- end of claims -->\nafter\n")
    rewrite(page, "claims", claims_table(tmp_path / "report.json"))
    text = page.read_text()
    assert text.startswith("before\n<!-- claims -->\n|  | claim | paper | here |")
    assert "| C3 | max\\|F\\| falls; *share [%]* | 38.03 | – | **cannot be determined** |" in text
    assert "old" not in text
    assert text.endswith("<!-- end of claims -->\nafter\n")


def test_a_page_without_its_marks_and_a_report_without_claims_are_refused(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("<!-- claims -->\nall of the rest\n")
    with pytest.raises(FileError, match="must hold the marks of claims"):
        rewrite(page, "claims", "text")
    assert page.read_text() == "<!-- claims -->\nall of the rest\n"
    write_report(make_report(1e-12), tmp_path)
    with pytest.raises(FileError, match="must hold claims"):
        claims_table(tmp_path / "report.json")
