"""It in words."""

from __future__ import annotations

from functools import partial

from afl_mujoco.studies.dice.result import Result
from matplotlib.figure import Figure as Drawing

from afl_mujoco.report.old import Cell, Column, Figure, Finding, Section, Table, Text
from afl_mujoco.report.style import new_figure


def sections(result: Result) -> list[Section]:
    """Return what a report says of the dice."""
    mean = sum(throw.eyes for throw in result.throws) / len(result.throws)
    table = Table(
        caption="Every throw",
        columns=(Column("Throw"), Column("Eyes", number=True)),
        rows=[
            (str(t.number), Cell(str(t.eyes), "good" if t.eyes == 6 else "")) for t in result.throws
        ],
    )
    figure = Figure(
        name="dice",
        title="Eyes",
        caption="Eyes by throw.",
        alt=f"{len(result.throws)} throws.",
        draw=partial(_draw, result),
    )
    finding = Finding("The dice", f"The mean is {mean:.2f}.")
    return [Section("Dice", "dice", (finding, Text("*Fair* dice."), table, figure))]


def _draw(result: Result) -> Drawing:
    figure = new_figure(3.0, 2.0)
    figure.subplots().plot(result.all_eyes)
    return figure
