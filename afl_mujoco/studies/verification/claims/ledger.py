"""The claims ledger: C1 to C12 of the paper, judged."""

from __future__ import annotations

from collections.abc import Container

import numpy as np

from afl_mujoco.control.law import linearizing_force
from afl_mujoco.plant.dynamics import acceleration
from afl_mujoco.scenario.catalogue import SCENARIOS
from afl_mujoco.scenario.parameters import CartPoleParameters
from afl_mujoco.studies.verification.claims.claim import NOT_REPRODUCED, REPRODUCED, Claim
from afl_mujoco.studies.verification.claims.performance import (
    ADAPTIVE,
    FIXED,
    Runs,
    performance_claims,
)
from afl_mujoco.studies.verification.claims.shipped import Shipped

EXACT = 1e-10
"""Largest scaled error of an identity that counts as round-off."""


def linearisation_claim() -> Claim:
    """Judge C1: with (L1) the plant becomes z'' = u, phi'' = 3/(4l) (g sin + u cos)."""
    rng = np.random.default_rng(0)
    worst = 0.0
    for _ in range(1000):
        phi, phi_dot, u = rng.uniform((-1.5, -10.0, -100.0), (1.5, 10.0, 100.0))
        mass, length = rng.uniform((0.1, 0.05), (2.0, 1.0))
        p = CartPoleParameters(cart_mass=mass, half_length=length)
        force = linearizing_force(u, phi, phi_dot, mass, p.pole_mass, length, p.gravity)
        found = acceleration([0.0, phi, 0.0, phi_dot], force, p)
        turning = 0.75 / length * (p.gravity * np.sin(phi) + u * np.cos(phi))
        wanted = np.array([u, turning])
        worst = max(worst, float(np.max(np.abs(found - wanted) / (1.0 + np.abs(wanted)))))
    return Claim(
        id="C1",
        claim="with (L1), (P1) and (P2) become z'' = u, phi'' = 3/(4l) (g sin(phi) + u cos(phi))",
        figure="largest difference of an acceleration, relative to 1 plus its size",
        paper=0.0,
        here=worst,
        verdict=REPRODUCED if worst < EXACT else NOT_REPRODUCED,
        why="an identity up to round-off, over 1000 random states and plants",
    )


def decidable(runs: Container[tuple[str, str]]) -> bool:
    """Return whether the runs are all that the claims need: both controllers, every scenario."""
    return all((s, c) in runs for s in SCENARIOS for c in (FIXED, ADAPTIVE))


def judge_claims(runs: Runs, known: Shipped) -> tuple[Claim, ...]:
    """Judge C1 to C12 by runs that decide C2 to C8, and by what is shipped."""
    return (
        linearisation_claim(),
        *performance_claims(runs, known.readings),
        *known.claims,
    )
