"""The decisions taken where the paper is silent, and what rests on each."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from types import MappingProxyType

from afl_mujoco.control.names import AFL
from afl_mujoco.report.old import Fact, Facts, Section, Text
from afl_mujoco.scenario.catalogue import is_published
from afl_mujoco.studies.verification.claims.claim import Claim
from afl_mujoco.studies.verification.result import Result

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


def decisions_section(result: Result) -> Section:
    """Return the decisions, each with what rests on it."""
    text = Text(
        "The paper is silent or contradicts itself on these points. Each decision is a default "
        "that can be changed; what rests on it follows."
    )
    facts = [
        Fact(id, f"{words} {_dependents(result, id)}", anchor=id)
        for id, words in result.decisions.items()
    ]
    return Section("Decisions", "decisions", (text, Facts(facts)), folded=True)


def rests_on(result: Result, anchor: str) -> Text:
    """Say which decisions a section rests on."""
    return Text(links(section_decisions(result, anchor)), note=True)


def section_decisions(result: Result, anchor: str) -> list[str]:
    """Return the decisions that a section rests on, of those that concern what was run."""
    published = [s for s in result.scenarios if is_published(s)]
    concerned = {
        "D2": any(run.controller in AFL for run in result.runs),
        "D3": bool(published),
        "D6": any(scenario.disturbances for scenario in published),
    }
    return [id for id in SECTIONS[anchor] if id in result.decisions and concerned.get(id, True)]


def claim_decisions(result: Result, claim: Claim) -> list[str]:
    """Return the decisions of a claim: those listed here, and those that its own text names."""
    named = {*CLAIMS.get(claim.id, ()), *re.findall(r"\bD\d+\b", claim.why)}
    return [id for id in result.decisions if id in named]


def links(ids: Iterable[str]) -> str:
    """Say that something rests on decisions."""
    return f"Rests on {', '.join(f'[{id}](#{id})' for id in ids)}."


def _dependents(result: Result, id: str) -> str:
    """Say what rests on a decision."""
    found = [
        f"[{title}](#{name})"
        for name, title in TITLES.items()
        if id in section_decisions(result, name)
    ]
    found += [
        f"[{claim.id}](#{claim.id})"
        for claim in result.claims
        if id in claim_decisions(result, claim)
    ]
    return (
        f"Results that rest on it: {', '.join(found)}."
        if found
        else "Nothing in this run rests on it."
    )
