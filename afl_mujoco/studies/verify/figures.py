"""The figures of a verification: runs over time, the error budget, the paper's claims."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from afl_mujoco.plants.plant import Plant
from afl_mujoco.report.figures import Panel, curves
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
from afl_mujoco.scenario.parameters import labelled, symbol
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.remarks import SAID
from afl_mujoco.studies.cases import DEPLOYED
from afl_mujoco.studies.verify.claims import GROUPS, Claim, Comparison, kind
from afl_mujoco.studies.verify.curves import REFERENCE, Curves
from afl_mujoco.studies.verify.explanation import SOURCES, ErrorBudget

PARTS: Mapping[str, tuple[str, str, str]] = {
    **{
        name: (SOURCES[name], colour, marker)
        for name, colour, marker in (
            ("control_hold", VERMILION, "s"),
            ("schedule_sampling", ORANGE, "^"),
            ("disturbance_timing", PURPLE, "v"),
            ("integrator", BLUE, "D"),
            ("model_form", GREEN, "o"),
        )
    },
    "residual": ("not explained", "#404040", "x"),
}
"""Words, colour and marker of each part of the total, in the order of the steps."""

_ZERO = 2e-16
"""Where a part that is zero is drawn on the logarithmic axis, labelled 0."""

MARKS = {
    "good": ("o", BLUE),
    "neutral": ("^", ORANGE),
    "bad": ("X", VERMILION),
    "open": ("s", GREY),
}
"""Marker and colour of the status of a verdict."""

PERCENT = " [%]"
"""Ending of the quantity of a claim that is drawn on the axis; the others are written."""

_LONGEST = 88
"""Largest number of characters in a line."""


def draw_runs(scenario: Scenario, runs: Sequence[Curves]) -> Figure:
    """Draw coordinates and inputs under each controller as deployed, the ODE dashed over them.

    Below them what changes of the plant.
    """
    plant, first = scenario.plant, runs[0]
    signals = [*plant.coordinates, *plant.inputs]
    panels = [
        Panel(
            label=_label(scenario, name),
            curves={one.controller: _signal(plant, one, DEPLOYED, name) for one in runs},
            over={one.controller: _signal(plant, one, REFERENCE, name) for one in runs},
        )
        for name in signals
    ]
    changes = {_label(scenario, name): (first.time, x) for name, x in first.parameters.items()}
    pushes = [(min(d.breakpoints), max(d.breakpoints)) for d in scenario.disturbances]
    panels += [Panel(label="plant", curves=changes, black=True)] if changes else []
    return curves(panels, scenario.duration, shaded=pushes)


PAPERS = {**SAID, "force": "F"}
"""What the paper calls them."""


def _label(scenario: Scenario, name: str) -> str:
    """Return a name and its unit."""
    own = PAPERS.get(name, name) if scenario.is_cart_pole else name
    return labelled(own, scenario.plant.units[name])


def _signal(plant: Plant, one: Curves, run: str, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the instants [s] and values of a state or an input in a simulator."""
    if name in plant.inputs:
        every = one.forces[run].reshape(len(one.forces[run]), -1)
        values = every[:, [*plant.inputs].index(name)]
    else:
        values = one.states[run][:, plant.states.index(name)]
    return one.time[: len(values)], values


# --- the error budget ---------------------------------------------------------------------------


def draw_budget(budgets: Sequence[ErrorBudget]) -> Figure:
    """Draw the worst budget as a waterfall, and beside it total and parts of every run."""
    figure = new_figure(11.0, max(4.0, 1.9 + 0.2 * len(budgets)))
    falls, dots = figure.subplots(1, 2, width_ratios=(1.0, 1.25))
    _draw_waterfall(falls, worst_budget(budgets))
    _draw_parts(dots, budgets)
    handles, labels = dots.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    return figure


def worst_budget(budgets: Sequence[ErrorBudget]) -> ErrorBudget:
    """Return the budget of the largest difference."""
    return max(budgets, key=lambda budget: abs(budget.at_worst.total))


def _name(budget: ErrorBudget) -> str:
    """Return the scenario and controller of a budget."""
    return f"{budget.scenario}, {budget.controller}"


def _draw_waterfall(axis: Axes, budget: ErrorBudget) -> None:
    """Draw the signed parts one after another, and the total that they reach."""
    at, rows = budget.at_worst, len(PARTS)
    heights = [getattr(at, key) for key in PARTS]
    bottoms = np.concatenate([[0.0], np.cumsum(heights)])
    shades = [colour for _, colour, _ in PARTS.values()]
    axis.barh(range(rows), heights, left=bottoms[:-1], color=shades, height=0.62)
    axis.barh(rows, at.total, color=BLACK, height=0.62)
    for row, value in enumerate([*heights, at.total]):
        axis.annotate(
            in_words(value), (0.5 * at.total, row), ha="center", va="center", fontsize=8.0,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.5, "alpha": 0.9},
        )  # fmt: skip
    for row, end in enumerate(bottoms[1:]):
        axis.plot([end, end], [row, row + 1], color=GREY, linewidth=0.7)
    axis.set_yticks(range(rows + 1), [*(words for words, _, _ in PARTS.values()), "total"])
    axis.invert_yaxis()
    axis.grid(axis="y", visible=False)
    axis.set_xlabel(f"MuJoCo as deployed - ODE, {symbol(at.state)} [{at.unit}]")
    axis.set_title(f"{_name(budget)}, t = {at.time:g} s")


def _draw_parts(axis: Axes, budgets: Sequence[ErrorBudget]) -> None:
    """Draw total and parts of every run."""
    rows = np.arange(len(budgets))
    for key, (words, colour, marker) in {"total": ("total", BLACK, "|"), **PARTS}.items():
        values = np.array([getattr(budget, key) for budget in budgets])
        axis.plot(
            np.maximum(values, _ZERO), rows, marker, color=colour, label=words, linestyle="none",
            markersize=10.0 if key == "total" else 5.5, markeredgewidth=1.2,
            markerfacecolor="none" if key == "disturbance_timing" else colour,
        )  # fmt: skip
    axis.set_xscale("log")
    most = max(1.0, decade_above(max(budget.total for budget in budgets) or 1.0))
    axis.set_xlim(0.5 * _ZERO, most)
    powers = list(range(-14, round(np.log10(most)) + 1, 2))
    ticks = [f"10{str(power).translate(SUPERSCRIPTS)}" for power in powers]
    axis.set_xticks([_ZERO, *(10.0**power for power in powers)], ["0", *ticks])
    axis.minorticks_off()
    axis.set_yticks(rows, [_name(budget) for budget in budgets], fontsize=7.5)
    axis.set_ylim(len(budgets) - 0.4, -0.6)
    axis.set_xlabel("largest of any state at any instant [SI]")
    axis.set_title("every run")


# --- the claims ---------------------------------------------------------------------------------


def draw_claims(claims: Sequence[Claim], schedules: Mapping[str, Comparison]) -> Figure:
    """Draw a row for each claim: verdict, words, and its two numbers; C9 with its interval."""
    interval = schedules["published"].interval if schedules else None
    figure = new_figure(11.0, 0.44 * len(claims) + 1.4)
    words, numbers = figure.subplots(1, 2, width_ratios=(1.15, 1.0), sharey=True)
    for row, claim in enumerate(claims):
        _draw_words(words, row, claim)
        if claim.figure.endswith(PERCENT):
            _draw_numbers(numbers, row, claim, interval if claim.id == "C9" else None)
        else:
            paper, here = ("–" if x is None else in_words(x) for x in (claim.paper, claim.here))
            numbers.text(
                50.0, row, f"paper {paper}, here {here}", va="center", ha="center", fontsize=8.5,
                bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.5},
            )  # fmt: skip
    words.set(xlim=(0.0, 1.0), ylim=(len(claims) - 0.5, -0.5))
    words.axis("off")
    found = [x for one in claims if one.figure.endswith(PERCENT) for x in (one.paper, one.here)]
    known = [0.0, 100.0, *(x for x in found if x is not None)]
    margin = 0.12 * (max(known) - min(known))
    numbers.set(
        xlim=(min(known) - margin, max(known) + margin),
        xlabel="the quantity named in grey, if it is in percent [%]",
    )
    numbers.axvline(0.0, color=GREY, linewidth=0.7, zorder=1.0)
    numbers.tick_params(axis="y", length=0.0, labelleft=False)
    numbers.spines["left"].set_visible(False)
    numbers.set_yticks([row - 0.5 for row in range(1, len(claims))])
    _draw_legend(figure, claims)
    return figure


def _draw_words(axis: Axes, row: int, claim: Claim) -> None:
    """Draw the verdict's mark, the claim's name, what it says, and what its numbers count."""
    marker, colour = MARKS[GROUPS[kind(claim.verdict)][0]]
    axis.plot(0.015, row, marker=marker, color=colour, markersize=9.0, clip_on=False)
    axis.text(0.045, row, claim.id, va="center", fontweight="bold")
    said, counted = (
        textwrap.shorten(text, _LONGEST, placeholder=" …") for text in (claim.claim, claim.figure)
    )
    axis.text(0.115, row - 0.02, said, va="bottom", fontsize=8.5)
    axis.text(0.115, row + 0.06, counted, va="top", fontsize=7.5, color=GREY)


def _draw_numbers(axis: Axes, row: int, claim: Claim, interval: Sequence[float] | None) -> None:
    """Draw the two numbers of a claim that is counted in percent."""
    paper, here = claim.paper, claim.here
    _, colour = MARKS[GROUPS[kind(claim.verdict)][0]]
    if paper is not None and here is not None:
        axis.plot([paper, here], [row, row], color=GREY, linewidth=1.0, zorder=2)
    if interval is not None:
        ends = [100.0 * end for end in interval]
        axis.plot(ends, [row, row], color=colour, linewidth=5.0, alpha=0.4, zorder=2.5)
    if paper is not None:
        axis.plot(paper, row, "o", color=BLACK, markerfacecolor="white", markersize=8.5, zorder=3.0)
        _write_value(axis, row, paper)
    if here is not None:
        axis.plot(here, row, "o", color=colour, markersize=5.5, zorder=3.1)
        if here != paper:
            _write_value(axis, row, here)


def _write_value(axis: Axes, row: int, value: float) -> None:
    """Write a number above its mark."""
    axis.annotate(
        f"{value:.1f}".replace("-", "−"), (value, row), xytext=(0.0, 6.0), ha="center",
        textcoords="offset points", fontsize=7.5, zorder=2.2,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6},
    )  # fmt: skip


def _draw_legend(figure: Figure, claims: Sequence[Claim]) -> None:
    """Draw the legend below the figure."""
    words_of: dict[str, list[str]] = {}
    for words in dict.fromkeys(kind(claim.verdict) for claim in claims):
        words_of.setdefault(GROUPS[words][0], []).append(words)
    handles = {}
    for status, said in words_of.items():
        marker, colour = MARKS[status]
        handles[" / ".join(said)] = Line2D(
            [], [], marker=marker, color=colour, linestyle="none", markersize=8.0
        )
    for words, face in (("paper", "white"), ("here (colour of the verdict)", BLACK)):
        handles[words] = Line2D(
            [], [], marker="o", color=BLACK, markerfacecolor=face, linestyle="none", markersize=7.0
        )
    figure.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=2)
