"""Observed orders of accuracy: errors over steps, with the slopes they should have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from afl_mujoco.report import old as blocks
from afl_mujoco.report.style import (
    BLACK,
    GREY,
    VERMILION,
    colours,
    new_figure,
)
from afl_mujoco.studies.verification.checks.convergence import Refinement

PANELS: Mapping[str, tuple[str, str, tuple[str, ...]]] = {
    "continuous mode": ("step [ms]", "|MuJoCo - ODE| [SI]", ("continuous",)),
    "sampled mode": ("control period [ms]", "|MuJoCo - ODE| [SI]", ("sampled",)),
    "schedule held alone": ("step [ms]", "|held - followed| [SI]", ("schedule",)),
    "free swing": ("step [ms]", "|MuJoCo - ODE| [SI]", ("free swing RK4", "free swing Euler")),
}
"""Axes and studies of each panel."""

_SWINGS = {"free swing RK4": (BLACK, "D"), "free swing Euler": (VERMILION, "^")}
_MARKERS = {"fixed": "o", "adaptive": "s"}


def orders_figure(studies: Sequence[Refinement]) -> blocks.Figure:
    """Return the error of every refinement study over its steps; each must have an order."""
    panels = _panels(studies)
    said = "; ".join(f"{title}: {_orders(content)}" for title, content in panels.items())
    return blocks.Figure(
        name="report-orders",
        title="Observed orders of accuracy",
        caption="Largest error of any state over the step, both axes logarithmic; a line for each "
        "scenario and controller, many of which coincide. Dashed: the slope of the order "
        "of the method. Checks A4, A4e, B2o, B4 and B4s judge the orders.",
        alt=f"{len(panels)} panels of straight lines. Observed orders: {said}.",
        draw=partial(_draw, studies),
    )


def _panels(studies: Sequence[Refinement]) -> dict[str, list[Refinement]]:
    """Return the studies by the title of their panel."""
    found = {
        title: [study for study in studies if study.study in names]
        for title, (_, _, names) in PANELS.items()
    }
    return {title: content for title, content in found.items() if content}


def _draw(studies: Sequence[Refinement]) -> Figure:
    """Draw the panels."""
    panels = _panels(studies)
    figure = new_figure(2.9 * len(panels) + 0.4, 3.9)
    axes = figure.subplots(1, len(panels), squeeze=False)[0]
    controllers: dict[str, Any] = {}
    shades = colours(s.controller for s in studies if s.controller != "any")
    for axis, (title, content) in zip(axes, panels.items(), strict=True):
        controllers |= _draw_panel(axis, content, shades)
        axis.set(title=title, xlabel=PANELS[title][0], ylabel=PANELS[title][1])
    figure.legend(
        list(controllers.values()), list(controllers), loc="outside lower center",
        ncols=len(controllers),
    )  # fmt: skip
    return figure


def _draw_panel(
    axis: Axes, studies: Sequence[Refinement], shades: Mapping[str, str]
) -> dict[str, Any]:
    """Draw some studies and the slopes they should have; return the legend's lines."""
    drawn: dict[str, Any] = {}
    for expected in sorted({study.expected for study in studies}):
        alike = [study for study in studies if study.expected == expected]
        for study in alike:
            name = study.controller
            own = shades.get(name, BLACK), _MARKERS.get(name, "v")
            colour, mark = _SWINGS.get(study.study, own)
            label = name if name != "any" else study.study
            (drawn[label],) = axis.loglog(
                study.steps, study.errors, color=colour, marker=mark, markersize=3.5,
                linewidth=1.0, markerfacecolor="white",
            )  # fmt: skip
        _draw_slope(axis, alike, expected)
    steps = sorted({step for study in studies for step in study.steps})
    axis.set_xticks(steps, [f"{1e3 * step:g}" for step in steps])
    low, high = np.log10(axis.get_ylim())
    axis.set_ylim(10.0 ** np.floor(low), 10.0 ** np.ceil(high))
    axis.minorticks_off()
    return drawn


def _draw_slope(axis: Axes, studies: Sequence[Refinement], expected: float) -> None:
    """Draw the slope of an order below the studies that should have it."""
    steps = np.array(sorted({step for study in studies for step in study.steps}))
    ratios = [e / s**expected for t in studies for s, e in zip(t.steps, t.errors, strict=True)]
    line = 0.4 * min(ratios) * steps**expected
    axis.loglog(steps, line, color=GREY, linestyle=(0, (5, 3)), linewidth=1.0)
    axis.annotate(
        f"order {expected:g}", (steps[1], line[1]), xytext=(6.0, -9.0), fontsize=8.0, color=GREY,
        textcoords="offset points",
    )  # fmt: skip


def _orders(studies: Sequence[Refinement]) -> str:
    """Say which orders some studies show."""
    said = []
    for expected in sorted({study.expected for study in studies}):
        orders = [s.order for s in studies if s.expected == expected and s.order is not None]
        low, high = f"{min(orders):.2f}", f"{max(orders):.2f}"
        said.append(low if low == high else f"{low} to {high}")
    return " and ".join(said)
