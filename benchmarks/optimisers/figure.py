"""The figure of the benchmark: the share of the targets reached over evaluations."""

from __future__ import annotations

from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from afl_mujoco.report.style import new_figure, styled
from optimisers.result import Result

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
def draw_benchmark(result: Result) -> Figure:
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
