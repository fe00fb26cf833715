"""A criterion, and the check of a measured value against it."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Criterion:
    """A quantity and its largest allowed value.

    Attributes
    ----------
    id
        As in `criteria.CRITERIA`.
    quantity
        What is measured.
    unit
        Its unit.
    limit
        The largest value that passes.
    reason
        Why this limit.
    proves, leaves_open
        What a value within the limit proves, and what it does not.
    """

    id: str
    quantity: str
    unit: str
    limit: float
    reason: str
    proves: str
    leaves_open: str

    def judge(self, value: float, scenario: str = "any", controller: str = "any") -> Check:
        """Return the check of a measured value; a value that is not finite fails."""
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
    """One judged value: a row of the report, field for field.

    Attributes
    ----------
    id, quantity, unit, limit, reason
        As in `Criterion`.
    scenario, controller
        Where it was measured; ``"any"`` if it does not depend on them.
    value
        What was measured; ``None`` if there is no finite value, for example because one run fell
        and the other did not.
    comparison
        How value and limit compare if the check passes.
    passed
        Whether the check passes.
    """

    id: str
    scenario: str
    controller: str
    quantity: str
    unit: str
    value: float | None
    limit: float
    comparison: str
    passed: bool
    reason: str

    def __post_init__(self) -> None:
        """Raise if it passes beyond its limit, or fails within it."""
        if self.passed != (self.value is not None and self.value <= self.limit):
            raise ValueError(f"passed must follow from value and limit, got {self.passed}")
