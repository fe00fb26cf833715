"""A verification in words: verdict, checks, scenarios, what explains them, claims, decisions."""

from __future__ import annotations

from afl_mujoco.document.blocks import Section, Verdict
from afl_mujoco.simulation.trajectory import COMPLETED
from afl_mujoco.studies.verification.result import Result
from afl_mujoco.studies.verification.sections.checks import checks_section
from afl_mujoco.studies.verification.sections.claims import claims_section
from afl_mujoco.studies.verification.sections.decisions import decisions_section
from afl_mujoco.studies.verification.sections.evidence import evidence_sections
from afl_mujoco.studies.verification.sections.scenarios import scenarios_section

AGREE = (
    "MuJoCo and the equations agree within every limit. This is a verdict on the two codes, not on "
    "the paper or on a controller."
)
DIFFER = (
    "At least one figure lies beyond its limit: no conclusion may rest on the numbers below until "
    "that is understood."
)


def verdict(result: Result) -> Verdict:
    """Return whether every check holds."""
    total, failed = len(result.checks), len(result.failed_checks)
    ended = _not_completed(result)
    if result.passed:
        return Verdict(True, f"all {total} checks hold{ended}", AGREE)
    return Verdict(False, f"{failed} of {total} checks fail{ended}", DIFFER)


def _not_completed(result: Result) -> str:
    """Say which cases did not complete: that two codes agree on a fall does not undo it."""
    runs = [run for run in result.runs if run.outcome != COMPLETED]
    ended = {(run.scenario, run.controller) for run in runs}
    if not ended:
        return ""
    first = f"{runs[0].scenario} with {runs[0].controller} {runs[0].outcome}, {runs[0].simulator}"
    more = "; ..." if len(ended) > 1 else ""
    cases = len(result.decisive_runs)
    return f", but {len(ended)} of {cases} cases did not complete ({first}{more})"


def sections(result: Result) -> list[Section]:
    """Return what a report says of a verification."""
    return [
        checks_section(result),
        scenarios_section(result),
        *evidence_sections(result),
        claims_section(result),
        decisions_section(result),
    ]
