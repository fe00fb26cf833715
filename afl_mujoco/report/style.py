"""The style of every figure: colours, fonts, labels with units, files that repeat bit for bit."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from colorsys import hsv_to_rgb
from contextlib import contextmanager
from itertools import chain, count
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from cycler import cycler
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
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
    "lqr": "#882255",
    "pole-placement": "#332288",
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
