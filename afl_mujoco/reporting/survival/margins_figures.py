"""Margins as figures: the delay margin over the plants, and what MuJoCo itself bears."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.ticker import FixedLocator, NullLocator, ScalarFormatter
from numpy.typing import NDArray

from afl_mujoco.document.style import (
    BLACK,
    GREY,
    LENGTH,
    MASS,
    VERMILION,
    Drawn,
    in_words,
    new_figure,
    styled,
)
from afl_mujoco.reporting.survival.ladder.words import Row

COLUMNS = 4
SHADES = "viridis"
TICKS = (1, 2, 5, 10, 20, 50, 100, 200, 500)
"""Of a scale of delays [ms]."""


def draw_margins(content: Row) -> list[Drawn]:
    """Draw the figures of a survey of margins.

    Parameters
    ----------
    content
        What a margins.json holds.
    """
    figures = [draw_delay_margins(content)]
    measured = [row for row in content["measured"] if row["difference"] is not None]
    return [*figures, draw_measured(measured)] if measured else figures


@styled()
def draw_delay_margins(content: Row) -> Drawn:
    """Draw the delay margin of each law, its force held, over the plants.

    Parameters
    ----------
    content
        As of `draw_margins`.
    """
    names = list(content["margins"])
    tables = {name: _delays(content["margins"][name]["sampled"]) for name in names}
    low, high = _ends(tables.values())
    scale = LogNorm(low, high)
    rows = -(-len(names) // COLUMNS)
    figure = new_figure(2.6 * min(len(names), COLUMNS) + 1.2, 2.3 * rows + 0.6)
    panels = figure.subplots(
        rows, min(len(names), COLUMNS), sharex=True, sharey=True, squeeze=False
    )
    masses, lengths = content["cart_masses"], content["half_lengths"]
    for axes, name in zip(panels.flat, names, strict=False):
        axes.set_facecolor(VERMILION)
        axes.grid(False)
        axes.pcolormesh(masses, lengths, tables[name].T, norm=scale, cmap=SHADES, shading="nearest")
        axes.set_title(name)
    for axes in panels.flat[len(names) :]:
        axes.set_visible(False)
    figure.supxlabel(MASS, fontsize=9.0)
    figure.supylabel(LENGTH, fontsize=9.0)
    bar = figure.colorbar(ScalarMappable(scale, SHADES), ax=panels, location="right", pad=0.01)
    bar.set_label("delay margin [ms]")
    bar.ax.yaxis.set_major_locator(FixedLocator([x for x in TICKS if low <= x <= high]))
    bar.ax.yaxis.set_minor_locator(NullLocator())
    bar.ax.yaxis.set_major_formatter(ScalarFormatter())
    least = {name: float(np.nanmin(t)) for name, t in tables.items() if np.isfinite(t).any()}
    return Drawn(
        name="margins-delay",
        title="How much delay the linearised loop bears",
        caption=(
            "Delay margin at upright of the loop linearised on MuJoCo, its force held for "
            f"{1e3 * content['control_period']:g} ms, over "
            f"{len(content['cart_masses'])} x {len(content['half_lengths'])} plants. "
            "Red: not stable even without delay."
        ),
        alt="Least delay margin: "
        + "; ".join(f"{name} {in_words(value)} ms" for name, value in least.items())
        + ".",
        figure=figure,
    )


def _delays(margins: Row) -> NDArray[np.float64]:
    """Return delay margins [ms], shape (masses, lengths); NaN where the loop is not stable."""
    rows = [[np.nan if x is None else 1e3 * x for x in row] for row in margins["delay"]]
    return np.array(rows, dtype=np.float64)


def _ends(tables: Iterable[NDArray[np.float64]]) -> tuple[float, float]:
    """Return the least and the largest of all finite values, apart."""
    values = np.concatenate([table[np.isfinite(table)] for table in tables])
    low, high = (float(values.min()), float(values.max())) if values.size else (1.0, 10.0)
    return low, max(high, 1.01 * low)


@styled()
def draw_measured(rows: Sequence[Row]) -> Drawn:
    """Draw what small motions in MuJoCo bear against the margin.

    Parameters
    ----------
    rows
        Comparisons that have both, as of ``measured`` in margins.json.
    """
    figure = new_figure(6.4, 4.4)
    axes = figure.subplots()
    names = list(dict.fromkeys(row["controller"] for row in rows))
    for index, name in enumerate(names):
        mine = [row for row in rows if row["controller"] == name]
        axes.plot(
            [1e3 * row["margin"] for row in mine],
            [100.0 * row["difference"] for row in mine],
            "osD^vP*Xhd<>"[index % 12],
            markersize=6.0,
            markerfacecolor="none",
            markeredgewidth=1.2,
            label=name,
        )
    axes.axhline(0.0, color=BLACK, linewidth=0.8)
    largest = 100.0 * max(abs(row["difference"]) for row in rows)
    axes.set_ylim(-1.15 * largest - 0.5, 1.15 * largest + 0.5)
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(ScalarFormatter())
    axes.set_xlabel("delay margin of the linearised loop [ms]")
    axes.set_ylabel("delay at which a small motion grows in MuJoCo,\nrelative to the margin [%]")
    axes.spines["bottom"].set_color(GREY)
    figure.legend(loc="outside right upper")
    plants = len({(row["cart_mass"], row["half_length"]) for row in rows})
    return Drawn(
        name="margins-measured",
        title="Margins against MuJoCo itself",
        caption=(
            "Each mark is one controller on one plant: the delay from which a motion of 1 mrad no "
            "longer decays in MuJoCo, found by bisection to 0.1 %, against the margin."
        ),
        alt=(
            f"{len(rows)} comparisons on {plants} plants; the largest difference is "
            f"{in_words(largest)} %."
        ),
        figure=figure,
    )
