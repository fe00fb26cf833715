"""The claims ledger at a glance: the paper's numbers beside those found here, and the verdicts."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from functools import partial

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from afl_mujoco.report import old as blocks
from afl_mujoco.report.style import (
    BLACK,
    BLUE,
    GREY,
    ORANGE,
    VERMILION,
    in_words,
    new_figure,
)
from afl_mujoco.studies.verification.claims.claim import (
    EVERY,
    FITTED,
    IN_PART,
    NONE,
    NOT_REPRODUCED,
    RANDOM,
    REPRODUCED,
    UNDETERMINED,
    Claim,
    kind,
)

VERDICTS: Mapping[str, tuple[str, str]] = {
    REPRODUCED: ("o", BLUE),
    EVERY: ("P", BLUE),
    IN_PART: ("D", ORANGE),
    RANDOM: ("^", ORANGE),
    FITTED: ("^", ORANGE),
    NOT_REPRODUCED: ("X", VERMILION),
    NONE: ("v", VERMILION),
    UNDETERMINED: ("$?$", GREY),
}
"""Marker and colour of each verdict."""

PERCENT = " [%]"
"""Ending of the quantity of a claim that is drawn on the axis; the others are written."""

_LONGEST = 88
"""Largest number of characters in a line."""


def claims_figure(claims: Sequence[Claim], interval: Sequence[float] | None) -> blocks.Figure:
    """Return a row for each claim: verdict, words, and the two numbers.

    Parameters
    ----------
    interval
        95 % confidence interval of the share in C9, if known.
    """
    counts = {verdict: [c.id for c in claims if kind(c.verdict) == verdict] for verdict in VERDICTS}
    said = "; ".join(f"{verdict}: {', '.join(ids)}" for verdict, ids in counts.items() if ids)
    return blocks.Figure(
        name="report-claims",
        title="Verdicts on the paper's claims",
        caption="Each claim of the paper with its verdict, the paper's number (open) and the one "
        "found here (filled), and the 95 % confidence interval of the share in C9. The "
        "improvements of C3 to C6 are those of the paper's Table 3, and those found here rest on "
        "the schedules of D3 and the scales of D4.",
        alt=f"{said}. " + " ".join(map(_in_words, claims)),
        draw=partial(_draw, claims, interval),
    )


def _draw(claims: Sequence[Claim], interval: Sequence[float] | None) -> Figure:
    """Draw the rows."""
    figure = new_figure(11.0, 0.47 * len(claims) + 1.4)
    words, numbers = figure.subplots(1, 2, width_ratios=(1.15, 1.0), sharey=True)
    for row, claim in enumerate(claims):
        _draw_words(words, row, claim)
        if claim.figure.endswith(PERCENT):
            _draw_numbers(numbers, row, claim, interval if claim.id == "C9" else None)
        else:
            _write_numbers(numbers, row, claim)
    words.set(xlim=(0.0, 1.0), ylim=(len(claims) - 0.5, -0.5))
    words.axis("off")
    numbers.set(
        xlim=_span(claims),
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
    marker, colour = VERDICTS[kind(claim.verdict)]
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
    _, colour = VERDICTS[kind(claim.verdict)]
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


def _span(claims: Sequence[Claim]) -> tuple[float, float]:
    """Return the ends of the axis [%]: 0, 100 and every number lie inside."""
    counted = [claim for claim in claims if claim.figure.endswith(PERCENT)]
    found = [value for claim in counted for value in (claim.paper, claim.here)]
    known = [0.0, 100.0, *(value for value in found if value is not None)]
    margin = 0.12 * (max(known) - min(known))
    return min(known) - margin, max(known) + margin


def _write_value(axis: Axes, row: int, value: float) -> None:
    """Write a number above its mark."""
    axis.annotate(
        f"{value:.1f}".replace("-", "−"), (value, row), xytext=(0.0, 6.0), ha="center",
        textcoords="offset points", fontsize=7.5, zorder=2.2,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6},
    )  # fmt: skip


def _write_numbers(axis: Axes, row: int, claim: Claim) -> None:
    """Write the two numbers of a claim that is not counted in percent."""
    white = {"facecolor": "white", "edgecolor": "none", "pad": 1.5}
    axis.text(50.0, row, _numbers(claim), va="center", ha="center", fontsize=8.5, bbox=white)


def _numbers(claim: Claim) -> str:
    """Return the two numbers in words."""
    paper, here = ("–" if x is None else in_words(x) for x in (claim.paper, claim.here))
    return f"paper {paper}, here {here}"


def _in_words(claim: Claim) -> str:
    """Say the numbers of a claim."""
    return f"{claim.id} ({claim.figure}): {_numbers(claim)}."


def _draw_legend(figure: Figure, claims: Sequence[Claim]) -> None:
    """Draw the legend below the figure."""
    handles = {
        verdict: Line2D([], [], marker=marker, color=colour, linestyle="none", markersize=8.0)
        for verdict, (marker, colour) in VERDICTS.items()
        if any(kind(claim.verdict) == verdict for claim in claims)
    }
    handles["paper"] = Line2D(
        [], [], marker="o", color=BLACK, markerfacecolor="white", linestyle="none", markersize=8.0
    )
    handles["here (colour of the verdict)"] = Line2D(
        [], [], marker="o", color=BLACK, linestyle="none", markersize=6.0
    )
    figure.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=4)
