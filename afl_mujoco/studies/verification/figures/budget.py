"""The error budget: the parts of the difference of a run as deployed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from afl_mujoco.report import old as blocks
from afl_mujoco.report.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SUPERSCRIPTS,
    VERMILION,
    decade_above,
    in_words,
    new_figure,
)
from afl_mujoco.simulation.metrics import STATE_UNITS, SYMBOLS
from afl_mujoco.studies.verification.checks.error_budget import ErrorBudget

DARK = "#404040"
"""Colour of what is not explained."""

SOURCES: Mapping[str, tuple[str, str, str]] = {
    "control_hold": ("control held", VERMILION, "s"),
    "schedule_sampling": ("M, l frozen per step", ORANGE, "^"),
    "disturbance_timing": ("disturbance moved to steps", PURPLE, "v"),
    "integrator": ("MuJoCo's integrator", BLUE, "D"),
    "model_form": ("model form", GREEN, "o"),
    "residual": ("not explained", DARK, "x"),
}
"""Words, colour and marker of each part of the total, in the order of the steps."""

_TOTAL = ("total", BLACK, "|")
_SIZES = {"total": 10.0, "disturbance_timing": 7.5, "residual": 6.0}
_LEAST = 1e-16
_ZERO = 2e-16
"""Where a part that is zero is drawn on the logarithmic axis, labelled 0."""


def budget_figure(budgets: Sequence[ErrorBudget]) -> blocks.Figure:
    """Return the worst budget as a linear waterfall, and every part of all, logarithmic."""
    worst = _worst(budgets)
    at = worst.at_worst
    shares = ", ".join(
        f"{words} {in_words(getattr(at, key))}" for key, (words, _, _) in SOURCES.items()
    )
    most = max(budget.residual_share for budget in budgets)
    return blocks.Figure(
        name="report-budget",
        title="What the difference consists of",
        caption=f"Left: the run as deployed that is farthest from the ideal ODE ({_name(worst)}), "
        f"in the state and at the instant where it is farthest, {SYMBOLS[at.state]} at "
        f"t = {at.time:g} s: there the signed parts add up to the total. Right: the largest value "
        "of any state at any instant [m, rad, m/s, rad/s] of the total and of each part alone, in "
        "every run; they belong to different instants and need not add up.",
        alt=f"Waterfall of {_name(worst)} in {STATE_UNITS[at.state]}: {shares}; total "
        f"{in_words(at.total)}. Beside it a row of dots for each of {len(budgets)} runs; what "
        f"is not explained is at most {100 * most:.2g} % of a run's total.",
        draw=partial(_draw, budgets),
    )


def _draw(budgets: Sequence[ErrorBudget]) -> Figure:
    """Draw the waterfall beside the dots."""
    figure = new_figure(11.0, max(4.0, 1.9 + 0.235 * len(budgets)))
    falls, dots = figure.subplots(1, 2, width_ratios=(1.0, 1.25))
    _draw_waterfall(falls, _worst(budgets))
    _draw_dots(dots, budgets)
    handles, labels = dots.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    return figure


def _worst(budgets: Sequence[ErrorBudget]) -> ErrorBudget:
    """Return the budget of the largest difference."""
    return max(budgets, key=lambda budget: abs(budget.at_worst.total))


def _name(budget: ErrorBudget) -> str:
    """Return the scenario and controller of a budget."""
    return f"{budget.scenario}, {budget.controller}"


def _draw_waterfall(axis: Axes, budget: ErrorBudget) -> None:
    """Draw the signed parts one after another, and the total that they reach."""
    at = budget.at_worst
    heights = [getattr(at, key) for key in SOURCES]
    bottoms = np.concatenate([[0.0], np.cumsum(heights)])
    names = [words for words, _, _ in SOURCES.values()]
    colours = [colour for _, colour, _ in SOURCES.values()]
    rows = np.arange(len(names))
    axis.barh(rows, heights, left=bottoms[:-1], color=colours, height=0.62)
    axis.barh(len(names), at.total, color=_TOTAL[1], height=0.62)
    for row, value in enumerate([*heights, at.total]):
        end = bottoms[row + 1] if row < len(names) else at.total
        axis.plot([end, end], [row, row + 1.0 * (row < len(names))], color=GREY, linewidth=0.7)
        axis.annotate(
            in_words(value), (0.5 * at.total, row), ha="center", va="center", fontsize=8.0,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.5, "alpha": 0.9},
        )  # fmt: skip
    low, high = min(0.0, *bottoms), max(0.0, *bottoms)
    axis.set_xlim(low - 0.06 * (high - low) * (low < 0.0), high + 0.06 * (high - low))
    axis.set_yticks([*rows, len(names)], [*names, "total"])
    axis.invert_yaxis()
    axis.grid(axis="y", visible=False)
    axis.set_xlabel(f"MuJoCo as deployed - ODE, {SYMBOLS[at.state]} [{STATE_UNITS[at.state]}]")
    axis.set_title(f"{_name(budget)}, t = {at.time:g} s")


def _draw_dots(axis: Axes, budgets: Sequence[ErrorBudget]) -> None:
    """Draw total and parts of every run."""
    rows = np.arange(len(budgets))
    for key, (words, colour, marker) in {"total": _TOTAL, **SOURCES}.items():
        values = np.array([getattr(budget, key) for budget in budgets])
        axis.plot(
            np.maximum(values, _ZERO), rows, marker, color=colour, label=words,
            markersize=_SIZES.get(key, 5.0), markeredgewidth=1.2, linestyle="none",
            markerfacecolor="none" if key == "disturbance_timing" else colour,
        )  # fmt: skip
    axis.set_xscale("log")
    most = max(1.0, decade_above(max(budget.total for budget in budgets) or 1.0))
    axis.set_xlim(_LEAST, most)
    powers = list(range(-14, round(np.log10(most)) + 1, 2))
    ticks = [f"10{str(power).translate(SUPERSCRIPTS)}" for power in powers]
    axis.set_xticks([_ZERO, *(10.0**power for power in powers)], ["0", *ticks])
    axis.minorticks_off()
    axis.set_yticks(rows, [_name(budget) for budget in budgets], fontsize=7.5)
    axis.set_ylim(len(budgets) - 0.4, -0.6)
    axis.set_xlabel("largest of any state at any instant [SI]")
    axis.set_title("every run")
