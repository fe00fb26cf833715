"""The recordings of a real cart-pole that come with the package, and the estimates from them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from afl_mujoco.errors import FileError
from afl_mujoco.files import read_json

if TYPE_CHECKING:
    from afl_mujoco.identification.identify import Identified

FOLDER = Path(__file__).parent / "data" / "cartpole"
"""Recordings, their origin and licence, their description, and the estimates."""

FIT, CHOOSE = FOLDER / "fit", FOLDER / "validate"
"""The recordings used for identification, and those used by default to judge the model."""

DESCRIPTION, ESTIMATES = FOLDER / "description.toml", FOLDER / "estimates.json"


def load_estimates(path: Path = ESTIMATES) -> Identified:
    """Return the estimates in a file that `afl-mujoco identify` wrote."""
    from afl_mujoco.identification import pole, rig
    from afl_mujoco.identification.identify import Identified

    wrong, again = "has no estimates of afl-mujoco identify", "run afl-mujoco identify"
    found = read_json(path, Identified, wrong, again)
    known = pole.parameters_of(found.description)
    if found.drive is not None:
        known += rig.parameters_of(found.description)
    expected = [one.name for one in known]
    for step in (found.pole, found.drive):
        if step is not None and not step.is_sound:
            rule = f"must be as that command writes them: {again}"
            raise FileError(f"{path} {wrong}: correlations and scatter", rule)
    for one in known:
        value = found.values.get(one.name, one.low)
        if not one.low <= value <= one.high:
            bounds = f"must lie in {one.low:g} to {one.high:g}"
            raise FileError(f"{path} {wrong}: {one.name}", bounds, value)
    if list(found.values) != expected:
        named = ", ".join({*expected} ^ {*found.values}) or "their order"
        raise FileError(f"{path} {wrong}: {named}", f"must be as that command writes them: {again}")
    return found
