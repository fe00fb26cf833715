"""The ledger of energy: the energy gained in MuJoCo, and what was booked for it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator

from afl_mujoco.report import old as blocks
from afl_mujoco.report.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    TIME,
    VERMILION,
    colours,
    decade_above,
    draw_limit,
    in_words,
    new_figure,
)
from afl_mujoco.studies.verification.criteria import CRITERIA
from afl_mujoco.studies.verification.curves import Curves

FLOOR = 1e-17
"""Smaller residuals are drawn here: a logarithmic axis has no zero."""

_BOOKED: Mapping[str, tuple[str, str, Any]] = {
    "work": ("work of all forces", BLUE, (0, ())),
    "ramps": ("ramps of M and l", VERMILION, (0, (5, 1.5, 1, 1.5))),
    "jumps": ("steps of M and l", GREEN, (0, (1, 1))),
}

_GAINED: Any = {"color": GREY, "marker": "o", "markersize": 3.5, "linestyle": "none", "alpha": 0.7}


def energy_figure(cases: Sequence[Sequence[Curves]]) -> blocks.Figure:
    """Return each scenario's ledger: above, the last controller's; below, the residuals of all."""
    return blocks.Figure(
        name="report-energy",
        title="Where the energy comes from",
        caption="Above: the energy gained in MuJoCo (dots), the contributions booked by the "
        "analytic equations (colours), and their sum (black line). Below: what is not booked, "
        f"drawn at {in_words(FLOOR)} J if it is less, with the limit of A6e. The ledger is closed "
        "every 0.1 s, until half a second after the last change.",
        alt=f"{2 * len(cases)} panels. In the upper ones the sum runs through the dots. "
        + " ".join(_in_words(curves[-1]) for curves in cases)
        + f" What is not booked is at most {in_words(_left(cases))} J.",
        draw=partial(_draw, cases),
    )


def _left(cases: Sequence[Sequence[Curves]]) -> float:
    """Return the largest energy that is not booked [J]."""
    return max(float(np.abs(one.energy["residual"]).max()) for curves in cases for one in curves)


def _draw(cases: Sequence[Sequence[Curves]]) -> Figure:
    """Draw the columns."""
    figure = new_figure(2.75 * len(cases) + 0.6, 5.8)
    axes = figure.subplots(2, len(cases), sharex="col", sharey="row", squeeze=False)
    shades = colours(one.controller for curves in cases for one in curves)
    for (above, below), curves in zip(axes.T, cases, strict=True):
        _draw_ledger(above, curves[-1])
        above.set_title(f"{curves[-1].scenario}\n{curves[-1].controller}")
        for one in curves:
            below.semilogy(
                one.energy["time"], np.maximum(np.abs(one.energy["residual"]), FLOOR),
                color=shades[one.controller], linewidth=1.2,
            )  # fmt: skip
        draw_limit(below, CRITERIA["A6e"].limit, "A6e", GREY)
        below.yaxis.set_major_locator(LogLocator(numticks=6))
        below.minorticks_off()
        below.set(xlabel=TIME, xlim=(0.0, float(one.energy["time"][-1])))
    axes[1, 0].set_ylim(FLOOR, decade_above(10.0 * max(_left(cases), CRITERIA["A6e"].limit)))
    axes[0, 0].set_ylabel("energy since t = 0 [J]")
    axes[1, 0].set_ylabel("|not booked| [J]")
    _draw_legend(figure, shades)
    return figure


def _draw_ledger(axis: Axes, one: Curves) -> None:
    """Draw what was gained, what was booked for it, and the sum of that."""
    time = one.energy["time"]
    axis.plot(time, one.energy["gained"], **_GAINED)
    for key, (_, colour, style) in _BOOKED.items():
        stepped = "steps-post" if key == "jumps" else "default"
        axis.plot(
            time, one.energy[key], color=colour, linestyle=style, linewidth=1.3, drawstyle=stepped
        )
    booked = sum(one.energy[key] for key in _BOOKED)
    axis.plot(time, booked, color=BLACK, linewidth=0.9)


def _draw_legend(figure: Figure, shades: Mapping[str, str]) -> None:
    """Draw the legend below the figure."""
    handles = {"gained in MuJoCo": Line2D([], [], **_GAINED)}
    for words, colour, style in _BOOKED.values():
        handles[words] = Line2D([], [], color=colour, linestyle=style, linewidth=1.2)
    handles["sum of what is booked"] = Line2D([], [], color=BLACK, linewidth=0.9)
    for name, colour in shades.items():
        handles[f"not booked, {name}"] = Line2D([], [], color=colour, linewidth=1.2)
    figure.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=4)


def _in_words(one: Curves) -> str:
    """Say how much energy a run gained, and from what."""
    gained, work, ramps, jumps = (
        f"{0.0 + one.energy[key][-1].round(3):g} J" for key in ("gained", *_BOOKED)
    )
    return (
        f"{one.scenario}, {one.controller}: the energy gains {gained} by the end, work {work}, "
        f"ramps {ramps}, steps {jumps}."
    )
