"""A Monte Carlo campaign as tables on the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from afl_mujoco.validation.montecarlo.campaign import Campaign
from afl_mujoco.validation.montecarlo.rates import CONFIDENCE, Rate
from afl_mujoco.validation.montecarlo.trial import ENDINGS, LAW_FAILED
from afl_mujoco.validation.montecarlo.worst_case import HARDEST, NEAREST, Found

QUESTIONS = {HARDEST: "hardest found", NEAREST: "nearest failure"}
SHOWN = 3
"""Coordinates that a line names."""


def print_montecarlo(
    campaign: Campaign, found: Sequence[Found], console: Console | None = None
) -> None:
    """Print the rates, the controllers compared, and what the searches found.

    Parameters
    ----------
    campaign
        The campaign.
    found
        From the searches; may be empty.
    console
        Where; the terminal by default.
    """
    console = console or Console()
    console.print(_rates(campaign))
    if len(campaign.trials) > 1:
        console.print(_pairs(campaign))
    if found:
        console.print(_worst(found))
    for name in campaign.trials:
        failed = [i for i in campaign.failures(name) if campaign.trials[name][i].message]
        for i in failed[:1]:
            said = campaign.trials[name][i].message
            console.print(escape(f"{name}: {LAW_FAILED} on sample {i}: {said}"))


def _rates(campaign: Campaign) -> Table:
    """Return how often each controller stayed up and settled."""
    level = f"{100 * CONFIDENCE:g} %"
    table = Table(box=SIMPLE_HEAD, title=f"{campaign.samples} rigs, seed {campaign.seed}")
    table.add_column("controller")
    for title in ("stays up", level, "settles", level, *ENDINGS[1:], "median travel"):
        table.add_column(escape(title), justify="right")
    for name, trials in campaign.trials.items():
        endings = [trial.outcome for trial in trials]
        counts = [str(endings.count(ending)) for ending in ENDINGS[1:]]
        rates = (*_cells(campaign.survival(name)), *_cells(campaign.settling(name)))
        travel = campaign.travel(name)
        far = "–" if travel is None else f"{travel[0]:.2f} m"
        table.add_row(escape(name), *rates, *counts, far)
    return table


def _cells(rate: Rate) -> tuple[str, str]:
    """Return a rate and its interval as text."""
    low, high = rate.interval
    return f"{100 * rate.share:.1f} %", f"{100 * low:.1f} to {100 * high:.1f}"


def _pairs(campaign: Campaign) -> Table:
    """Return who survived what the other did not."""
    table = Table(box=SIMPLE_HEAD, title="stay up on the same rigs")
    for title in ("first", "second", "both", "only first", "only second", "neither", "McNemar p"):
        table.add_column(title, justify="left" if title in ("first", "second") else "right")
    for (a, b), p in campaign.pairings().items():
        counts = (str(n) for n in (p.both, p.only_first, p.only_second, p.neither))
        table.add_row(escape(a), escape(b), *counts, f"{p.p_value:.2g}")
    return table


def _worst(found: Sequence[Found]) -> Table:
    """Return what the searches found."""
    table = Table(box=SIMPLE_HEAD, title="worst cases by CMA-ES")
    for title in ("controller", "question", "ends", "distance", "runs", "farthest from nominal"):
        table.add_column(title, justify="right" if title in ("distance", "runs") else "left")
    for one in found:
        ended = one.trial.outcome
        if ended != LAW_FAILED:
            ended += f" at {one.trial.end_time:.2f} s"
        far = ", ".join(f"{name} {x:+.2f}" for name, x in islice(one.changes.items(), SHOWN))
        table.add_row(
            escape(one.controller), QUESTIONS[one.question], ended, f"{one.distance:.2f}",
            str(one.runs), escape(far),
        )  # fmt: skip
    return table
