"""Curves that grow with a film: drawn once by matplotlib, revealed frame by frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from afl_mujoco.films.captions import BOTTOM
from afl_mujoco.films.replay import Replay
from afl_mujoco.report.style import colours

Picture = NDArray[np.uint8]

LINES = ("-", "--", "-.", ":")
LUMINANCE, LEAST_LUMINANCE = np.array([0.2126, 0.7152, 0.0722]), 0.45
"""Luminance of red, green and blue; and the least luminance of a curve."""

LABELS = (
    "pole angle φ [rad]",
    "cart position z [m]",
    "force F [N], log",
    "mass M [kg]",
    "half-length l [m]",
)
DESIGN_HEIGHT = 360
"""Height for which the sizes of letters and lines are given [px], at 100 dots per inch."""

CURSOR = (238, 241, 246)

_BACKGROUND = "#{:02x}{:02x}{:02x}".format(*BOTTOM)
_DARK: dict[Any, Any] = {
    "text.parse_math": False,  # a name is shown as it is
    "font.size": 8.5,
    "axes.facecolor": "#10151f",
    "axes.edgecolor": "#5a6478",
    "axes.labelcolor": "#dfe3ea",
    "grid.color": "#39435a",
    "text.color": "#dfe3ea",
    "xtick.color": "#a4acba",
    "ytick.color": "#a4acba",
}


@dataclass(frozen=True, slots=True, eq=False)
class GrowingPlots:
    """Curves that can be shown up to an instant.

    Attributes
    ----------
    empty, full
        Pictures without and with the curves, shape (height, width, 3).
    boxes
        Left, right, top and bottom of each axes [px].
    duration
        Time that the axes span [s].
    """

    empty: Picture
    full: Picture
    boxes: tuple[tuple[int, int, int, int], ...]
    duration: float

    def until(self, time: float) -> Picture:
        """Return the picture with the curves up to an instant, and a cursor there.

        Parameters
        ----------
        time
            The instant [s].
        """
        picture = self.empty.copy()
        for left, right, top, bottom in self.boxes:
            now = left + round((right - left) * min(time / self.duration, 1.0))
            picture[top:bottom, left:now] = self.full[top:bottom, left:now]
            picture[top:bottom, now : now + 1] = CURSOR
        return picture


def draw_plots(replays: Sequence[Replay], size: tuple[int, int]) -> GrowingPlots:
    """Draw phi, z, F, M and l of runs of one scenario.

    Parameters
    ----------
    size
        Width and height [px].
    """
    with rc_context(_DARK):
        dpi = 100.0 * size[1] / DESIGN_HEIGHT
        figure = Figure(
            figsize=(size[0] / dpi, size[1] / dpi),
            dpi=dpi,
            layout="constrained",
            facecolor=_BACKGROUND,
        )
        canvas = FigureCanvasAgg(figure)
        axes = _axes(figure)
        curves = _plot(axes, replays)
        full = _picture(canvas)
        for line in curves:
            line.set_visible(False)
        empty = _picture(canvas)
    boxes = tuple(_box(axis, size[1]) for axis in axes)
    return GrowingPlots(empty, full, boxes, _end(replays))


def _axes(figure: Figure) -> list[Axes]:
    """Return the axes of phi, z, F, M and l."""
    grid = figure.add_gridspec(2, 6)
    places = ((0, 0, 3), (0, 3, 6), (1, 0, 2), (1, 2, 4), (1, 4, 6))
    return [figure.add_subplot(grid[row, first:last]) for row, first, last in places]


def _plot(axes: Sequence[Axes], replays: Sequence[Replay]) -> list[Line2D]:
    """Draw the curves and return their lines."""
    lines, names = [], [str(replay.controller) for replay in replays]
    colour = colours(names)
    for replay, name, dash in zip(replays, names, LINES, strict=False):
        style: dict[str, Any] = {"color": _on_dark(colour[name]), "ls": dash, "lw": 1.5}
        curves = (replay.state[:, 1], replay.state[:, 0], replay.force)
        for axis, curve in zip(axes, curves, strict=False):
            lines += axis.plot(replay.time, curve, label=f"{replay.controller}", **style)
    for axis, curve in zip(axes[3:], (replays[0].cart_mass, replays[0].half_length), strict=True):
        lines += axis.plot(replays[0].time, curve, color="#dfe3ea", lw=1.5)
        axis.set_ylim(0.0, 1.1 * float(curve.max()))
    axes[2].set_yscale("symlog", linthresh=5.0)
    axes[2].set_yticks([-50, -5, 0, 5, 50], ["-50", "-5", "0", "5", "50"])
    for axis, label in zip(axes, LABELS, strict=True):
        axis.set_ylabel(label)
        axis.set_xlim(0.0, _end(replays))
        axis.xaxis.set_major_locator(MaxNLocator(nbins=5, steps=[1, 2, 5, 10]))
        axis.grid(lw=0.6)
    for axis in axes[2:]:
        axis.set_xlabel("time t [s]")
    axes[0].figure.legend(
        handles=lines[:: len(curves)][: len(replays)],
        loc="outside upper center",
        ncols=2,
        frameon=False,
        handlelength=2.6,
    )
    return lines


def _on_dark(colour: str) -> tuple[float, float, float]:
    """Return a colour of a page's figures, mixed with white to be visible on the dark."""
    rgb = np.array(to_rgb(colour))
    bright = float(rgb @ LUMINANCE)
    white = (LEAST_LUMINANCE - bright) / (1.0 - bright) if bright < LEAST_LUMINANCE else 0.0
    red, green, blue = (rgb + (1.0 - rgb) * white).tolist()
    return red, green, blue


def _end(replays: Sequence[Replay]) -> float:
    """Return the end of the last frame [s]."""
    time = replays[0].time
    return float(time[-1] + (time[1] - time[0] if len(time) > 1 else 1.0))


def _picture(canvas: FigureCanvasAgg) -> Picture:
    """Return what is drawn, shape (height, width, 3)."""
    canvas.draw()  # type: ignore[no-untyped-call]
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()  # type: ignore[no-untyped-call]


def _box(axis: Axes, height: int) -> tuple[int, int, int, int]:
    """Return left, right, top and bottom of the inside of axes [px]."""
    box = axis.get_window_extent()
    return round(box.x0) + 1, round(box.x1) - 1, height - round(box.y1) + 1, height - round(box.y0)
