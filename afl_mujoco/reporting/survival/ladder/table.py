"""The ladder as a table on the terminal: from where each controller no longer survives."""

from __future__ import annotations

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from afl_mujoco.reporting.survival.ladder.words import (
    FAILS,
    LITTLE,
    Row,
    class_of,
    level_text,
    rise_of,
    settles_at_typical,
    threshold_text,
)

STYLES = {FAILS: "bold red", LITTLE: "yellow"}
UNSETTLED = "~"


def print_ladder(ladder: Row, console: Console | None = None) -> None:
    """Print one row for each rung, one column for each controller.

    Parameters
    ----------
    ladder
        What a ladder.json holds.
    console
        Where; the terminal by default.
    """
    scenarios = ", ".join(ladder["settings"]["scenarios"])
    table = Table(
        box=SIMPLE_HEAD,
        title=f"from where the controller no longer survives {scenarios}",
        caption=f"{UNSETTLED} does not settle on a typical rig; red: does not survive it",
    )
    table.add_column("rung")
    table.add_column("typical rig", justify="right")
    for name in ladder["controllers"]:
        table.add_column(name, justify="right")
    for rung in ladder["rungs"]:
        typical = f"{level_text(rung, rung['typical'])} {rung['unit']}"
        cells = [_cell(rung, rise_of(ladder, rung["name"], c)) for c in ladder["controllers"]]
        table.add_row(escape(rung["title"]), typical, *cells)
    (console or Console()).print(table)


def _cell(rung: Row, rise: Row) -> str:
    """Return a threshold, coloured by what a typical rig makes of it."""
    kind = class_of(rung, rise)
    text = threshold_text(rung, rise["survives"])
    if kind != FAILS and not settles_at_typical(rise):
        text = f"{UNSETTLED} {text}"
    return f"[{STYLES[kind]}]{text}[/]" if kind in STYLES else text
