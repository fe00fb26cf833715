"""The recordings of a real cart-pole that come with the package, and what was identified of it."""

from __future__ import annotations

from pathlib import Path

from afl_mujoco.files import read_json
from afl_mujoco.identification.identify import Identified

FOLDER = Path(__file__).parent / "data" / "cartpole"
"""Recordings, their origin and licence, their description, and the estimates."""

FIT, CHOOSE = FOLDER / "fit", FOLDER / "validate"
"""The recordings that are identified on, and those that the model is judged on by default."""

DESCRIPTION, ESTIMATES = FOLDER / "description.toml", FOLDER / "estimates.json"


def load_estimates(path: Path = ESTIMATES) -> Identified:
    """Return estimates that `afl-mujoco identify` wrote."""
    again = "run afl-mujoco identify"
    return read_json(path, Identified, "are no estimates of afl-mujoco identify", again)
