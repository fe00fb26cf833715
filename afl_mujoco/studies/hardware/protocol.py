"""The protocol by which the model is judged: `protocol.toml` beside this file."""

from __future__ import annotations

import functools
import json
import tomllib
from dataclasses import dataclass
from pathlib import Path

from afl_mujoco.files import parse_json

FILE = Path(__file__).parent / "protocol.toml"


@dataclass(frozen=True, slots=True, kw_only=True)
class Split:
    """Which recordings are fitted, and which are judged by default."""

    fit: str
    choose: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Prediction:
    """How recordings are predicted.

    Attributes
    ----------
    horizons
        Times after a start [s].
    past
        Length of the readings before a start to which its state is fitted [s].
    every
        Time between two starts [s].
    spoilt
        How readings in the dead zone are treated.
    """

    horizons: tuple[float, ...]
    past: float
    every: float
    spoilt: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Statement:
    """A statement with the measure and the limit by which it is judged, and why that limit."""

    id: str
    statement: str
    measure: str
    limit: float
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Protocol:
    """The protocol; measures and baselines are in words."""

    split: Split
    prediction: Prediction
    measures: dict[str, str]
    baselines: dict[str, str]
    statements: tuple[Statement, ...]


@functools.cache
def load_protocol() -> Protocol:
    """Return the protocol."""
    return parse_json(json.dumps(tomllib.loads(FILE.read_text(encoding="utf-8"))), Protocol)
