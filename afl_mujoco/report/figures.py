"""The style of every figure, and those that studies share: graded cells, dots, curves over time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from colorsys import hsv_to_rgb
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import chain, count
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex, to_rgba
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import Patch
from numpy.typing import NDArray

from afl_mujoco.files import atomic_file
from afl_mujoco.report import blocks

BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
BLUE, VERMILION, PURPLE, GREY = "#0072B2", "#D55E00", "#CC79A7", "#707070"
"""Colours of Okabe and Ito, which the colour-blind can tell apart, and a grey."""

CONTROLLERS: Mapping[str, str] = {
    "fixed": ORANGE,  # light, both: black dashes show on them
    "adaptive": SKY,
    "fixed-retuned": VERMILION,
    "adaptive-retuned": BLUE,
    "fixed-nominal": PURPLE,
    "adaptive-nominal": GREEN,
    "adaptive-angle": "#AA4499",
    "lqr": "#332288",  # far from that of one's own, beside which it mostly is
    "pole-placement": "#882255",
    "partial-linearization": "#999933",
}
"""Colour of each controller that has its own; Paul Tol's after those of Okabe and Ito."""

_SPARE = ("#E3002C", "#44AA99", "#DDCC77", "#88CCEE", GREY)  # the first: one's own stands out

_LINES: tuple[Any, ...] = ("-", (0.0, (7.0, 1.5)), (0.0, (4.0, 1.5, 1.0, 1.5)), (0.0, (1.5, 1.2)))

TIME = "time t [s]"

PNG_DPI = 130

_RC: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.labelsize": 9.0,
    "legend.fontsize": 9.0,
    "legend.frameon": False,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "figure.titlesize": 11.0,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "axes.facecolor": "white",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#DDDDDD",
    "grid.linewidth": 0.6,
    "axes.prop_cycle": cycler(color=(BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK)),
    "lines.linewidth": 1.6,
    "lines.solid_capstyle": "round",
    "svg.hashsalt": "afl-mujoco",
    "svg.fonttype": "path",
    "text.parse_math": False,  # a name is shown as it is
}


@contextmanager
def styled() -> Iterator[None]:
    """Draw in the style of all figures; also a decorator."""
    with matplotlib.rc_context(_RC):
        yield


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure [in] that needs no display."""
    layout = ConstrainedLayoutEngine(w_pad=0.1, h_pad=0.06)  # [in]: vectors are wider than pixels
    figure = Figure(figsize=(width, height), dpi=PNG_DPI, layout=layout)
    FigureCanvasAgg(figure)
    return figure


def colours(controllers: Iterable[str]) -> dict[str, str]:
    """Return a colour for each controller of a figure: its own if it has one, no two the same."""
    golden = (to_hex(hsv_to_rgb(0.618 * i % 1.0, 0.8, 0.6)) for i in count())
    spare = chain(_SPARE, golden)
    return {name: CONTROLLERS.get(name) or next(spare) for name in dict.fromkeys(controllers)}


def lines(controllers: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return how the curves of controllers are drawn beside their colours: one's own are wide."""
    names = list(dict.fromkeys(controllers))
    shipped = [name for name in names if name in CONTROLLERS]
    found = {name: {"linewidth": 1.9, "linestyle": "-"} for name in names}
    for number, name in enumerate(shipped):
        found[name] = {"linewidth": 1.3, "linestyle": _LINES[number % len(_LINES)]}
    return found


def quietest_on_top(signals: Mapping[str, NDArray[np.float64]]) -> dict[str, float]:
    """Return the layer of each curve, so that one that chatters hides no other."""
    restless = {name: float(np.nansum(np.abs(np.diff(x)))) for name, x in signals.items()}
    order = sorted(signals, key=lambda name: -restless[name])
    return {name: 2.0 + 0.01 * k for k, name in enumerate(order)}  # 2 is that of lines


def lay_out(figure: Figure) -> None:
    """Lay out a figure once, so that its files need not repeat the layout."""
    engine = figure.get_layout_engine()
    if engine is not None:
        with styled():
            engine.execute(figure)
        figure.set_layout_engine(None)


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as PNG or SVG, whole or not at all; the same figure gives the same bytes."""
    kind = path.suffix.removeprefix(".")
    dated: dict[str, Any] = {"Date": None} if kind == "svg" else {}
    lay_out(figure)  # else it would be drawn once more to be laid out
    with styled(), atomic_file(path) as temporary:
        figure.savefig(temporary, dpi=PNG_DPI, format=kind, metadata=dated)


def write_figure(figure: blocks.Figure, folder: Path) -> None:
    """Draw a figure and write it as SVG and PNG into a folder that exists."""
    with styled():
        drawing = figure.draw()
    for name in figure.files.values():
        save_figure(drawing, folder / name)


GRADES = (VERMILION, "#F3C65F", "#BFE0F5", BLUE)
"""Colours from bad to good; the light ones carry black text."""

IDLE = "#E4E4E4"
"""Colour of what does not apply."""

_DASHED = (0.0, (6.0, 3.0))


def heat(
    rows: Sequence[str],
    columns: Sequence[str],
    grades: Sequence[Sequence[int]],
    texts: Sequence[Sequence[str]],
    words: Sequence[str],
) -> Figure:
    """Draw cells, each with a text on the colour of its grade, an index into `words`."""
    shades = (*GRADES, IDLE)
    figure = new_figure(max(2.9 + 1.05 * len(columns), 6.0), 1.3 + 0.3 * len(rows))
    axes = figure.subplots()
    axes.imshow(np.array([to_rgba(shade) for shade in shades])[np.array(grades)], aspect="auto")
    for i, j in np.ndindex(len(rows), len(columns)):
        dark = shades[grades[i][j]] in (VERMILION, BLUE)
        colour = "#FFFFFF" if dark else BLACK
        axes.text(j, i, texts[i][j], ha="center", va="center", fontsize=8.5, color=colour)
    axes.set_yticks(range(len(rows)), rows)
    axes.xaxis.tick_top()
    axes.set_xticks(range(len(columns)), [name.replace("-", "-\n", 1) for name in columns])
    axes.grid(False)
    axes.tick_params(length=0.0)
    axes.spines[:].set_visible(False)
    for draw, names in ((axes.axhline, rows), (axes.axvline, columns)):
        for i in range(1, len(names)):
            draw(i - 0.5, color="#FFFFFF", linewidth=1.5)
    present = [k for k in range(len(words)) if any(k in row for row in grades)]
    handles = [Patch(facecolor=shades[k], label=words[k]) for k in present]
    figure.legend(handles=handles, loc="outside lower center", ncols=2)
    return figure


@dataclass(frozen=True, slots=True, kw_only=True)
class Dot:
    """A mark on a scale, with an interval around it, a thicker one inside, and a text."""

    at: float
    thin: tuple[float, float] | None = None
    thick: tuple[float, float] | None = None
    text: str = ""
    hollow: bool = False


def dots(
    rows: Mapping[str, Sequence[Dot]],
    label: str,
    *,
    bounds: tuple[float, float] | None = None,
    line: float | None = None,
    colour_of: Mapping[str, str] | None = None,
    spread: float = 0.28,
) -> Figure:
    """Draw marks with intervals, a row for each name; `spread` is a share of a row's height."""
    shades = dict(colour_of or colours(rows))
    figure = new_figure(7.5, 1.3 + 0.5 * len(rows))
    axis = figure.subplots()
    if line is not None:
        axis.axvline(line, color=BLACK, linewidth=0.9)
    far = [x for row in rows.values() for one in row for x in (one.at, *(one.thin or ()))]
    low, high = bounds or (min(far, default=0.0), max(far, default=1.0))
    for number, (name, row) in enumerate(rows.items()):
        places = number + spread * (np.arange(len(row)) - 0.5 * (len(row) - 1))
        for one, place in zip(row, places.tolist(), strict=True):
            _draw_dot(axis, one, place, shades[name], low + 0.78 * (high - low))
    axis.set_yticks(range(len(rows)), list(rows))
    axis.set_ylim(len(rows) - 0.5, -0.5)
    if bounds is not None:
        axis.set_xlim(*bounds)
    axis.set_xlabel(label)
    axis.grid(visible=False, axis="y")
    return figure


def _draw_dot(axis: Axes, one: Dot, place: float, colour: str, crowded: float) -> None:
    """Draw a mark; its text is to its left where there is no room to the right."""
    for ends, width in ((one.thin, 1.8), (one.thick, 5.0)):
        if ends is not None:
            axis.plot(ends, [place, place], color=colour, linewidth=width)
    face = "white" if one.hollow else colour
    size = 9.0 if one.hollow else 6.0  # so that a filled one is seen within
    axis.plot(one.at, place, "o", color=colour, markersize=size, markerfacecolor=face, zorder=3)
    if one.text:
        low, high = one.thin or (one.at, one.at)
        right = high > crowded
        axis.annotate(
            one.text, (low if right else high, place), textcoords="offset points",
            xytext=(-6.0 if right else 6.0, 0.0), va="center", fontsize=8.0,
            ha="right" if right else "left",
        )  # fmt: skip


Curves = Mapping[str, tuple[NDArray[np.float64], NDArray[np.float64]]]
"""Instants [s] and values by name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """Curves over time, pale ones behind them, limits, and a band on both sides of `about`."""

    label: str
    curves: Curves
    pale: Curves = field(default_factory=dict)
    limits: Sequence[float] = ()
    band: float | None = None
    about: float = 0.0
    black: bool = False  # curves in black, each in its own line style, with their own legend


def curves(
    panels: Sequence[Panel], duration: float, *, shaded: Sequence[tuple[float, float]] = ()
) -> Figure:
    """Draw panels over time [s], some of it shaded; a curve that ends early ends with a cross."""
    heights = [1.6 if panel.black else 2.6 for panel in panels]
    figure = new_figure(9.0, 0.8 + 0.75 * sum(heights))
    axes = figure.subplots(len(panels), 1, sharex=True, height_ratios=heights, squeeze=False)[:, 0]
    shades = colours(dict.fromkeys(n for panel in panels if not panel.black for n in panel.curves))
    for axis, panel in zip(axes, panels, strict=True):
        _draw_panel(axis, panel, shades, duration)
        for low, high in shaded:
            axis.axvspan(low, high, color=GREY, alpha=0.25, linewidth=0.8)
        if panel.black or axis is axes[0]:
            columns = min(max(len(panel.curves), 1), 5)
            axis.legend(ncols=columns, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    axes[-1].set_xlabel(TIME)
    axes[-1].set_xlim(0.0, duration)
    return figure


def _draw_panel(axis: Axes, panel: Panel, shades: Mapping[str, str], duration: float) -> None:
    axis.set_ylabel(panel.label)
    if panel.band is not None:
        ends = (panel.about - panel.band, panel.about + panel.band)
        axis.axhspan(*ends, color=GREY, alpha=0.18, linewidth=0.0)
    for limit in panel.limits:
        axis.axhline(limit, color=BLACK, linewidth=0.9, linestyle=_DASHED)
    how = lines(panel.curves)
    order = quietest_on_top({name: values for name, (_, values) in panel.curves.items()})
    for number, (name, (time, values)) in enumerate(panel.curves.items()):
        style: dict[str, Any] = {"color": shades.get(name, BLACK), "zorder": order[name]}
        if panel.black:
            style = {"color": BLACK, "linestyle": ("-", ":", "--", "-.")[number % 4]}
        else:
            style |= how[name]
        axis.plot(time, values, label=name, **{"linewidth": 1.3, **style})
        if time[-1] < duration - 1e-9 and not panel.black:
            axis.plot(time[-1], values[-1], "x", color=style["color"], markersize=8)
    for name, (time, values) in panel.pale.items():
        axis.plot(time, values, color=shades[name], linewidth=0.6, alpha=0.4, zorder=1.0)
    if panel.black and all(np.min(values) >= 0.0 for _, values in panel.curves.values()):
        axis.set_ylim(bottom=0.0)
