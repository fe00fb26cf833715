"""The claims that the campaign's own runs decide: C2 to C8, in MuJoCo."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from afl_mujoco.scenario.catalogue import SCENARIOS
from afl_mujoco.simulation.metrics import STATES, Metrics
from afl_mujoco.studies.verification.claims.claim import (
    Claim,
    verdict,
    verdict_on_readings,
)
from afl_mujoco.studies.verification.claims.shipped import Readings

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

NEAR = 5.0
"""How close to the paper's an improvement must come to be reproduced [percentage points]."""

PUBLISHED_IMPROVEMENT = {case: row[2] for case, row in TABLE_3.items()}
"""By how much adaptive gains lower the objective of each case [%]."""

IMPULSE_TIME = 10.0

Runs = Mapping[tuple[str, str], Metrics]
"""Metrics by scenario and controller."""


def performance_claims(runs: Runs, tried: Readings) -> Iterator[Claim]:
    """Judge C2 to C8."""
    yield _stabilised(runs)
    for place, case in enumerate(CASES):
        yield _improvement(f"C{3 + place}", case, runs, tried)
    yield _overshoot_and_settling(runs)
    yield _impulse(runs)


def _settled(figures: Metrics) -> float | None:
    """Return when the last state entered its 2 % band for good, or None if one never did."""
    times = [figures[f"settling_2pc_{x}"] for x in STATES]
    return None if None in times else max(t for t in times if t is not None)


def _stabilised(runs: Runs) -> Claim:
    """C2: all states go to zero from -60 degrees."""
    calm = [_settled(runs[s, c]) for s in PUBLISHED_IMPROVEMENT for c in (FIXED, ADAPTIVE)]
    reached = [time for time in calm if time is not None]
    return Claim(
        id="C2",
        claim="the controller drives all states to zero from -60 degrees",
        figure="latest settling of any state into 2 % of its peak, four cases [s]",
        paper=None,
        here=max(reached) if len(reached) == len(calm) else None,
        verdict=verdict(len(reached) / len(calm)),
        why=f"{len(reached)} of {len(calm)} runs of the four cases settle in MuJoCo within 20 s",
    )


def improvement(fixed: Metrics, adaptive: Metrics) -> float | None:
    """Return by how much adaptive gains lower the objective [%]; None if a run did not complete."""
    one, other = fixed["objective"], adaptive["objective"]
    return None if one is None or other is None else 100.0 * (1.0 - other / one)


def _improvement(id: str, case: str, runs: Runs, tried: Readings) -> Claim:
    """C3 to C6: the improvement of one case of Table 3."""
    published = PUBLISHED_IMPROVEMENT[case]
    here = improvement(runs[case, FIXED], runs[case, ADAPTIVE])
    under_d3 = here is not None and abs(here - published) <= NEAR
    fitted, share = tried.fitted[case], tried.near[case] / tried.drawn
    fits = [abs(found - published) <= NEAR for found in fitted.values()]
    closest = min(fitted, key=lambda name: abs(fitted[name] - published))
    said = "one of the two runs did not complete" if here is None else f"it is {here:.1f} %"
    return Claim(
        id=id,
        claim=f"adaptive gains lower the objective of {case} by {published} %",
        figure="improvement of the objective (O1) [%]",
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
    names = [f"{kind}_{x}" for kind in ("overshoot", "settling_2pc") for x in STATES]
    cut = [
        _less(runs[case, ADAPTIVE][name], runs[case, FIXED][name])
        for case in PUBLISHED_IMPROVEMENT
        for name in names
    ]
    return Claim(
        id="C7",
        claim="adaptive gains cut overshoot and settling time of every state in every case",
        figure="metrics that decrease, of 4 cases x 4 states x 2",
        paper=float(len(cut)),
        here=float(sum(cut)),
        verdict=verdict(sum(cut) / len(cut), least=0.5),
        why=f"{sum(cut)} of {len(cut)} fall; overshoot is the excursion beyond zero, settling is "
        "into 2 % of the peak",
    )


def _less(one: float | None, other: float | None) -> bool:
    """Return whether a value is smaller; one that is missing counts as infinite."""
    return one is not None and (other is None or one < other)


def _impulse(runs: Runs) -> Claim:
    """C8: the impulse at 10 s is rejected."""
    disturbed = [name for name in SCENARIOS if name.endswith("-impulse")]
    calm = [_settled(runs[s, c]) for s in disturbed for c in (FIXED, ADAPTIVE)]
    reached = [time - IMPULSE_TIME for time in calm if time is not None]
    return Claim(
        id="C8",
        claim="the impulse at 10 s is rejected",
        figure="latest return of any state into 2 % of its peak after the impulse [s]",
        paper=None,
        here=max(reached) if len(reached) == len(calm) else None,
        verdict=verdict(len(reached) / len(calm)),
        why=f"{len(reached)} of {len(calm)} disturbed runs settle again before 20 s",
    )
