"""Checks and requirements for machines that read test results: junit.xml."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from afl_mujoco.files import require_no_folder, write_text
from afl_mujoco.studies.tables import asked, how
from afl_mujoco.studies.verification.check import Check
from afl_mujoco.studies.verification.result import Result

NAME = "junit.xml"


def require(folder: Path) -> None:
    """Raise if a folder is in the way of the file."""
    require_no_folder(folder, (NAME,))


def write(result: Result, folder: Path) -> list[Path]:
    """Write every check and every requirement as a test case."""
    write_text(folder / NAME, junit(result))
    return [folder / NAME]


def junit(result: Result) -> str:
    """Return checks and requirements as JUnit XML."""
    judged = [
        (c.id, f"{c.scenario}/{c.controller}", "" if c.passed else _sentence(c))
        for c in result.checks
    ]
    judged += [
        (
            one.requirement,
            f"{run.scenario}/{run.controller}",
            ""
            if one.met
            else f"{run.controller} {how(run.failure)}: {asked(one)}, got {one.value}",
        )
        for run in result.rows
        for one in run.requirements
    ]
    suite = ElementTree.Element(
        "testsuite",
        name="afl-mujoco validate",
        tests=str(len(judged)),
        failures=str(sum(bool(failure) for *_, failure in judged)),
    )
    for kind, place, failure in judged:
        case = ElementTree.SubElement(suite, "testcase", classname=kind, name=place)
        if failure:
            ElementTree.SubElement(case, "failure", message=failure)
    ElementTree.indent(suite)
    return ElementTree.tostring(suite, encoding="unicode", xml_declaration=True) + "\n"


def _sentence(check: Check) -> str:
    """Describe a failed check in a sentence."""
    value = "none" if check.value is None else f"{check.value:.1e}"
    return (
        f"{check.id} {check.scenario}/{check.controller}: {check.quantity} is {value}, "
        f"must be {check.comparison} {check.limit:g} {check.unit}"
    )
