"""What rests on which decision: the claims and sections of the page, and the way back."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from afl_mujoco.document.numbers import short
from afl_mujoco.reporting.page.inputs.report_data import Row
from afl_mujoco.studies.verification.claims.claim import (
    IN_PART,
    NOT_REPRODUCED,
    REPRODUCED,
    UNDETERMINED,
)

_PLANT = ("D1", "D3", "D7", "D9")
_OBJECTIVE = ("D4", "D5")

SECTIONS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "checks": ("D1", "D9"),
        "scenarios": ("D1", "D2", "D3", *_OBJECTIVE, "D6", "D7", "D9"),
        "budget": ("D2", "D3", "D6", "D7", "D9"),
        "studies": ("D3", "D9"),
    }
)
"""Decisions that the numbers of a section rest on, by its anchor."""

CLAIMS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "C1": ("D1",),
        "C2": ("D2", *_PLANT),
        **dict.fromkeys(("C3", "C4", "C5", "C6"), ("D2", *_PLANT, *_OBJECTIVE)),
        "C7": ("D2", *_PLANT),
        "C8": ("D2", "D6", *_PLANT),
        "C9": ("D1", "D2", "D7", "D9", *_OBJECTIVE),
        "C10": ("D1", "D2", "D8", *_OBJECTIVE),
        "C11": ("D2", "D8", *_OBJECTIVE),
        "C12": ("D1", "D8", *_OBJECTIVE),
    }
)
"""Decisions that the judgement of a claim rests on, by its id."""

TITLES = {
    "checks": "Checks",
    "scenarios": "Scenarios",
    "budget": "Error budget",
    "studies": "Orders, energy and omissions",
}
"""Titles of the sections that rest on decisions, by anchor."""

KINDS = {REPRODUCED: "good", IN_PART: "part", NOT_REPRODUCED: "bad", UNDETERMINED: "open"}
"""How a verdict on a claim is marked."""


_TALLY = (("good", "reproduced"), ("part", "in part"), ("bad", "not"), ("open", "undetermined"))


@dataclass(frozen=True, slots=True, kw_only=True)
class ClaimRow:
    """A claim as the page shows it.

    Attributes
    ----------
    id, claim, figure, verdict, why
        As in the report.
    paper, here
        The two numbers as text.
    kind
        How the verdict is marked: one of `KINDS`.
    decisions
        What the judgement rests on.
    """

    id: str
    claim: str
    figure: str
    verdict: str
    why: str
    paper: str
    here: str
    kind: str
    decisions: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Decision:
    """A decision with what rests on it.

    Attributes
    ----------
    id, text
        As in the report.
    dependents
        Anchor and name of each claim and section.
    """

    id: str
    text: str
    dependents: tuple[tuple[str, str], ...]


def claim_rows(claims: Iterable[Row], known: Iterable[str]) -> tuple[ClaimRow, ...]:
    """Return the claims as the page shows them."""
    known = list(known)
    return tuple(
        ClaimRow(
            id=claim["id"],
            claim=claim["claim"],
            figure=claim["figure"],
            verdict=claim["verdict"],
            why=claim["why"],
            paper=short(claim["paper"]),
            here=short(claim["here"], 3),
            kind=KINDS.get(claim["verdict"], "open"),
            decisions=_rests_on(claim, known),
        )
        for claim in claims
    )


def _rests_on(claim: Row, known: Sequence[str]) -> tuple[str, ...]:
    """Return the decisions of a claim: those listed here and those that its own text names."""
    named = {*CLAIMS.get(claim["id"], ()), *re.findall(r"\bD\d+\b", claim["why"])}
    return tuple(id for id in known if id in named)


def decision_list(decisions: Mapping[str, str], claims: Sequence[ClaimRow]) -> tuple[Decision, ...]:
    """Return the decisions, each with what rests on it."""
    return tuple(
        Decision(
            id=id,
            text=text,
            dependents=(
                *((name, TITLES[name]) for name, rests in SECTIONS.items() if id in rests),
                *((claim.id, claim.id) for claim in claims if id in claim.decisions),
            ),
        )
        for id, text in decisions.items()
    )


def section_decisions(known: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """Return the decisions that each section rests on, by its anchor."""
    there = set(known)
    return {name: tuple(id for id in ids if id in there) for name, ids in SECTIONS.items()}


def tally(claims: Sequence[ClaimRow]) -> list[tuple[str, str, int]]:
    """Return how many claims there are of each verdict: its mark, its word, the number."""
    counts = {kind: sum(claim.kind == kind for claim in claims) for kind, _ in _TALLY}
    return [(kind, word, counts[kind]) for kind, word in _TALLY if counts[kind]]
