"""What a verification found: checks, runs, claims, what explains them, and curves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.studies.cases import DECISIVE, Run, Settings
from afl_mujoco.studies.verification.check import Check
from afl_mujoco.studies.verification.checks.convergence import Refinement
from afl_mujoco.studies.verification.checks.error_budget import ErrorBudget
from afl_mujoco.studies.verification.checks.explanation import Omission
from afl_mujoco.studies.verification.checks.ledger import Ledger
from afl_mujoco.studies.verification.claims.claim import Claim
from afl_mujoco.studies.verification.claims.schedules import Comparison
from afl_mujoco.studies.verification.curves import Curves
from afl_mujoco.studies.verification.decisions import DECISIONS

PASS, FAIL = "pass", "fail"


def verdict_of(checks: tuple[Check, ...]) -> Literal["pass", "fail"]:
    """Return whether every check holds, and there is one."""
    return "pass" if checks and all(check.passed for check in checks) else "fail"


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """The result of a verification.

    Attributes
    ----------
    verdict
        "pass" if every check holds, and there is one; "fail" otherwise.
    checks
        Every judged figure.
    runs
        Every run's metrics.
    claims
        The paper's claims C1 to C12; empty unless the runs are all that they need.
    random_schedules
        Adaptive against fixed gains over random schedules, published and retuned: behind C9.
    error_budgets, ledgers, omissions
        What explains the cases.
    studies
        The refinement studies; empty unless the verification was full.
    decisions
        What was decided where the paper is silent, by id.
    settings
        Step sizes.
    scenarios
        What was simulated.
    curves
        Every case over time, by ``scenario/controller``.
    """

    verdict: Literal["pass", "fail"]
    checks: tuple[Check, ...]
    runs: tuple[Run, ...]
    claims: tuple[Claim, ...] = ()
    random_schedules: Mapping[str, Comparison] = field(default_factory=dict)
    error_budgets: tuple[ErrorBudget, ...] = ()
    ledgers: tuple[Ledger, ...] = ()
    omissions: tuple[Omission, ...] = ()
    studies: tuple[Refinement, ...] = ()
    decisions: Mapping[str, str] = field(default_factory=lambda: dict(DECISIONS))
    settings: Settings = field(default_factory=Settings)
    scenarios: tuple[Scenario, ...]
    curves: Mapping[str, Curves]

    def __post_init__(self) -> None:
        """Raise if the parts contradict each other: a report must not."""
        if self.verdict != verdict_of(self.checks):
            raise ValueError(
                f"verdict must be {verdict_of(self.checks)!r}, as the checks say, got "
                f"{self.verdict!r}"
            )
        names = {scenario.name for scenario in self.scenarios}
        for run in self.runs:
            if run.scenario not in names:
                raise ValueError(f"scenarios must hold that of every run, {run.scenario!r} is not")
            if f"{run.scenario}/{run.controller}" not in self.curves:
                raise ValueError(f"curves must hold {run.scenario}/{run.controller}, a run's")

    @property
    def passed(self) -> bool:
        """Whether every check holds."""
        return self.verdict == PASS

    @property
    def failed_checks(self) -> tuple[Check, ...]:
        """The checks that do not hold."""
        return tuple(check for check in self.checks if not check.passed)

    @property
    def decisive_runs(self) -> list[Run]:
        """The runs whose metrics count, one for each case."""
        return [run for run in self.runs if run.simulator == DECISIVE]

    def curves_of(self, scenario: str) -> list[Curves]:
        """Return the curves of a scenario under each controller."""
        return [one for one in self.curves.values() if one.scenario == scenario]
