"""How far each mode of MuJoCo is from the ODE over time."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator
from numpy.typing import NDArray

from afl_mujoco.report import old as blocks
from afl_mujoco.report.style import (
    BLUE,
    GREEN,
    MODES,
    TIME,
    decade_above,
    draw_limit,
    in_words,
    new_figure,
)
from afl_mujoco.studies.verification.criteria import CRITERIA
from afl_mujoco.studies.verification.curves import REFERENCE, Curves

COLUMNS = 4
"""Largest number of panels side by side."""

BINS = 140
"""Points of a drawn curve, each the largest value of its share of the run."""

FLOOR = 1e-17
"""Smaller differences are drawn here: a logarithmic axis has no zero."""

_WIDTHS = {"mujoco sampled": 1.6, "mujoco continuous": 1.3, "mujoco exact": 1.0}


def errors_figure(curves: Sequence[Curves]) -> blocks.Figure:
    """Return the largest difference of any state over time, a panel for each case."""
    said = ", ".join(f"{mode.split()[1]} {_span(curves, mode)}" for mode in MODES)
    return blocks.Figure(
        name="report-errors",
        title="How far MuJoCo is from the ODE",
        caption="The largest difference of any state [m, rad, m/s, rad/s] between MuJoCo and the "
        f"ideal ODE, in each mode of MuJoCo. Each point is the largest in its 1/{BINS} of the "
        f"run, drawn at {in_words(FLOOR)} if it is less. Dashed: the limits of B1 (exact) and, "
        "where it applies, B2 (continuous).",
        alt=f"{len(curves)} panels on a logarithmic axis, three curves in each. Their largest "
        f"values, from the least to the most over the panels: {said}.",
        draw=partial(_draw, curves),
    )


def _draw(curves: Sequence[Curves]) -> Figure:
    """Draw the panels."""
    controllers = len({one.controller for one in curves})
    width = min(len(curves), max(1, COLUMNS // controllers) * controllers)
    height = -(-len(curves) // width)
    most = max(float(np.nanmax(difference(one, mode)[1])) for one in curves for mode in MODES)
    figure = new_figure(2.25 * width + 0.7, 1.9 * height + 0.7)
    axes = figure.subplots(height, width, sharex=False, sharey=True, squeeze=False)
    for axis, one in zip(axes.ravel(), curves, strict=False):
        _draw_panel(axis, one)
    for axis in axes.ravel()[len(curves) :]:
        axis.remove()
    axes[0, 0].set_ylim(FLOOR, max(1.0, decade_above(most or FLOOR)))
    for axis in axes[:, 0]:
        axis.set_ylabel("|MuJoCo - ODE| [SI]")
    handles = {words: Line2D([], [], color=colour) for colour, words in MODES.values()}
    figure.legend(
        list(handles.values()),
        list(handles),
        loc="outside lower center",
        ncols=3 if width == COLUMNS else 1,
    )
    return figure


def difference(one: Curves, mode: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return instants [s] and the largest difference of any state from the ODE."""
    run, ideal = one.states[mode], one.states[REFERENCE]
    both = min(len(run), len(ideal))
    return one.time[:both], np.abs(run[:both] - ideal[:both]).max(axis=1)


def envelope(
    time: NDArray[np.float64], values: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the largest value in each of `BINS` equal shares of the time, and when it occurs.

    Parameters
    ----------
    time
        Instants [s], shape (N,), increasing.
    values
        Values, shape (N,).
    """
    edges = np.linspace(time[0], time[-1], BINS + 1)
    bins = np.minimum(np.searchsorted(edges, time, side="right"), BINS)
    order = np.lexsort((-values, bins))
    first = np.concatenate([[True], np.diff(bins[order]) > 0])
    kept = np.sort(order[first])
    return time[kept], values[kept]


def _draw_panel(axis: Axes, one: Curves) -> None:
    """Draw the modes of one scenario and controller."""
    for mode, (colour, _) in MODES.items():
        time, values = envelope(*difference(one, mode))
        axis.semilogy(time, np.maximum(values, FLOOR), color=colour, linewidth=_WIDTHS[mode])
    draw_limit(axis, CRITERIA["B1"].limit, "B1", GREEN, under=True)
    draw_limit(axis, CRITERIA["B2"].limit, "B2", BLUE)
    axis.set(xlim=(0.0, float(one.time[-1])), xlabel=TIME)
    axis.yaxis.set_major_locator(LogLocator(numticks=6))
    axis.set_title(f"{one.scenario}, {one.controller}", fontsize=8.5)
    axis.minorticks_off()


def _span(curves: Sequence[Curves], mode: str) -> str:
    """Return the range of the largest differences of a mode in words."""
    largest = [float(np.nanmax(difference(one, mode)[1])) for one in curves]
    return f"{in_words(min(largest))} to {in_words(max(largest))}"
