"""The gain table as surfaces, and its slope beside the functions fitted to it (Figs. 2 to 4)."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D
from numpy.typing import NDArray

from afl_mujoco.control.gain_function import (
    GAIN_NAMES,
    GainFunction,
    scheduled_gain,
    shipped_file,
)
from afl_mujoco.control.gain_table import GainTable
from afl_mujoco.report import old as blocks
from afl_mujoco.report.style import new_figure, save_figure, styled

SYMBOLS = {"switching": "K [m/s²]", "slope": "λ [1/s]", "boundary_layer": "Φ [m/s³]"}
MASSES = (0.1, 0.5, 1.0, 2.0)
"""Cart masses whose slopes are drawn over the half-length [kg]."""

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")
MARKERS = ("o", "s", "^", "D")


def draw_gain_table(table: GainTable, fits: dict[str, GainFunction]) -> Figure:
    """Draw the analogue of the paper's Figs. 2 to 4.

    Parameters
    ----------
    fits
        Gain functions to draw over it, by their label in the legend; the first is the paper's.
    """
    figure = new_figure(11.0, 8.6)
    grid = figure.add_gridspec(2, 3, height_ratios=(1.0, 1.15))
    published = next(iter(fits.values()))
    for place, name in enumerate(GAIN_NAMES):
        surface = figure.add_subplot(grid[0, place], projection="3d")
        _draw_surface(surface, table, name, published)
    _draw_slopes(figure.add_subplot(grid[1, :]), table, fits)
    return figure


def _grid(table: GainTable, name: str) -> tuple[NDArray[np.float64], ...]:
    """Return masses, lengths and a gain as matrices."""
    masses, lengths = (np.unique(table.column(x)) for x in ("cart_mass", "half_length"))
    order = np.lexsort((table.column("half_length"), table.column("cart_mass")))
    gain = table.column(name)[order].reshape(len(masses), len(lengths))
    return (*np.meshgrid(masses, lengths, indexing="ij"), gain)


def _draw_surface(axes: Axes3D, table: GainTable, name: str, published: GainFunction) -> None:
    """Draw one gain: the optima as a surface, the paper's function as a wire frame."""
    masses, lengths, gain = _grid(table, name)
    paper = scheduled_gain(masses, lengths, getattr(published, name))
    shades = {"vmin": gain.min(), "vmax": max(gain.max(), 1.001 * gain.min())}  # no round-off
    facets = 20 if np.ptp(gain) > 1e-9 * gain.max() else 1  # a plane needs no more
    axes.plot_surface(
        masses, lengths, gain, cmap="viridis", alpha=0.9, linewidth=0, rcount=facets,
        ccount=facets, **shades,
    )  # fmt: skip
    axes.plot_wireframe(masses, lengths, paper, color="0.35", linewidth=0.6, rstride=2, cstride=2)
    axes.set_xlabel("M [kg]")
    axes.set_ylabel("l [m]")
    axes.set_xticks((0.0, 0.5, 1.0, 1.5, 2.0))
    axes.set_title(f"{SYMBOLS[name]}: optima (surface), paper (wires)", fontsize=10)
    axes.view_init(elev=24, azim=38)


def _draw_slopes(axes: Axes, table: GainTable, fits: dict[str, GainFunction]) -> None:
    """Draw lambda over l: the optima as marks, the fits as lines, for some masses."""
    lengths = np.linspace(0.05, 1.0, 200)
    styles = (":", "--", "-")
    for mass, colour, marker in zip(MASSES, COLOURS, MARKERS, strict=True):
        here = np.isclose(table.column("cart_mass"), mass)
        axes.plot(
            table.column("half_length")[here], table.column("slope")[here], marker, color=colour,
            markersize=4, label=f"optimum, M = {mass:g} kg",
        )  # fmt: skip
        for fit, style in zip(fits.values(), styles, strict=True):
            slope = scheduled_gain(mass, lengths, fit.slope)
            axes.plot(lengths, slope, style, color=colour, linewidth=1.2)
    for name, style in zip(fits, styles, strict=True):
        axes.plot([], [], style, color="0.2", label=name)
    axes.set(xlabel="half-length l [m]", ylabel=SYMBOLS["slope"], xlim=(0.0, 1.02), ylim=(0.0, 6.2))
    axes.legend(ncols=2, fontsize=9, loc="upper right")


def gains_figure(name: str) -> blocks.Figure:
    """Return the figure of the table and the functions that come with the package."""
    table = GainTable.shipped()
    spans = [f"{SYMBOLS[gain]} {_span(table.column(gain))}" for gain in GAIN_NAMES]
    return blocks.Figure(
        name=name,
        title="Optimal gains and the functions fitted to them",
        caption="Analogue of the paper's Figs. 2 to 4: the gains that minimise the objective (O1) "
        f"for each of {len(table.rows)} plants, searched again (surface), with the paper's gain "
        "functions (wires); below, the slope λ over the half-length for some cart masses, with "
        "the functions fitted to it.",
        alt="Three surfaces over M and l, each with a wire frame, and below them a panel of λ "
        f"over l. Over the table the optima span {', '.join(spans)}.",
        draw=_draw_shipped,
    )


def _draw_shipped() -> Figure:
    """Draw the table and the functions that come with the package."""
    text = shipped_file("gain_functions.json").read_text("utf-8")
    return draw_gain_table(GainTable.shipped(), _fits(json.loads(text)))


def _span(values: NDArray[np.float64]) -> str:
    """Return the range of some values in words."""
    return f"{values.min():.4g} to {values.max():.4g}"


def _fits(functions: Mapping[str, Any]) -> dict[str, GainFunction]:
    """Return the gain functions of a gain_functions.json and the paper's, by legend label."""
    squares = {
        fit["gain"]: tuple(fit["coefficients"])
        for fit in functions["fits"]
        if fit["method"] == "least squares"
    }
    chosen = {name: tuple(w) for name, w in functions["coefficients"].items()}
    return {
        "paper (Table 2)": GainFunction.published(),
        "(G1), least squares on the optima": GainFunction(**squares),
        "adaptive-retuned": GainFunction(**chosen),
    }


def main(folder: Path) -> None:
    """Draw the table and the functions that are in a folder."""
    table = GainTable.load(folder / "gain_table.json")
    functions = json.loads((folder / "gain_functions.json").read_text(encoding="utf-8"))
    with styled():
        figure = draw_gain_table(table, _fits(functions))
    save_figure(figure, folder / "gain_table.png")
    print(f"wrote {folder / 'gain_table.png'}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
