"""How M and l change in each scenario: the analogue of the paper's Fig. 6."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from matplotlib.figure import Figure

from afl_mujoco.report import old as blocks
from afl_mujoco.report.style import BLUE, LENGTH, MASS, TIME, VERMILION, new_figure
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.schedules import Schedule

TAIL = 2.0
"""Time for which a schedule is drawn after its last change [s]."""


def schedules_figure(scenarios: Sequence[Scenario]) -> blocks.Figure:
    """Return M and l over time, a column for each scenario."""
    until = _until(scenarios)
    return blocks.Figure(
        name="report-schedules",
        title="How the plant changes",
        caption="Analogue of the paper's Fig. 6: cart mass M and half-length l over time. The "
        "text of the paper gives no times and values; these are ours (decision D3).",
        alt=f"{2 * len(scenarios)} panels over the first {until:g} s. "
        + " ".join(f"{scenario.name}: {_in_words(scenario)}." for scenario in scenarios),
        draw=partial(_draw, scenarios),
    )


def _draw(scenarios: Sequence[Scenario]) -> Figure:
    """Draw the columns."""
    figure = new_figure(2.6 * len(scenarios) + 0.6, 3.9)
    axes = figure.subplots(2, len(scenarios), sharex=True, sharey="row", squeeze=False)
    until = _until(scenarios)
    for column, scenario in zip(axes.T, scenarios, strict=True):
        column[0].plot(*_line(scenario.cart_mass, until), color=VERMILION)
        column[1].plot(*_line(scenario.half_length, until), color=BLUE)
        column[0].set_title(scenario.name)
        column[1].set(xlabel=TIME, xlim=(0.0, until))
        for axis in column:
            axis.set_ylim(bottom=0.0)
            axis.margins(y=0.08)
            axis.tick_params(labelleft=True)
    axes[0, 0].set_ylabel(MASS)
    axes[1, 0].set_ylabel(LENGTH)
    return figure


def _line(schedule: Schedule, until: float) -> tuple[list[float], list[float]]:
    """Return the corners of a schedule from 0 to an end [s]."""
    inner = [(t, v) for t, v in zip(schedule.times, schedule.values, strict=True) if 0 < t < until]
    corners = [(0.0, schedule.at(0.0)), *inner, (until, schedule.before(until))]
    return [t for t, _ in corners], [v for _, v in corners]


def _until(scenarios: Sequence[Scenario]) -> float:
    """Return how long schedules are drawn [s]."""
    last = max(max((*s.cart_mass.breakpoints, *s.half_length.breakpoints, 0.0)) for s in scenarios)
    return min(last + TAIL, max(s.duration for s in scenarios))


def _in_words(scenario: Scenario) -> str:
    """Say between which values M and l change."""
    said = []
    parameters = (("M", "kg", scenario.cart_mass), ("l", "m", scenario.half_length))
    for name, unit, schedule in parameters:
        values = np.asarray(schedule.values)
        first, last, low, high = values[0], values[-1], values.min(), values.max()
        back = first == last and low != high
        far = f"from {first:g} to {high if back else last:g} {unit}{' and back' * bool(back)}"
        said.append(f"{name} stays {first:g} {unit}" if low == high else f"{name} {far}")
    return ", ".join(said)
