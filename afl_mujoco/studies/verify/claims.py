"""The claims C1 to C12 of the paper, judged by the runs of a verification and what is shipped."""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any, Literal

import numpy as np

from afl_mujoco.control.catalogue import CONTROLLERS
from afl_mujoco.control.law import linearizing_force
from afl_mujoco.files import read_json
from afl_mujoco.plants.cartpole import CART_POLE
from afl_mujoco.plants.cartpole_equations import acceleration
from afl_mujoco.report.blocks import Status
from afl_mujoco.scenario.catalogue import SCENARIOS
from afl_mujoco.scenario.parameters import CartPoleParameters
from afl_mujoco.simulation.metrics import Metrics, metrics
from afl_mujoco.simulation.ode import simulate_ode

REPRODUCED, IN_PART = "reproduced", "reproduced in part"
NOT_REPRODUCED, UNDETERMINED = "not reproduced", "cannot be determined"
EVERY = f"{REPRODUCED} under every reading tried"
NONE = f"{NOT_REPRODUCED} under any reading tried"
RANDOM, FITTED = "met under some readings", "some reading can be fitted"
"""Verdicts on what hangs on what the paper leaves open (a reading of it). In place of `RANDOM`
stands the share, behind what holds without any. That a reading can be fitted, of so many unknowns,
is no evidence that it is so."""

GROUPS: Mapping[str, tuple[Status, str]] = {
    REPRODUCED: ("good", "hold"),
    EVERY: ("good", "hold"),
    IN_PART: ("neutral", "in part"),
    RANDOM: ("bad", "not"),
    FITTED: ("open", "under some readings"),
    NOT_REPRODUCED: ("bad", "not"),
    NONE: ("bad", "not"),
    UNDETERMINED: ("open", "open"),
}
"""Status of each kind of verdict, and how the headline counts it."""

FIXED, ADAPTIVE = "fixed", "adaptive"

TABLE_3 = {
    "step-step": (0.9501, 0.5888, 38.03),
    "step-trapezoid": (1.0007, 0.7077, 29.28),
    "trapezoid-step": (2.4867, 1.4996, 39.70),
    "trapezoid-trapezoid": (2.5476, 1.6137, 36.66),
}
"""The paper's Table 3: the objective of each case with fixed and with adaptive gains, and by how
much adaptive gains lower it [%]."""

CASES = tuple(TABLE_3)

NEAR = 5.0  # how close to the paper's an improvement must come to be reproduced [percentage points]

IMPULSE_TIME = 10.0

EXACT = 1e-10  # largest scaled error of an identity that counts as round-off

Runs = Mapping[tuple[str, str], Metrics]
"""Metrics by scenario and controller."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Claim:
    """One row of the claims ledger."""

    id: str  # C1 to C12
    claim: str  # what the paper says
    figure: str  # what `paper` and `here` measure, with its unit
    paper: float | None  # the paper's number and ours; None if there is none
    here: float | None
    verdict: str  # one of those above
    why: str  # the reason for the verdict, one sentence


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """How adaptive gains do against fixed ones over many schedules."""

    schedules: int
    share: float  # of the schedules on which the adaptive gains have the lower objective
    interval: tuple[float, float]  # its exact (Clopper-Pearson) 95 % confidence interval
    quantiles: Mapping[str, float | None]  # of the improvement [%]; a fall is infinitely bad


@dataclass(frozen=True, slots=True, kw_only=True)
class Readings:
    """The improvements of Table 3's cases under readings of what the paper leaves open."""

    drawn: int  # number of readings drawn at random
    near: Mapping[str, int]  # under how many of those each improvement is near the paper's
    fitted: Mapping[str, Mapping[str, float]]  # [%] by case and by the reading fitted to Table 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Shipped:
    """The content of the file that `make claims` writes: C9 to C12, and readings."""

    schema: Literal[1] = 1
    command: str
    versions: Mapping[str, str]
    readings: Readings
    claims: tuple[Claim, ...]
    random_schedules: Mapping[str, Comparison]  # published and retuned gains: behind C9


def shipped() -> Shipped:
    """Return the content of the file; anything else in its place raises a `FileError`."""
    file = resources.files("afl_mujoco.studies") / "data" / "claims.json"
    return read_json(file, Shipped, "is not what make claims writes")


def decidable(runs: Container[tuple[str, str]]) -> bool:
    """Return whether the runs are all that the claims need: both controllers, every scenario."""
    return all((s, c) in runs for s in SCENARIOS for c in (FIXED, ADAPTIVE))


def judge_claims(runs: Runs, known: Shipped) -> tuple[Claim, ...]:
    """Judge C1 to C12 by runs that decide C2 to C8, and by what is shipped."""
    return (linearisation_claim(), *performance_claims(runs, known.readings), *known.claims)


def verdict(share: float, enough: float = 1.0, least: float = 0.0) -> str:
    """Return the verdict on a share of what was claimed; between `least` and `enough`, in part."""
    return REPRODUCED if share >= enough else IN_PART if share > least else NOT_REPRODUCED


def verdict_on_readings(assumed: bool, fitted: Iterable[bool], drawn: float) -> str:
    """Return the verdict on a claim from whether it holds under readings.

    It may hold as `assumed` under D3 and D4, which were chosen before any was tried, under those
    that were `fitted` so that it would, and under a share of those `drawn` at random.
    """
    if drawn:
        own = REPRODUCED if assumed else NOT_REPRODUCED
        every = assumed and drawn == 1.0
        return EVERY if every else f"{own}; met under {100.0 * drawn:.1f} % of readings"
    return FITTED if assumed or any(fitted) else NONE


def kind(verdict: str) -> str:
    """Return a verdict without the share in it."""
    return RANDOM if "; met under " in verdict else verdict


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
        claim="(L1) turns (P1), (P2) into z″ = u",
        figure="largest relative difference from z″ = u, φ″ = 3/(4l) (g sin φ + u cos φ)",
        paper=0.0,
        here=worst,
        verdict=REPRODUCED if worst < EXACT else NOT_REPRODUCED,
        why="an identity up to round-off, relative to 1 plus its size, over 1000 random states and "
        "plants",
    )


def performance_claims(runs: Runs, tried: Readings) -> Iterator[Claim]:
    """Judge C2 to C8."""
    count, of, latest = _settled(runs, CASES)
    yield Claim(
        id="C2",
        claim="from −60 degrees to rest",
        figure="latest settling of any state into 2 % of its peak, four cases [s]",
        paper=None,
        here=latest,
        verdict=verdict(count / of),
        why=f"{count} of {of} runs of the four cases settle in MuJoCo within 20 s",
    )
    for place, case in enumerate(CASES):
        yield _improvement(f"C{3 + place}", case, runs, tried)
    yield _overshoot_and_settling(runs)
    count, of, latest = _settled(runs, [name for name in SCENARIOS if name.endswith("-impulse")])
    yield Claim(
        id="C8",
        claim="the impulse at 10 s is rejected",
        figure="latest return after the impulse into 2 % of the peak of the whole run [s]",
        paper=None,
        here=None if latest is None else latest - IMPULSE_TIME,
        verdict=verdict(count / of),
        why=f"{count} of {of} disturbed runs settle again before 20 s",
    )


def _settled(runs: Runs, scenarios: Sequence[str]) -> tuple[int, int, float | None]:
    """Return how many runs settle into 2 %, of how many, and the latest time, if all do."""
    found = [runs[s, c] for s in scenarios for c in (FIXED, ADAPTIVE)]
    times = [[one[f"settling_2pc_{x}"] for x in CART_POLE.states] for one in found]
    reached = [max(t for t in some if t is not None) for some in times if None not in some]
    latest = max(reached) if len(reached) == len(found) else None
    return len(reached), len(found), latest


def _improvement(id: str, case: str, runs: Runs, tried: Readings) -> Claim:
    """C3 to C6: the improvement of one case of Table 3."""
    _, _, published = TABLE_3[case]
    fixed, adaptive = (runs[case, who]["objective"] for who in (FIXED, ADAPTIVE))
    here = None if fixed is None or adaptive is None else 100.0 * (1.0 - adaptive / fixed)
    under_d3 = here is not None and abs(here - published) <= NEAR
    fitted, share = tried.fitted[case], tried.near[case] / tried.drawn
    fits = [abs(found - published) <= NEAR for found in fitted.values()]
    closest = min(fitted, key=lambda name: abs(fitted[name] - published))
    said = "one of the two runs did not complete" if here is None else f"it is {here:.1f} %"
    return Claim(
        id=id,
        claim=f"improvement on {case}",
        figure="how much adaptive gains lower the objective (O1) [%]",
        paper=published,
        here=here,
        verdict=verdict_on_readings(under_d3, fits, share),
        why="the paper gives neither schedules nor scales: the improvement is within "
        f"{NEAR:g} points of its own under {100.0 * share:.1f} % of {tried.drawn} readings drawn "
        f"at random (make claims); on the schedules of D3 with the scales of D4 {said} in MuJoCo; "
        f"readings can be fitted to it, as {sum(fits)} of {len(fits)} of make readings were "
        f"({closest}: {fitted[closest]:.1f} %), which is no evidence",
    )


def _overshoot_and_settling(runs: Runs) -> Claim:
    """C7: overshoot and settling time of every state fall in every case."""
    names = [f"{kind}_{x}" for kind in ("overshoot", "settling_2pc") for x in CART_POLE.states]
    pairs = ((runs[s, ADAPTIVE][x], runs[s, FIXED][x]) for s in CASES for x in names)
    cut = [a is not None and (b is None or a < b) for a, b in pairs]  # a missing one is infinite
    return Claim(
        id="C7",
        claim="less overshoot, quicker settling",
        figure=f"metrics that adaptive gains cut, 4 cases x 4 states x 2 [of {len(cut)}]",
        paper=float(len(cut)),
        here=float(sum(cut)),
        verdict=verdict(sum(cut) / len(cut), least=0.5),
        why=f"{sum(cut)} of {len(cut)} fall; overshoot is the excursion beyond zero, settling is "
        "into 2 % of the peak",
    )


TERMS = ("iae_z", "iae_phi", "max_force")  # the metrics that the objective (O1) adds up


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectiveScales:
    """The scales by which the terms of (O1) are divided (decision D4)."""

    iae_z: float  # integral of abs(z) [m s]
    iae_phi: float  # integral of abs(phi) [rad s]
    max_force: float  # largest abs(F) [N]


def objective(iae_z: Any, iae_phi: Any, max_force: Any, scales: ObjectiveScales) -> Any:
    """Return the objective of Eq. (O1), of floats or arrays."""
    return iae_z / scales.iae_z + iae_phi / scales.iae_phi + max_force / scales.max_force


def with_objective(figures: Metrics, scales: ObjectiveScales) -> Metrics:
    """Return the metrics with the objective (O1) in front."""
    iae_z, iae_phi, max_force = (figures[name] for name in TERMS)
    known = None not in (iae_z, iae_phi, max_force)
    return {"objective": objective(iae_z, iae_phi, max_force, scales) if known else None, **figures}


@cache
def nominal_scales(sample_period: float) -> ObjectiveScales:
    """Return the scales of the objective: the fixed gains on the nominal plant (D4)."""
    scenario, controller = SCENARIOS["nominal"], CONTROLLERS["fixed"]
    run = simulate_ode(scenario, controller, sample_period=sample_period)
    figures: Any = metrics(scenario, controller, run)
    return ObjectiveScales(**{name: figures[name] for name in TERMS})
