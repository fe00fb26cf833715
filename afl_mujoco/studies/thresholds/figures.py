"""Thresholds at a glance, and each controller as the imperfections are combined."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from afl_mujoco.document.numbers import MISSING
from afl_mujoco.document.style import BLACK, BLUE, ORANGE, VERMILION, new_figure
from afl_mujoco.studies.thresholds.classes import (
    CLASSES,
    FAILS,
    MUCH,
    class_of,
    level_text,
    threshold_text,
    unit_text,
    unsettled,
)
from afl_mujoco.studies.thresholds.imperfections import BY_NAME
from afl_mujoco.studies.thresholds.result import Result, Verdict

COLOURS = (VERMILION, "#F3C65F", "#BFE0F5", BLUE, "#E4E4E4")
"""Colours of the classes of a threshold, the worst first; light ones carry black text."""

ENDINGS = {"settled": BLUE, "upright, not settled": ORANGE, "failed": VERMILION}
"""How a run ends, and its colour."""

MET = "requirements met"
"""The first of them where a scenario has requirements."""

WHITE = "#FFFFFF"


def draw_thresholds(result: Result) -> Figure:
    """Draw the thresholds: a row for each imperfection, a column for each controller."""
    controllers = result.controllers
    rows = len(result.imperfections)
    figure = new_figure(max(2.9 + 1.05 * len(controllers), 6.0), 1.3 + 0.3 * rows)
    axes = figure.subplots()
    sweeps = [[result.sweep(one.name, c) for c in controllers] for one in result.imperfections]
    kinds = np.array(
        [
            [class_of(one, sweep) for sweep in row]
            for one, row in zip(result.imperfections, sweeps, strict=True)
        ]
    )
    axes.imshow(np.array([to_rgba(c) for c in COLOURS])[kinds], aspect="auto")
    for i, (one, row) in enumerate(zip(result.imperfections, sweeps, strict=True)):
        for j, sweep in enumerate(row):
            text = threshold_text(one, sweep.survives) + (" ~" if unsettled(sweep) else "")
            text = text if sweep.applies else MISSING
            colour = WHITE if kinds[i, j] in (FAILS, MUCH) else BLACK
            axes.text(j, i, text, ha="center", va="center", fontsize=8.5, color=colour)
    labels = [
        f"{one.title}  (reference: {level_text(one, one.reference)} {unit_text(result, one)})"
        for one in result.imperfections
    ]
    axes.set_yticks(range(rows), labels)
    _name_controllers(axes, controllers)
    _draw_grid(axes, rows, len(controllers))
    handles = [
        Patch(facecolor=colour, label=text)
        for kind, (colour, text) in enumerate(zip(COLOURS, CLASSES, strict=True))
        if kind in kinds
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=2)
    return figure


def draw_combined(result: Result) -> Figure:
    """Draw how each controller ends as the reference imperfections are added in turn."""
    controllers, names = result.controllers, result.added
    figure = new_figure(max(2.2 + 0.42 * len(names), 6.0), 2.6 + 0.3 * len(controllers))
    axes = figure.subplots()
    kinds = np.array([[_ending(verdict) for verdict in result.combined[c]] for c in controllers])
    axes.imshow(np.array([to_rgba(c) for c in ENDINGS.values()])[kinds], aspect="auto")
    labels = [("+ " if i else "") + title for i, title in enumerate(added_titles(result))]
    axes.set_xticks(range(len(names)), labels, rotation=55.0, ha="right", rotation_mode="anchor")
    axes.set_yticks(range(len(controllers)), controllers)
    _draw_grid(axes, len(controllers), len(names))
    best, *others = ENDINGS
    words = (best if result.settling else MET, *others)
    handles = [
        Patch(facecolor=colour, label=text)
        for kind, (colour, text) in enumerate(zip(ENDINGS.values(), words, strict=True))
        if kind in kinds
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=3)
    return figure


def added_titles(result: Result) -> list[str]:
    """Return the titles of the imperfections that are added one after another."""
    return [BY_NAME[name].title if name in BY_NAME else name for name in result.added]


def _ending(verdict: Verdict) -> int:
    """Return how a run ends, as an index into `ENDINGS`."""
    return 0 if verdict.settles else 1 if verdict.survives else 2


def _name_controllers(axes: Axes, controllers: tuple[str, ...]) -> None:
    """Write the names of the controllers over the columns."""
    axes.xaxis.tick_top()
    wrapped = [name.replace("-", "-\n", 1) for name in controllers]
    axes.set_xticks(range(len(controllers)), wrapped)


def _draw_grid(axes: Axes, rows: int, columns: int) -> None:
    """Draw white lines between the cells instead of a frame."""
    axes.grid(False)
    axes.tick_params(length=0.0)
    axes.spines[:].set_visible(False)
    for i in range(1, rows):
        axes.axhline(i - 0.5, color=WHITE, linewidth=1.5)
    for j in range(1, columns):
        axes.axvline(j - 0.5, color=WHITE, linewidth=1.5)
