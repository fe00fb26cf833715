"""What it finds."""

from __future__ import annotations

from dataclasses import dataclass

from afl_mujoco.studies.arrays import Array


@dataclass(frozen=True, kw_only=True)
class Throw:
    """One throw."""

    number: int
    eyes: int


@dataclass(frozen=True, kw_only=True, eq=False)
class Result:
    """All throws, one by one and as an array."""

    scenarios: tuple[str, ...]
    throws: tuple[Throw, ...]
    all_eyes: Array
