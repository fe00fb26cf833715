"""The delay margin over the plants, and the delay measured in MuJoCo against it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator, ScalarFormatter
from numpy.typing import NDArray

from afl_mujoco.report.style import BLACK, GREY, LENGTH, MASS, VERMILION, colours, new_figure
from afl_mujoco.studies.margins.result import Result

COLUMNS = 4
MARKERS = "osD^vP*Xhd<>"
DECADE = 10.0
SHADES = "viridis"
TICKS = (1, 2, 5, 10, 20, 50, 100, 200, 500)
"""Ticks of a scale of delays [ms]."""


def draw_delay_margins(result: Result) -> Figure:
    """Draw the delay margin of each controller with a held force over the plants.

    A map where both M and l vary, else a line for each controller.
    """
    tables = delay_margins(result)
    if min(len(result.cart_masses), len(result.half_lengths)) == 1:
        return _draw_lines(result, tables)
    low, high = _ends(tables)
    scale = LogNorm(low, high)
    columns = min(len(tables), COLUMNS)
    rows = -(-len(tables) // COLUMNS)
    figure = new_figure(2.6 * columns + 1.2, 2.3 * rows + 0.6)
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    grid = result.cart_masses, result.half_lengths
    for axes, (name, table) in zip(panels.flat, tables.items(), strict=False):
        axes.set_facecolor(VERMILION)
        axes.grid(False)
        shown = np.minimum(table, high).T  # what is infinite has the last colour
        axes.pcolormesh(*grid, shown, norm=scale, cmap=SHADES, shading="nearest")
        axes.set_title(name)
    for axes in panels.flat[len(tables) :]:
        axes.set_visible(False)
    figure.supxlabel(MASS, fontsize=9.0)
    figure.supylabel(LENGTH, fontsize=9.0)
    bar = figure.colorbar(ScalarMappable(scale, SHADES), ax=panels, location="right", pad=0.01)
    bar.set_label("delay margin [ms]")
    ticks = [x for x in TICKS if low <= x <= high]
    ticks = ticks if len(ticks) > 1 else list(np.geomspace(low, high, 3))
    bar.set_ticks(ticks, labels=[f"{x:.3g}" for x in ticks])
    bar.ax.yaxis.set_minor_locator(NullLocator())
    return figure


def _draw_lines(result: Result, tables: Mapping[str, NDArray[np.float64]]) -> Figure:
    """Draw delay margins over M or l, a cross at 0 where a loop is unstable."""
    label, values = MASS, result.cart_masses
    if len(values) == 1:
        label, values = LENGTH, result.half_lengths
    figure = new_figure(6.4, 4.0)
    axes = figure.subplots()
    colour = colours(tables)
    for index, (name, table) in enumerate(tables.items()):
        margins = table.ravel()
        marker = MARKERS[index % len(MARKERS)]
        axes.plot(values, margins, f"{marker}-", color=colour[name], markersize=5.0, label=name)
        if (unstable := np.array(values)[np.isnan(margins)]).size:
            axes.plot(unstable, 0.0 * unstable, "x", color=colour[name], clip_on=False)
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel(label)
    axes.set_ylabel("delay margin [ms]")
    figure.legend(loc="outside upper center", ncols=min(len(tables), COLUMNS))
    return figure


def delay_margins(result: Result) -> dict[str, NDArray[np.float64]]:
    """Return the delay margins [ms] of each sampled loop, (masses, lengths); NaN if unstable."""
    return {name: 1e3 * result.values(name, "delay", sampled=True) for name in result.margins}


def _ends(tables: Mapping[str, NDArray[np.float64]]) -> tuple[float, float]:
    """Return the least and the largest of all finite values, at least 1 % apart."""
    values = np.concatenate([table[np.isfinite(table)] for table in tables.values()])
    low, high = (float(values.min()), float(values.max())) if values.size else (1.0, 10.0)
    return low, max(high, 1.01 * low)


def draw_measured(result: Result) -> Figure:
    """Draw the delay that small motions in MuJoCo tolerate against the margin."""
    both = [
        (one.controller, 1e3 * one.margin, 100.0 * one.difference)
        for one in result.measured
        if one.margin is not None and one.difference is not None
    ]
    figure = new_figure(6.4, 4.4)
    axes = figure.subplots()
    for index, name in enumerate(dict.fromkeys(controller for controller, _, _ in both)):
        mine = [(margin, x) for controller, margin, x in both if controller == name]
        axes.plot(
            *zip(*mine, strict=True),
            MARKERS[index % len(MARKERS)],
            markersize=6.0,
            markerfacecolor="none",
            markeredgewidth=1.2,
            label=name,
        )
    axes.axhline(0.0, color=BLACK, linewidth=0.8)
    largest = max(abs(difference) for _, _, difference in both)
    axes.set_ylim(-1.15 * largest - 0.5, 1.15 * largest + 0.5)
    margins = [margin for _, margin, _ in both]
    if max(margins) > DECADE * min(margins):
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(ScalarFormatter())
    axes.set_xlabel("delay margin of the linearised loop [ms]")
    axes.set_ylabel("delay at which a small motion grows in MuJoCo,\nrelative to the margin [%]")
    axes.spines["bottom"].set_color(GREY)
    figure.legend(loc="outside right upper")
    return figure
