"""The checks for machines that read test results: junit.xml."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from afl_mujoco.files import require_no_folder, write_text
from afl_mujoco.studies.verification.check import Check
from afl_mujoco.studies.verification.result import Result

NAME = "junit.xml"


def require(folder: Path) -> None:
    """Raise if a folder is in the way of the file."""
    require_no_folder(folder, (NAME,))


def write(result: Result, folder: Path) -> list[Path]:
    """Write every check as a test case."""
    write_text(folder / NAME, junit(result))
    return [folder / NAME]


def junit(result: Result) -> str:
    """Return the checks as JUnit XML."""
    suite = ElementTree.Element(
        "testsuite",
        name="afl-mujoco validate",
        tests=str(len(result.checks)),
        failures=str(len(result.failed_checks)),
    )
    for check in result.checks:
        place = f"{check.scenario}/{check.controller}"
        case = ElementTree.SubElement(suite, "testcase", classname=check.id, name=place)
        if not check.passed:
            ElementTree.SubElement(case, "failure", message=_sentence(check))
    ElementTree.indent(suite)
    return ElementTree.tostring(suite, encoding="unicode", xml_declaration=True) + "\n"


def _sentence(check: Check) -> str:
    """Say what a check found."""
    value = "none" if check.value is None else f"{check.value:.1e}"
    return (
        f"{check.id} {check.scenario}/{check.controller}: {check.quantity} is {value}, "
        f"must be {check.comparison} {check.limit:g} {check.unit}"
    )
