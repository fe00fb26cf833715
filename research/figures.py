"""Figures of the gain table, of random readings and of the contest of optimisers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from afl_mujoco.control.gains import GainFunction, scheduled_gain
from afl_mujoco.report.blocks import SUPERSCRIPTS
from afl_mujoco.report.figures import BLUE, GREY, VERMILION, new_figure, styled
from research.gain_tuning import GainTable
from research.optimisers import Result
from research.readings import EDGES

MASSES = (0.1, 0.5, 1.0, 2.0)
"""Cart masses whose slopes are drawn over the half-length [kg]."""

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")
MARKERS = ("o", "s", "^", "D")


def draw_gain_table(table: GainTable, fits: dict[str, GainFunction]) -> Figure:
    """Draw lambda over l: the optima as marks, the fits as lines, for some masses."""
    figure = new_figure(9.0, 5.0)
    axes = figure.add_subplot()
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
    axes.set(xlabel="half-length l [m]", ylabel="λ [1/s]", xlim=(0.0, 1.02), ylim=(0.0, 6.2))
    axes.legend(ncols=2, fontsize=9, loc="upper right")
    return figure


def fits_of(functions: Mapping[str, Any]) -> dict[str, GainFunction]:
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


SHOWN = 6
"""Unknowns shown for each case."""


def draw_sensitivity(cases: Sequence[Mapping[str, Any]]) -> Figure:
    """Draw improvements of the cases of readings.json above Sobol' indices of the unknowns."""
    figure = new_figure(11.0, 6.4)
    panels = figure.subplots(2, len(cases), squeeze=False)
    middles = np.array(EDGES[:-1]) + 0.5 * np.diff(EDGES)
    tallest = 100.0 * max(max(case["histogram"]) for case in cases)
    for (above, below), case in zip(panels.T, cases, strict=True):
        above.bar(middles, 100.0 * np.array(case["histogram"]), width=4.6, color=BLUE)
        above.axvline(case["paper"], color=VERMILION, linewidth=1.6, label="the paper")
        above.set_title(case["case"])
        above.set_xlim(EDGES[0], EDGES[-1])
        above.set_ylim(0.0, 1.08 * tallest)
        above.set_xlabel("improvement [%]")
        shown = case["drivers"][:SHOWN][::-1]
        names, totals = [one[0] for one in shown], np.array([one[1] for one in shown])
        ends = np.array([[total - low, high - total] for _, total, low, high in shown])
        below.barh(names, totals, color=BLUE, height=0.7)
        below.errorbar(totals, names, xerr=np.clip(ends.T, 0.0, None), fmt="none", ecolor=GREY)
        below.set_xlim(0.0, 1.0)
        below.set_xlabel("total-order Sobol' index")
    panels[0, 0].set_ylabel("share of readings [%]")
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper right")
    return figure


_POINTS = 600
"""Number of points of a curve, evenly spaced on the logarithmic axis."""

_STYLES: tuple[dict[str, Any], ...] = (  # colours of Okabe and Ito; legible without them
    {"color": "#0072B2", "ls": "-", "lw": 2.4, "marker": "o"},
    {"color": "#56B4E9", "ls": "--", "lw": 1.8, "marker": "o", "mfc": "white"},
    {"color": "#D55E00", "ls": "-", "lw": 1.4, "marker": "^"},
    {"color": "#E69F00", "ls": "--", "lw": 1.4, "marker": "^", "mfc": "white"},
    {"color": "#009E73", "ls": "-.", "lw": 1.6, "marker": "s"},
    {"color": "#000000", "ls": (0, (5, 1, 1, 1, 1, 1)), "lw": 1.6, "marker": "D"},
    {"color": "#7F7F7F", "ls": ":", "lw": 1.8, "marker": "x"},
)


@styled()
def draw_contest(result: Result) -> Figure:
    """Draw how many of the targets each optimiser has reached over evaluations of the cost."""
    benchmark = result.benchmark
    figure = new_figure(8.5, 6.2)
    axis = figure.subplots()
    steps = np.geomspace(1.0, benchmark.budget, _POINTS)
    gap = _POINTS // 11
    for k, (name, style) in enumerate(zip(benchmark.optimisers, cycle(_STYLES), strict=False)):
        rises, shares = result.distribution(name)
        curve = np.concatenate(([0.0], shares))[np.searchsorted(rises, steps, side="right")]
        first = gap * k // len(benchmark.optimisers)  # lest the markers of equal curves coincide
        axis.semilogx(steps, curve, label=name, markevery=(first, gap), ms=6.0, **style)
    axis.set_xlim(1.0, benchmark.budget)
    axis.set_ylim(0.0, 1.02)
    axis.xaxis.set_major_formatter(
        lambda x, _: f"10{str(round(np.log10(x))).translate(SUPERSCRIPTS)}"
    )
    axis.yaxis.set_major_formatter(PercentFormatter(1.0))
    axis.set_xlabel("evaluations of the cost")
    axis.set_ylabel("share of all (plant, target, run) solved")
    targets = ", ".join(f"{100.0 * target:g} %" for target in benchmark.targets)
    figure.suptitle(
        f"{len(benchmark.problems)} plants, {benchmark.runs} runs on each, to within {targets} "
        "of the optimal cost",
        fontsize="medium",
    )
    figure.legend(loc="outside lower center", ncols=2, handlelength=4.0)
    return figure
