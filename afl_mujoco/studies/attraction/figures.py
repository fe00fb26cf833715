"""Maps of attraction side by side: by the equations, in MuJoCo, and where the two disagree."""

from __future__ import annotations

import math
from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from afl_mujoco.document.style import new_figure
from afl_mujoco.simulation.attraction.grid import (
    FALLEN,
    SETTLED,
    STATES,
    UNDECIDED,
    AttractionMap,
    Grid,
)
from afl_mujoco.studies.attraction.comparison import INSIDE, ON_BORDER, Comparison
from afl_mujoco.studies.attraction.deployed import WORDS, StartMap

FALLEN_COLOUR, UNDECIDED_COLOUR = "#D55E00", "#000000"
AGREE_COLOUR, BORDER_COLOUR, INSIDE_COLOUR = "#EDEDED", "#E69F00", "#0072B2"
"""Colours of Okabe and Ito, distinct to the colour-blind, and greys."""

GOOD_COLOUR, MISSED_COLOUR = "#56B4E9", "#F0E442"
"""Colours of a scenario's map."""

SHADES = "Blues"
"""Colour map of the time to settle, the lightest first."""

LABELS = {
    True: ("pole angle at the start φ₀ [rad]", "its rate at the start φ₀′ [rad/s]"),
    False: ("cart mass M [kg]", "half-length l [m]"),
}
"""Labels of the axes: of a map over states, and of one over plants."""


def draw_attraction(comparisons: Sequence[Comparison]) -> Figure:
    """Draw one row for each controller: ODE, MuJoCo, disagreement."""
    rows = len(comparisons)
    figure = new_figure(11.0, 0.9 + 2.9 * rows)
    panels = figure.subplots(rows, 3, sharex=True, sharey=True, squeeze=False)
    latest = _latest(comparisons)
    horizontal, vertical = LABELS[comparisons[0].ode.grid.plane == STATES]
    for row, comparison in zip(panels, comparisons, strict=True):
        _draw_map(row[0], comparison.ode, latest, "equations")
        _draw_map(row[1], comparison.mujoco, latest, "MuJoCo as deployed")
        _draw_disagreement(row[2], comparison)
        row[0].set_ylabel(f"{comparison.ode.controller}\n\n{vertical}")
    for axes in panels[-1]:
        axes.set_xlabel(horizontal)
    shades = ScalarMappable(Normalize(0.0, latest), _shades())
    bar = figure.colorbar(shades, ax=panels[:, :2], location="right", aspect=18 * rows, pad=0.01)
    bar.set_label("time to settle [s]")
    figure.legend(handles=_legend(), loc="outside lower center", ncols=5)
    return figure


def draw_starts(maps: Sequence[StartMap]) -> Figure:
    """Draw a panel for each controller: how its runs end, by where they start."""
    columns = min(len(maps), 3)
    rows = -(-len(maps) // columns)
    figure = new_figure(1.0 + 3.4 * columns, 0.9 + 3.0 * rows)
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    colours = dict(enumerate((GOOD_COLOUR, FALLEN_COLOUR, MISSED_COLOUR, UNDECIDED_COLOUR)))
    words = dict(enumerate(WORDS[maps[0].judged]))
    present = {x for found in maps for x in (*np.unique(found.outcome), found.own_outcome)}
    for axes, found in zip(panels.flat, maps, strict=False):
        image = np.empty((*found.outcome.shape, 4))
        for code, colour in colours.items():
            image[found.outcome == code] = matplotlib.colors.to_rgba(colour)
        edges = _edges(found.angles, found.rates)
        axes.grid(False)
        axes.imshow(image, extent=edges, origin="lower", aspect="auto", interpolation="nearest")
        own = colours[found.own_outcome]
        axes.plot(*found.own, "X", color=own, markeredgecolor="black", markersize=11)
        axes.set_xlim(edges[:2])
        axes.set_ylim(edges[2:])
        share = 100.0 * found.shares[words[SETTLED]]
        axes.set_title(f"{found.controller}: {share:.1f} %")
    for axes in panels.flat[len(maps) :]:
        axes.set_axis_off()
    horizontal, vertical = LABELS[True]
    figure.supxlabel(horizontal, fontsize=9)
    figure.supylabel(vertical, fontsize=9)
    handles = [
        Patch(facecolor=colour, edgecolor="#707070", label=words[code])
        for code, colour in colours.items()
        if code in present
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=4)
    return figure


def _latest(comparisons: Sequence[Comparison]) -> float:
    """Return the time that the darkest shade means: a whole number of seconds."""
    times = [
        found.time[found.outcome == SETTLED]
        for comparison in comparisons
        for found in (comparison.ode, comparison.mujoco)
    ]
    return float(math.ceil(max((t.max() for t in times if t.size), default=1.0)))


def _shades() -> ListedColormap:
    """Return the colours of the time to settle, without the palest."""
    return ListedColormap(matplotlib.colormaps[SHADES](np.linspace(0.12, 1.0, 256)))


def _extent(grid: Grid) -> tuple[float, float, float, float]:
    """Return the outer edges of a grid's outermost points."""
    return _edges(grid.columns, grid.rows)


def _edges(
    columns: NDArray[np.float64], rows: NDArray[np.float64]
) -> tuple[float, float, float, float]:
    """Return the outer edges of the outermost points."""
    edges: list[float] = []
    for values in (columns, rows):
        half = 0.5 * float(values[-1] - values[0]) / (len(values) - 1)
        edges += [float(values[0]) - half, float(values[-1]) + half]
    return edges[0], edges[1], edges[2], edges[3]


def _draw_map(axes: Axes, found: AttractionMap, latest: float, by: str) -> None:
    """Draw outcomes, and times to settle."""
    image: NDArray[np.float64] = _shades()(found.time / latest)
    for code, colour in ((FALLEN, FALLEN_COLOUR), (UNDECIDED, UNDECIDED_COLOUR)):
        image[found.outcome == code] = matplotlib.colors.to_rgba(colour)
    _show(axes, image, found.grid)
    share = found.shares()["settled"]
    axes.set_title(f"{by}: {100.0 * share:.1f} % settle")


def _draw_disagreement(axes: Axes, comparison: Comparison) -> None:
    """Draw where the outcomes differ."""
    kinds = comparison.disagreement()
    colours = np.array(
        [matplotlib.colors.to_rgba(c) for c in (AGREE_COLOUR, BORDER_COLOUR, INSIDE_COLOUR)]
    )
    _show(axes, colours[kinds], comparison.ode.grid)
    counts = [int((kinds == kind).sum()) for kind in (ON_BORDER, INSIDE)]
    axes.set_title(f"{counts[0]} differ on a border, {counts[1]} inside, of {kinds.size}")


def _show(axes: Axes, image: NDArray[np.float64], grid: Grid) -> None:
    """Draw one colour for each grid point."""
    axes.grid(False)
    axes.imshow(image, extent=_extent(grid), origin="lower", aspect="auto", interpolation="nearest")


def _legend() -> list[Patch]:
    """Return the legend of the colours that have no scale."""
    said = (
        (FALLEN_COLOUR, "fallen"),
        (UNDECIDED_COLOUR, "undecided at the horizon"),
        (AGREE_COLOUR, "same outcome"),
        (BORDER_COLOUR, "differs on a border"),
        (INSIDE_COLOUR, "differs inside"),
    )
    return [Patch(facecolor=colour, edgecolor="#707070", label=text) for colour, text in said]
