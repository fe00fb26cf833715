"""A claim of the paper with its number, ours, and the verdict."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

REPRODUCED, IN_PART = "reproduced", "reproduced in part"
NOT_REPRODUCED, UNDETERMINED = "not reproduced", "cannot be determined"
EVERY, SOME, NONE = (
    f"holds under {which}" for which in ("every reading tried", "some readings", "no reading tried")
)
"""Verdicts on what hangs on what the paper leaves open (`studies.paper_readings`)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Claim:
    """One row of the claims ledger.

    Attributes
    ----------
    id
        C1 to C12.
    claim
        What the paper says.
    figure
        What `paper` and `here` measure, with its unit.
    paper, here
        The paper's number and ours; ``None`` if there is none.
    verdict
        One of the verdicts of this module.
    why
        The reason for the verdict, one sentence.
    """

    id: str
    claim: str
    figure: str
    paper: float | None
    here: float | None
    verdict: str
    why: str


def verdict_on_readings(holds: Iterable[bool]) -> str:
    """Return the verdict on a claim from whether it holds under each reading tried."""
    found = list(holds)
    return EVERY if all(found) else SOME if any(found) else NONE


def verdict(share: float, enough: float = 1.0, least: float = 0.0) -> str:
    """Return the verdict on a share of what was claimed.

    Parameters
    ----------
    least
        Largest share that counts as not reproduced; between it and `enough`, in part.
    """
    return REPRODUCED if share >= enough else IN_PART if share > least else NOT_REPRODUCED
