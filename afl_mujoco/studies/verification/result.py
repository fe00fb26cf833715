"""What a verification found: checks, runs, claims, explanations, and curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.metrics import UNITS
from afl_mujoco.studies.cases import DECISIVE, REPORTED, Run, Settings
from afl_mujoco.studies.run import Rows
from afl_mujoco.studies.run import Run as Deployed
from afl_mujoco.studies.verification.check import Check
from afl_mujoco.studies.verification.checks.convergence import Refinement
from afl_mujoco.studies.verification.checks.error_budget import ErrorBudget
from afl_mujoco.studies.verification.checks.explanation import Omission
from afl_mujoco.studies.verification.checks.ledger import Ledger
from afl_mujoco.studies.verification.claims.claim import Claim, Comparison
from afl_mujoco.studies.verification.criteria import CRITERIA
from afl_mujoco.studies.verification.curves import Curves
from afl_mujoco.studies.verification.decisions import DECISIONS


def verdict_of(checks: tuple[Check, ...], rows: Sequence[Deployed] = ()) -> Literal["pass", "fail"]:
    """Return whether every check holds, and there is one, and every requirement is met."""
    missed = any(run.missed for run in rows)
    holds = bool(checks) and all(check.passed for check in checks)
    return "pass" if holds and not missed else "fail"


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """The result of a verification.

    Attributes
    ----------
    verdict
        "pass" if every check holds, and there is one, and every requirement is met; "fail"
        otherwise.
    checks
        Every judged value.
    runs
        Metrics of every run.
    rows
        Each controller judged by the requirements of each scenario, as deployed.
    claims
        The paper's claims C1 to C12; empty unless all runs that they need were made.
    random_schedules
        Adaptive against fixed gains over random schedules, published and retuned: behind C9.
    error_budgets, ledgers, omissions
        Tables that explain the cases.
    studies
        The refinement studies; empty unless the verification was full.
    decisions
        Decisions taken where the paper is silent, by id.
    settings
        Step sizes.
    scenarios
        The scenarios that were simulated.
    curves
        Every case over time, by ``scenario/controller``.
    """

    verdict: Literal["pass", "fail"]
    checks: tuple[Check, ...]
    runs: tuple[Run, ...]
    rows: Rows = ()
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
        """Raise if the parts contradict each other."""
        expected = verdict_of(self.checks, self.rows)
        if self.verdict != expected:
            raise ValueError(f"verdict must be {expected!r}, as judged, got {self.verdict!r}")
        for check in self.checks:
            if check.id not in CRITERIA:
                raise ValueError(f"check must be one of {', '.join(CRITERIA)}, got {check.id!r}")
        if self.random_schedules and "published" not in self.random_schedules:
            raise ValueError("random_schedules must hold the published gains")
        self._require_runs()

    def _require_runs(self) -> None:
        """Raise unless every scenario has runs, and every case each simulator, metric and curve."""
        simulated: dict[tuple[str, str], list[str]] = {}
        for run in self.runs:
            simulated.setdefault((run.scenario, run.controller), []).append(run.simulator)
            if missing := UNITS.keys() - run.metrics.keys():
                raise ValueError(f"metrics of a run must hold {min(missing)}")
        for case, simulators in simulated.items():
            if sorted(simulators) != sorted(REPORTED):
                raise ValueError(f"runs must hold each simulator once, {'/'.join(case)} does not")
            if "/".join(case) not in self.curves:
                raise ValueError(f"curves must hold {'/'.join(case)}, a run's")
        if {scenario.name for scenario in self.scenarios} != {name for name, _ in simulated}:
            raise ValueError("scenarios must be those of the runs")

    @property
    def passed(self) -> bool:
        """Whether every check holds and every requirement is met."""
        return self.verdict == "pass"

    @property
    def failed_checks(self) -> tuple[Check, ...]:
        """The checks that do not hold."""
        return tuple(check for check in self.checks if not check.passed)

    @property
    def decisive_runs(self) -> list[Run]:
        """The runs whose metrics count, one for each case."""
        return [run for run in self.runs if run.simulator == DECISIVE]

    def outcome_of(self, run: Run, simulator: str) -> str:
        """Return how the case of a run ended in a simulator."""
        case = (run.scenario, run.controller, simulator)
        (outcome,) = (
            r.outcome for r in self.runs if (r.scenario, r.controller, r.simulator) == case
        )
        return outcome

    def curves_of(self, scenario: str) -> list[Curves]:
        """Return the curves of a scenario under each controller."""
        return [one for one in self.curves.values() if one.scenario == scenario]
