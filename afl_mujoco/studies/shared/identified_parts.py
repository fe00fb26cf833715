"""A log of a measured cart-pole beside the model, for the studies that show one."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.identification.log import Log, Windows
from afl_mujoco.studies.shared.arrays import Array

Values = NDArray[np.float64]

AHEAD = 0.5  # how long each simulation that is shown runs from its fitted state [s]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shown:
    """A log, and the model started from a state that was fitted to readings, if at all."""

    name: str
    time: Array  # [s], shape (N,), as are the three below
    z: Array  # [m]
    phi: Array  # [rad], NaN in the dead zone
    command: Array
    # [s], a row for each start, shape (S, n), as are the two below
    simulated_time: Array = field(default_factory=partial(np.empty, (0, 0)))
    simulated_z: Array = field(default_factory=partial(np.empty, (0, 0)))  # [m]
    simulated_phi: Array = field(default_factory=partial(np.empty, (0, 0)))  # [rad]


def shown_of(
    log: Log, w: Windows, read: Values, values: dict[str, float], number: int = 0
) -> Shown:
    """Return a log, by its number among the logs, beside its predictions, one after the other."""
    first, turn = w.past - 1, 2.0 * np.pi
    scale, offset = values.get("angle_scale", 1.0), values["angle_offset"]
    chosen, free_from = [], -np.inf
    for b in np.flatnonzero(w.log == number).tolist():
        if w.time[b, first] >= free_from - 1e-9:
            chosen.append(b)
            free_from = w.time[b, first] + AHEAD
    part = np.array(chosen, dtype=np.int64)
    rows = slice(first, first + round(AHEAD / w.spacing) + 1)
    return Shown(
        name=log.name,
        time=log.time,
        z=log.z,
        phi=np.where(log.valid, scale * log.phi + offset + turn * log.turns, np.nan),
        command=log.command,
        simulated_time=w.time[part, rows],
        simulated_z=read[part, 0, rows],
        simulated_phi=scale * read[part, 1, rows] + offset + turn * w.turns[part, rows],
    )


def draw_log(shown: Shown, bands: Values | None = None) -> Any:
    """Draw a log beside the model; bands are times [s] and half-widths about both, shape (3, H)."""
    from afl_mujoco.report.figures import BLACK, BLUE, GREY, TIME, VERMILION, new_figure

    s, figure = shown, new_figure(9.0, 7.0)
    axes = figure.subplots(3, 1, sharex=True, height_ratios=(3, 3, 1.4))
    labels = ("cart position z [m]", "pole angle φ [rad]")
    for axis, values, label in zip(axes, (s.z, s.phi), labels, strict=False):
        axis.plot(s.time, values, ".", color=BLACK, markersize=3.0, label="measured")
        axis.set_ylabel(label)
    simulated = zip(s.simulated_time, s.simulated_z, s.simulated_phi, strict=True)
    for i, (when, *predicted) in enumerate(simulated):
        name = "simulated from a fitted state, colours in turn" if i == 0 else None
        for k, (axis, values) in enumerate(zip(axes, predicted, strict=False)):
            colour = (VERMILION, BLUE)[i % 2]
            axis.plot(when, values, color=colour, linewidth=1.2, label=name)
            if bands is not None:
                width = np.interp(when - when[0], bands[0], bands[1 + k])
                low, high = values - width, values + width
                axis.fill_between(when, low, high, color=colour, alpha=0.2, linewidth=0.0)
    axes[2].step(s.time, s.command, where="post", color=GREY, linewidth=1.0)
    axes[2].set_ylabel("command")
    axes[2].set_xlabel(TIME)
    axes[2].set_xlim(float(s.time[0]), float(s.time[-1]))
    axes[0].legend(ncols=2, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    return figure
