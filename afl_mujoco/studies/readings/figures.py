"""Improvements over random readings, and what drives them."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from afl_mujoco.report.style import BLUE, GREY, VERMILION, new_figure
from afl_mujoco.studies.readings.sensitivity import EDGES, Sensitivity

SHOWN = 6
"""Unknowns shown for each case."""


def draw_sensitivity(sensitivity: Sensitivity) -> Figure:
    """Draw the histogram of each improvement above the Sobol' indices of its main unknowns."""
    cases = sensitivity.cases
    figure = new_figure(11.0, 6.4)
    panels = figure.subplots(2, len(cases), squeeze=False)
    middles = np.array(EDGES[:-1]) + 0.5 * np.diff(EDGES)
    tallest = 100.0 * max(max(case.histogram) for case in cases)
    for (above, below), case in zip(panels.T, cases, strict=True):
        above.bar(middles, 100.0 * np.array(case.histogram), width=4.6, color=BLUE)
        above.axvline(case.paper, color=VERMILION, linewidth=1.6, label="the paper")
        above.set_title(case.case)
        above.set_xlim(EDGES[0], EDGES[-1])
        above.set_ylim(0.0, 1.08 * tallest)
        above.set_xlabel("improvement [%]")
        shown = case.drivers[:SHOWN][::-1]
        names, totals = [one[0] for one in shown], np.array([one[1] for one in shown])
        ends = np.array([[total - low, high - total] for _, total, low, high in shown])
        below.barh(names, totals, color=BLUE, height=0.7)
        below.errorbar(totals, names, xerr=np.clip(ends.T, 0.0, None), fmt="none", ecolor=GREY)
        below.set_xlim(0.0, 1.0)
        below.set_xlabel("total-order Sobol' index")
    panels[0, 0].set_ylabel("share of readings [%]")
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper right")
    return figure
