"""Why the runs of one scenario and controller differ by as much as they do: A6, B2o, B4 to B7."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.catalogue import CONTROLLERS
from afl_mujoco.control.controller import Controller
from afl_mujoco.scenario.catalogue import SCENARIOS
from afl_mujoco.scenario.parameters import MOMENTA, QUASI_STATIC, STRETCHING_ROD, VELOCITIES
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.mujoco_rollout import simulate_mujoco
from afl_mujoco.simulation.ode import simulate_ode
from afl_mujoco.simulation.trajectory import COMPLETED, Trajectory
from afl_mujoco.studies.verification.check import Check
from afl_mujoco.studies.verification.checks.closed_loop_checks import state_difference
from afl_mujoco.studies.verification.checks.convergence import (
    STEPS,
    Refinement,
    Study,
    continuous_study,
    difference,
    sampled_study,
    schedule_study,
    studied,
)
from afl_mujoco.studies.verification.checks.error_budget import ErrorBudget, error_budget
from afl_mujoco.studies.verification.checks.ledger import Ledger, ledger
from afl_mujoco.studies.verification.criteria import CRITERIA

CAPSULE_EXCESS = 0.13
"""Relative excess of the inertia of the drawn capsule over that of the slender rod."""

ORDERS = {"continuous": 4.0, "sampled": 1.0, "schedule": 2.0}
"""The order that each refinement study should show."""

ORDER_CHECKS = {"continuous": "B2o", "sampled": "B4", "schedule": "B4s"}
"""The check that judges each order."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Omission:
    """What the paper's treatment of changing parameters leaves out (decision D9).

    Each value is the largest change of any state at any instant [m, rad, m/s, rad/s], in the ODE.

    Attributes
    ----------
    scenario, controller
        What was simulated.
    stretching_rod
        Effect of the terms in the rate of l, velocities kept at steps.
    momenta_kept
        Effect of keeping the momenta at steps instead, with M and l frozen otherwise; ``None`` if
        one run fell and the other did not.
    """

    scenario: str
    controller: str
    stretching_rod: float | None
    momenta_kept: float | None


@dataclass(frozen=True, slots=True)
class Explanation:
    """The explanation of one scenario and controller.

    Attributes
    ----------
    checks
        The judged values.
    budget, ledger, omission
        The tables; ``None`` for a run that did not complete.
    studies
        The refinement studies behind B2o, B4 and B4s.
    energy
        The ledger of energy over time, as from `ledger`; empty without a ledger.
    """

    checks: tuple[Check, ...] = ()
    budget: ErrorBudget | None = None
    ledger: Ledger | None = None
    omission: Omission | None = None
    studies: tuple[Refinement, ...] = ()
    energy: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)


def explain(
    scenario: Scenario,
    controller: Controller,
    runs: Mapping[str, Trajectory],
    parts: Mapping[str, NDArray[np.float64]],
    *,
    full: bool,
) -> Explanation:
    """Explain the runs of one scenario and controller.

    The studies end half a second after the last breakpoint; the error budget covers the whole run.

    Parameters
    ----------
    full
        Whether to run the refinement studies, the ledger and the comparison with what the paper
        omits, or only the error budget.
    """
    if any(run.outcome.kind != COMPLETED for run in runs.values()):
        return Explanation()
    times = runs["mujoco sampled"].time
    budget = error_budget(scenario, controller, times, parts) if parts else None
    values = {} if budget is None else {"B5": budget.residual_share}
    if not full:
        return Explanation(_judge(values, scenario, controller), budget)
    part = studied(scenario)
    reference = simulate_ode(part, controller, sample_period=STEPS[0])
    sampled, residue = sampled_study(part, controller, reference)
    continuous = continuous_study(part, controller, reference)
    studies = {
        "continuous": continuous,
        "sampled": sampled,
        "schedule": schedule_study(part, controller),
    }
    refinements = tuple(
        Refinement.of(
            study, study=name, expected=ORDERS[name],
            scenario=scenario.name, controller=controller.name,
        )
        for name, study in studies.items()
        if study is not None
    )  # fmt: skip
    book, energy = ledger(part, controller)
    agreement, omission = _omission(part, controller, reference)
    values |= {
        "A6e": book.energy_residual,
        "A6p": book.momentum_residual,
        "B4r": residue,
        "B6": continuous.reduction,
        "B7": agreement,
        **{ORDER_CHECKS[r.study]: r.deviation for r in refinements},
    }
    checks = _judge(values, scenario, controller)
    return Explanation(checks, budget, book, omission, refinements, energy)


def _judge(
    values: dict[str, float], scenario: Scenario, controller: Controller
) -> tuple[Check, ...]:
    """Return the checks of measured values, in the order of the criteria."""
    return tuple(
        CRITERIA[id].judge(values[id], scenario.name, controller.name)
        for id in CRITERIA
        if id in values
    )


def _omission(
    scenario: Scenario, controller: Controller, paper: Trajectory
) -> tuple[float, Omission]:
    """Return how far both sides agree on what the paper omits, and how much it matters."""
    h = STEPS[0]

    def ode(dynamics: str, jumps: str) -> Trajectory:
        return simulate_ode(scenario, controller, sample_period=h, dynamics=dynamics, jumps=jumps)

    stretching, kept = ode(STRETCHING_ROD, VELOCITIES), ode(QUASI_STATIC, MOMENTA)
    exact = simulate_mujoco(
        scenario, controller, "exact", timestep=h, dynamics=STRETCHING_ROD, jumps=MOMENTA
    )
    agreement = state_difference(exact, ode(STRETCHING_ROD, MOMENTA))
    return agreement, Omission(
        scenario=scenario.name,
        controller=controller.name,
        stretching_rod=_finite(state_difference(stretching, paper)),
        momenta_kept=_finite(state_difference(kept, paper)),
    )


def _finite(value: float) -> float | None:
    """Return a difference, None if it is not finite."""
    return value if math.isfinite(value) else None


def plateau_check() -> Check:
    """Run B6d: the plateau test on a model that is different on purpose."""
    scenario, controller = studied(SCENARIOS["nominal"]), CONTROLLERS["fixed"]
    excess = CAPSULE_EXCESS * scenario.pole_mass * scenario.half_length.at(0.0) ** 2 / 3.0

    def thicken(spec: mujoco.MjSpec) -> None:
        spec.joint("hinge").armature = excess

    reference = simulate_ode(scenario, controller, sample_period=STEPS[0])
    errors = tuple(
        difference(
            simulate_mujoco(scenario, controller, "continuous", timestep=h, edit=thicken),
            reference,
        )
        for h in STEPS
    )
    return CRITERIA["B6d"].judge(abs(1.0 - Study(STEPS, errors).reduction))
