"""How a value is judged: the limits of all checks are in criteria.toml and nowhere else."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

ANY = "any"  # scenario and controller of a check that depends on neither


@dataclass(frozen=True, slots=True)
class Criterion:
    """A quantity and the largest value that passes; a value that is not finite fails."""

    id: str
    unit: str
    limit: float
    quantity: str  # what is measured
    reason: str  # why this limit
    proves: str  # what a value within the limit proves, and what it leaves open
    leaves_open: str

    def judge(self, value: float, scenario: str = ANY, controller: str = ANY) -> Check:
        """Return the check of a measured value."""
        finite = math.isfinite(value)
        return Check(
            id=self.id,
            scenario=scenario,
            controller=controller,
            quantity=self.quantity,
            unit=self.unit,
            value=float(value) if finite else None,
            limit=self.limit,
            comparison="<=",
            passed=finite and value <= self.limit,
            reason=self.reason,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """One judged value: a row of report.json, field for field."""

    id: str
    scenario: str
    controller: str
    quantity: str
    unit: str
    value: float | None  # None if it is not finite, as where one run fell and the other did not
    limit: float
    comparison: str
    passed: bool
    reason: str

    def __post_init__(self) -> None:
        """Raise if it passes beyond its limit, or fails within it."""
        if self.passed != (self.value is not None and self.value <= self.limit):
            raise ValueError(f"passed must follow from value and limit, got {self.passed}")
        if self.id not in CRITERIA:
            raise ValueError(f"check must be one of {', '.join(CRITERIA)}, got {self.id!r}")

    @property
    def rank(self) -> float:
        """How close it is to its limit or beyond it, among checks of one criterion."""
        return math.inf if self.value is None else self.value


def judged(values: Mapping[str, float], scenario: str, controller: str) -> tuple[Check, ...]:
    """Return the checks of measured values by id, in the order of the criteria."""
    known = [CRITERIA[id] for id in CRITERIA if id in values]
    return tuple(one.judge(values[one.id], scenario, controller) for one in known)


_TEXT = Path(__file__).with_name("criteria.toml").read_text(encoding="utf-8")
CRITERIA: Mapping[str, Criterion] = MappingProxyType(
    {id: Criterion(id=id, **one) for id, one in tomllib.loads(_TEXT).items()}
)
"""Every criterion by its id, in the order of the report; last those of another plant alone."""
