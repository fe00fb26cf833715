"""What `make claims` found of the paper, as it comes with the package: C9 to C12, and readings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Literal

from afl_mujoco.files import read_json
from afl_mujoco.studies.verification.claims.claim import Claim, Comparison


@dataclass(frozen=True, slots=True, kw_only=True)
class Readings:
    """The improvements of Table 3's cases under readings of what the paper leaves open."""

    drawn: int
    """Number of readings drawn at random."""
    near: Mapping[str, int]
    """Under how many of those the improvement of each case is near the paper's."""
    fitted: Mapping[str, Mapping[str, float]]
    """Improvements [%] by case and by the name of the reading that was fitted to Table 3."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Shipped:
    """The content of the file that `research/claims.py` writes."""

    schema: Literal[1] = 1
    command: str
    versions: Mapping[str, str]
    readings: Readings
    claims: tuple[Claim, ...]
    """C9 to C12."""
    random_schedules: Mapping[str, Comparison]
    """Adaptive against fixed gains, published and retuned: behind C9."""


def shipped() -> Shipped:
    """Return the content of the file; anything else in its place raises a `FileError`."""
    file = resources.files("afl_mujoco.studies") / "data" / "claims.json"
    return read_json(file, Shipped, "is not what make claims writes")
