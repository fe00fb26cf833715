"""A verification in words: verdict, checks, scenarios, what explains them, claims, decisions."""

from __future__ import annotations

from afl_mujoco.report.old import Block, Section, Verdict
from afl_mujoco.scenario.requirements import NONE
from afl_mujoco.simulation.trajectory import COMPLETED
from afl_mujoco.studies.opening import Need, Shown, opening_blocks
from afl_mujoco.studies.tables import grouped, how, requirements_matrix
from afl_mujoco.studies.verification.result import Result
from afl_mujoco.studies.verification.sections.checks import checks_section
from afl_mujoco.studies.verification.sections.claims import claims_section
from afl_mujoco.studies.verification.sections.decisions import decisions_section
from afl_mujoco.studies.verification.sections.evidence import evidence_sections
from afl_mujoco.studies.verification.sections.scenarios import scenarios_section

DEPLOYED = "mujoco sampled"

AGREE = (
    "MuJoCo and the equations agree within every limit. This is a verdict on the two codes, not on "
    "the paper or on a controller."
)
MISSED = (
    "MuJoCo and the equations agree within every limit. As deployed, at least one controller does "
    "not meet the requirements of its scenario."
)
DIFFER = (
    "At least one value is beyond its limit: draw no conclusion from the numbers below until this "
    "is understood."
)


def verdict(result: Result) -> Verdict:
    """Return whether every check holds, and whether the controllers meet the requirements."""
    total, failed = len(result.checks), len(result.failed_checks)
    missing = [run for run in result.rows if run.missed]
    required = "; all requirements are met" if result.rows else ""
    if missing:
        said = [f"{run.controller} on {run.scenario} {how(run.failure)}" for run in missing[:3]]
        required = f"; {len(missing)} of {len(result.rows)} runs fail: {', '.join(said)}"
    required += _not_completed(result)
    if failed:
        return Verdict(False, f"{failed} of {total} checks fail{required}", DIFFER)
    meaning = AGREE if result.passed else MISSED
    return Verdict(result.passed, f"all {total} checks hold{required}", meaning)


def _not_completed(result: Result) -> str:
    """Say which cases did not complete, if no requirement says so."""
    named = {(run.scenario, run.controller) for run in result.rows if run.missed}
    runs = [
        run
        for run in result.runs
        if run.outcome != COMPLETED and (run.scenario, run.controller) not in named
    ]
    ended = {(run.scenario, run.controller) for run in runs}
    if not ended:
        return ""
    first = f"{runs[0].scenario} with {runs[0].controller} {runs[0].outcome}, {runs[0].simulator}"
    more = "; ..." if len(ended) > 1 else ""
    cases = len(result.decisive_runs)
    return f", but {len(ended)} of {cases} cases did not complete ({first}{more})"


def opening(result: Result) -> list[Block]:
    """Return the system, the controllers on the first scenario, and what each run needed."""
    scenario = result.scenarios[0]
    shown = {}
    for one in result.curves_of(scenario.name):
        state, force = one.states[DEPLOYED], one.forces[DEPLOYED]
        shown[one.controller] = Shown(one.time[: len(state)], state[:, 0], state[:, 1], force)
    needs = [
        Need(
            run.scenario, run.controller, run.metrics, run.outcome
        )
        for run in result.runs
        if run.simulator == DEPLOYED
    ]  # fmt: skip
    return opening_blocks("report-opening", scenario, shown, needs)


def sections(result: Result) -> list[Section]:
    """Return what a report says about a verification."""
    return [
        *_requirements(result),
        checks_section(result),
        scenarios_section(result),
        *evidence_sections(result),
        claims_section(result),
        decisions_section(result),
    ]


def _requirements(result: Result) -> list[Section]:
    """Return how requirements are met; nothing if completion is the only one and all complete."""
    asked = any(one.requirements != NONE or one != one.ideal for one in result.scenarios)
    if not asked and not any(run.missed for run in result.rows):
        return []
    blocks: list[Block] = [
        "Judged in MuJoCo as deployed, with the imperfections of the file; the codes are compared "
        "without them."
    ]
    for scenario in result.scenarios:
        cases = grouped([run for run in result.rows if run.scenario == scenario.name])
        draws = {name: runs for (_, name), runs in cases.items()}
        needs = {name: [run.metrics for run in runs] for name, runs in draws.items()}
        blocks.append(requirements_matrix(scenario, draws, needs))
    return [Section("Requirements", "requirements", blocks)]
