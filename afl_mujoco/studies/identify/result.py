"""What an identification found, and one log beside the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.identification.identify import Identified
from afl_mujoco.identification.log import Log
from afl_mujoco.identification.prediction import predicted_by_rig, starts_of
from afl_mujoco.studies.arrays import Array

SHOWN = 0.5
"""How long each simulation that is shown runs from its fitted state [s]."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shown:
    """A log, and the model started from its readings every `SHOWN`.

    Attributes
    ----------
    name
        Name of the log.
    time, z, phi, command
        Its readings [s, m, rad], and its command, shape (N,); an angle in the dead zone is NaN.
    simulated_time, simulated_z, simulated_phi
        Simulated readings [s, m, rad], a row for each start, shape (S, n).
    """

    name: str
    time: Array
    z: Array
    phi: Array
    command: Array
    simulated_time: Array
    simulated_z: Array
    simulated_phi: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Result:
    """A cart-pole identified.

    Attributes
    ----------
    identified
        The estimates.
    shown
        One log beside the model; None if no drive was identified, or no log is long enough.
    """

    identified: Identified
    shown: Shown | None

    def __repr__(self) -> str:
        """Summarise what was identified in one line."""
        one = self.identified
        return f"<{one.description.name} identified from {len(one.logs)} logs>"


def result_of(identified: Identified, logs: Sequence[Log]) -> Result:
    """Return the result, which shows the longest log."""
    log = max(logs, key=lambda one: one.duration)
    return Result(identified=identified, shown=shown_of(identified, log))


def shown_of(identified: Identified, log: Log) -> Shown | None:
    """Return a log beside the model."""
    if identified.drive is None:
        return None
    values, d = identified.values, identified.description
    try:
        starts = starts_of([log], SHOWN, SHOWN, SHOWN)
    except InvalidValueError:  # too short a log is no reason to lose what was identified
        return None
    w, drive = starts.windows, identified.drive
    scatter = (drive.scatter_z or 1e-3, drive.scatter_phi)
    read, _ = predicted_by_rig(starts, values, d, scatter)
    part = slice(starts.past - 1, None)
    scale, offset = values.get("angle_scale", 1.0), values["angle_offset"]
    turn = 2.0 * np.pi
    angle = scale * log.phi + offset + turn * log.turns
    return Shown(
        name=log.name,
        time=log.time,
        z=log.z,
        phi=np.where(log.valid, angle, np.nan),
        command=log.command,
        simulated_time=w.time[:, part],
        simulated_z=read[:, 0, part],
        simulated_phi=(scale * read[:, 1] + offset + turn * w.turns)[:, part],
    )
