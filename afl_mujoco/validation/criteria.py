"""The one place where a verdict's numbers are defined: quantity, unit, limit, reason."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import Any


@dataclass(frozen=True, slots=True, kw_only=True)
class Criterion:
    """A figure and the most it may be.

    Attributes
    ----------
    id
        As in `docs/verification.md`.
    quantity
        What is measured.
    unit
        Its unit.
    limit
        The largest value that passes.
    reason
        Why this limit.
    """

    id: str
    quantity: str
    unit: str
    limit: float
    reason: str

    def judge(self, value: float, scenario: str = "any", controller: str = "any") -> Check:
        """Return the check of a measured value; a value that is not finite fails.

        Parameters
        ----------
        value
            What was measured.
        scenario, controller
            Where it was measured.
        """
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
    """One judged figure: a row of the report, field for field.

    Attributes
    ----------
    id, quantity, unit, limit, reason
        As of `Criterion`.
    scenario, controller
        Where it was measured; ``"any"`` where it does not depend on them.
    value
        What was measured; ``None`` if there is no finite value, for example because one run fell
        and the other did not.
    comparison
        How value and limit compare when the check passes.
    passed
        Whether it does.
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

    def to_dict(self) -> dict[str, Any]:
        """Return the row as plain data."""
        return asdict(self)


_ALL_STATES = "m, rad, m/s, rad/s"

CRITERIA: Mapping[str, Criterion] = MappingProxyType(
    {
        c.id: c
        for c in (
            Criterion(
                id="A1",
                quantity="max |qacc - (P3),(P4)| / (1 + |(P3),(P4)|), 10 000 random states, plants",
                unit="1",
                limit=1e-11,
                reason="the same equations in other words: round-off of the larger terms, with "
                "margin",
            ),
            Criterion(
                id="A3",
                quantity="numbers in which a mutated MjModel (stat aside), or its qacc with "
                "friction, limits and contact, differs from a fresh compile",
                unit="count",
                limit=0,
                reason="a mutation that refreshes every derived constant leaves the very bits of a "
                "fresh compile",
            ),
            Criterion(
                id="A5",
                quantity="max |mj_step - textbook RK4 step| along the sampled run",
                unit=_ALL_STATES,
                limit=1e-13,
                reason="one step of the same method on the same equations: round-off",
            ),
            Criterion(
                id="B1",
                quantity="max |state_mujoco_exact - state_ode|",
                unit=_ALL_STATES,
                limit=1e-9,
                reason="one integrator (DOP853, rtol 1e-12) on both right-hand sides: only model "
                "form is left",
            ),
            Criterion(
                id="B2",
                quantity="max |state_mujoco_continuous - state_ode|",
                unit=_ALL_STATES,
                limit=1e-5,
                reason="RK4 at 1 ms, some 5e-6 here, all from the first fast milliseconds",
            ),
            Criterion(
                id="B2b",
                quantity="max |state_mujoco_continuous - state_ode_rk4|",
                unit=_ALL_STATES,
                limit=1e-10,
                reason="the same RK4 steps on both right-hand sides: round-off grown along the run",
            ),
            Criterion(
                id="B3",
                quantity="max |state_mujoco_sampled - state_ode_held|",
                unit=_ALL_STATES,
                limit=1e-8,
                reason="the same hold of control and schedule: MuJoCo's RK4 error at 1 ms is left, "
                "some 5e-10 here",
            ),
        )
    }
)
"""Every criterion by its id."""
