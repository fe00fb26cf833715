"""What holds and what does not, in five sentences made from the numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from afl_mujoco.document.numbers import fixed, interval, limit, percent, scientific, short
from afl_mujoco.reporting.page.checks import rank
from afl_mujoco.reporting.page.inputs.report_data import Row
from afl_mujoco.studies.verification.claims.claim import (
    IN_PART,
    NOT_REPRODUCED,
    REPRODUCED,
    UNDETERMINED,
)

SOURCES = {
    "control_hold": "force held",
    "schedule_sampling": "M, l frozen over a step",
    "disturbance_timing": "disturbance moved to the steps",
    "integrator": "MuJoCo's integrator",
    "model_form": "model form",
}
"""Sources of the error budget in words."""

DEEDS = {
    "control_hold": "holding the force",
    "schedule_sampling": "freezing M and l over a step",
    "disturbance_timing": "moving the disturbance to the steps",
    "integrator": "MuJoCo's integrator",
    "model_form": "the form of MuJoCo's model",
}
"""The same as they stand in a sentence."""

STATES = {"z": ("z", "m"), "phi": ("φ", "rad"), "z_dot": ("z′", "m/s"), "phi_dot": ("φ′", "rad/s")}
"""Symbol and unit of each state."""

TABLE_3 = ("C3", "C4", "C5", "C6")
"""Claims on the improvements of the paper's Table 3."""


@dataclass(frozen=True, slots=True)
class Sentence:
    """One of the five.

    Attributes
    ----------
    lead
        What it is about, in a word or two.
    text
        The sentence.
    anchor
        Section of the page that bears it out.
    """

    lead: str
    text: str
    anchor: str


def five_sentences(report: Row) -> tuple[Sentence, ...]:
    """Return the summary of a report."""
    return (
        Sentence("Agreement", _agreement(report["checks"]), "checks"),
        Sentence("As deployed", _deployed(report["error_budgets"], report["settings"]), "budget"),
        Sentence("The paper's claims", _claims(report["claims"]), "claims"),
        Sentence("Other schedules", _schedules(report["random_schedules"]), "random"),
        Sentence("Not proved", _not_proved(report["omissions"]), "studies"),
    )


def _agreement(checks: Sequence[Row]) -> str:
    """Say whether the two sides are one model."""
    exact = [check for check in checks if check["id"] == "B1"]
    failed = list(dict.fromkeys(check["id"] for check in checks if not check["passed"]))
    more = f"; yet {_and(failed)} fail{'s' * (len(failed) == 1)}" if failed else ""
    if not exact:
        return f"No run here compares MuJoCo with the equations under one integrator{more}."
    worst = max(exact, key=rank)
    most = limit(worst["limit"])
    where = f"{worst['scenario']} with {worst['controller']} gains"
    if worst["value"] is None:
        return f"In {where} MuJoCo and the paper's equations do not end the same way{more}."
    found = scientific(worst["value"])
    if not worst["passed"]:
        return (
            f"Under one integrator MuJoCo and the paper's equations differ by {found} in {where}, "
            f"beyond the limit of {most}: they are not the same model{more}."
        )
    return (
        f"Under one integrator MuJoCo and the paper's equations differ by at most {found} in any "
        f"state at any instant of {_count(len(exact), 'run')} (limit {most}): one model, up to "
        f"round-off{more}."
    )


def _deployed(budgets: Sequence[Row], settings: Row) -> str:
    """Say by how much the deployed run differs from the ideal one, and what makes that up."""
    if not budgets:
        return "No run was completed as deployed, so there is no difference to explain."
    row = max(budgets, key=lambda budget: budget["total"])
    worst = row["at_worst"]
    symbol, unit = STATES.get(worst["state"], (worst["state"], "SI"))
    largest = max(DEEDS, key=lambda name: abs(worst[name]))
    share = worst[largest] / worst["total"] if worst["total"] else 0.0
    own = scientific(abs(worst["integrator"] + worst["model_form"]))
    left = percent(max(budget["residual_share"] for budget in budgets))
    period = short(1e3 * settings["control_period"])
    return (
        f"A run as deployed, its force held for {period} ms, strays from the ideal one by at most "
        f"{short(row['total'], 2)} ({symbol} in {unit}, {row['scenario']} with {row['controller']} "
        f"gains, at t = {short(worst['time'])} s): there {DEEDS[largest]} makes "
        f"{percent(share, 4)} of it, MuJoCo itself (integrator and model) {own}, and in no run is "
        f"more than {left} left unexplained."
    )


def _claims(claims: Sequence[Row]) -> str:
    """Say how many of the paper's claims hold."""
    if not claims:
        return (
            "They are not judged here: that takes all nine scenarios, with fixed and with "
            "adaptive gains."
        )
    kinds = (
        (REPRODUCED, "hold here"),
        (IN_PART, "hold in part"),
        (NOT_REPRODUCED, "do not hold"),
        (UNDETERMINED, "cannot be determined"),
    )
    told = []
    for verdict, words in kinds:
        ids = [claim["id"] for claim in claims if claim["verdict"] == verdict]
        if ids:
            told.append(f"{len(ids)} {words} ({', '.join(ids)})")
    improvements = [c for c in claims if c["id"] in TABLE_3 and None not in (c["paper"], c["here"])]
    more = ""
    if improvements:
        paper, here = (sorted(c[key] for c in improvements) for key in ("paper", "here"))
        more = (
            f"; the improvement by adaptive gains, {_range(paper)} in the paper's Table 3, is "
            f"{_range(here)} on the schedules assumed here (D3)"
        )
    return f"Of {len(claims)} claims {_and(told)}{more}."


def _schedules(comparisons: Row) -> str:
    """Say how adaptive gains do on random schedules."""
    if "published" not in comparisons:
        return "No random schedules were drawn in this run."
    paper = comparisons["published"]
    low, high = paper["interval"]
    if low > 0.5:
        meaning = "more often than not"
    elif high < 0.5:
        meaning = "they lose more often than they win"
    else:
        meaning = "no better than a coin toss"
    text = (
        f"On {short(paper['schedules'])} random schedules the published adaptive gains beat the "
        f"fixed ones on {percent(paper['share'], 3)} "
        f"(95 % interval {interval(paper['interval'])} %): {meaning}"
    )
    if "retuned" in comparisons:
        ours = comparisons["retuned"]
        median = ours["quantiles"].get("median")
        by = "" if median is None else f", by {fixed(median, 1)} % in the median"
        won = f"{percent(ours['share'], 3)} ({interval(ours['interval'])} %)"
        text += f"; gains tuned anew win on {won}{by}"
    return f"{text}."


def _not_proved(omissions: Sequence[Row]) -> str:
    """Say what the report does not show."""
    text = (
        "This is verification by an independent code, not validation against hardware: friction, "
        "delay, noise and force limits are on neither side"
    )
    if not omissions:
        return f"{text}, and what the paper's frozen M and l leave out (D9) is for make proof."
    most = max(max(row["stretching_rod"], row["momenta_kept"]) for row in omissions)
    return (
        f"{text}, and what the paper's frozen M and l leave out (D9) would change a state by up "
        f"to {short(most, 2)} (m, rad, m/s or rad/s)."
    )


def _range(percents: Sequence[float]) -> str:
    """Return between what sorted percentages lie."""
    low, high = (fixed(percents[end], 0) for end in (0, -1))
    return f"{low} %" if low == high else f"{low} to {high} %"


def _count(number: int, thing: str) -> str:
    """Return how many there are of a thing."""
    return f"{number} {thing}{'s' * (number != 1)}"


def _and(parts: Sequence[str]) -> str:
    """Join parts as a sentence does."""
    return " and ".join(filter(None, (", ".join(parts[:-1]), *parts[-1:])))
