"""One case, run in every simulator, judged and explained."""

from __future__ import annotations

from dataclasses import dataclass

from afl_mujoco.simulation.mujoco_rollout import simulate_mujoco
from afl_mujoco.studies.cases import DEPLOYED, REPORTED, Case, Run, closed_loop_runs, reported_runs
from afl_mujoco.studies.run import Run as Deployed
from afl_mujoco.studies.run import run_of
from afl_mujoco.studies.verification.check import Check
from afl_mujoco.studies.verification.checks.closed_loop_checks import closed_loop_checks
from afl_mujoco.studies.verification.checks.error_budget import budget_curves
from afl_mujoco.studies.verification.checks.explanation import Explanation, explain
from afl_mujoco.studies.verification.curves import Curves, select_curves


@dataclass(frozen=True, slots=True)
class Judged:
    """What a worker finds about one case.

    Attributes
    ----------
    checks, runs, row, explanation, curves
        As in `Result`; its tables are made from the explanation.
    """

    checks: tuple[Check, ...]
    runs: tuple[Run, ...]
    row: Deployed
    explanation: Explanation
    curves: Curves


def judge(case: Case) -> Judged:
    """Run and judge one scenario with one controller.

    The codes are compared on the ideal loop; requirements are of the run as deployed.
    """
    asked, controller, settings = case
    scenario = asked.ideal
    runs = closed_loop_runs(scenario, controller, settings)
    deployed = runs[DEPLOYED] if asked == scenario else simulate_mujoco(asked, controller)
    parts = budget_curves(scenario, controller, runs)
    explanation = explain(scenario, controller, runs, parts, full=settings.full)
    return Judged(
        closed_loop_checks(scenario, controller, runs),
        reported_runs(scenario, controller, runs),
        run_of(asked, controller, deployed),
        explanation,
        select_curves(
            scenario,
            controller,
            {name: runs[name] for name in REPORTED},
            timestep=settings.timestep,
            parts=parts,
            energy=explanation.energy,
        ),
    )
