"""A survey of margins as a table on the terminal: the worst of each over the plants."""

from __future__ import annotations

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from afl_mujoco.validation.margins.survey import Survey, Worst

COLUMNS = (
    ("gain down to", "gain_decrease", "{:.2f}", 1.0),
    ("gain up to", "gain_increase", "{:.1f}", 1.0),
    ("phase [deg]", "phase", "{:.1f}", 1.0),
    ("disk", "disk", "{:.2f}", 1.0),
    ("delay [ms]", "delay", "{:.2f}", 1e3),
)
"""Title, margin, format and factor of each column."""


def print_margins(survey: Survey, console: Console | None = None) -> None:
    """Print the worst of every margin of every law, and where the delay margin is least.

    Parameters
    ----------
    survey
        The margins.
    console
        Where; the terminal by default.
    """
    period = f"{1e3 * survey.control_period:g} ms"
    table = Table(box=SIMPLE_HEAD, title=f"least margins over {_plants(survey)} plants")
    for title in ("controller", "force", "unstable"):
        table.add_column(title, justify="left" if title != "unstable" else "right")
    for title, *_ in COLUMNS:
        table.add_column(escape(title), justify="right")
    table.add_column("at M, l")
    for name in survey.controllers:
        for sampled in (False, True):
            table.add_row(*_row(survey, name, sampled, period))
    (console or Console()).print(table)


def _plants(survey: Survey) -> int:
    """Return how many plants there are."""
    return len(survey.cart_masses) * len(survey.half_lengths)


def _row(survey: Survey, name: str, sampled: bool, period: str) -> list[str]:
    """Return the row of one law, continuous or held."""
    unstable = int(np.isnan(survey.values(name, "disk", sampled=sampled)).sum())
    cells = [
        _cell(survey.worst(name, metric, sampled=sampled), form, factor)
        for _, metric, form, factor in COLUMNS
    ]
    least = survey.worst(name, "delay", sampled=sampled)
    where = "" if least is None else f"{least.cart_mass:g} kg, {least.half_length:g} m"
    return ["" if sampled else name, f"held {period}" if sampled else "continuous",
            str(unstable), *cells, where]  # fmt: skip


def _cell(worst: Worst | None, form: str, factor: float) -> str:
    """Return a margin as text."""
    if worst is None:
        return "–"
    return form.format(factor * worst.value) if np.isfinite(worst.value) else "∞"
