"""What a page opens with: the system, the controllers that were run on it, and what they needed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing
from matplotlib.patches import Arc, Circle, Rectangle
from numpy.typing import NDArray

from afl_mujoco.report.numbers import percent, short
from afl_mujoco.report.old import Block, Column, Figure, Table
from afl_mujoco.report.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    TIME,
    colours,
    new_figure,
    quietest_on_top,
)
from afl_mujoco.scenario.scenario import Scenario

MOST = 6
"""Largest number of controllers that are drawn."""

_PANELS = ("z [m]", "φ [rad]", "F [N]")


_NEEDED = ("peak_z", "max_command", "max_force")


class Shown(NamedTuple):
    """A run as it is drawn: instants [s], z [m], phi [rad] and the force [N], each shape (N,)."""

    time: NDArray[np.float64]
    z: NDArray[np.float64]
    phi: NDArray[np.float64]
    force: NDArray[np.float64]


class Need(NamedTuple):
    """What a run needed: its metrics, as in `simulation.metrics`, and how it ended."""

    scenario: str
    controller: str
    metrics: Mapping[str, float | None]
    outcome: str


def opening_blocks(
    name: str, scenario: Scenario, runs: Mapping[str, Shown], needs: Sequence[Need]
) -> list[Block]:
    """Return a picture of the system with the runs on it, and a table of what each run needed.

    Parameters
    ----------
    name
        Name of the figure's files.
    scenario
        The scenario that is drawn.
    runs
        Runs on that scenario, by controller; the first `MOST` are drawn.
    needs
        What each run needed, on any scenario.
    """
    drawn = dict(list(runs.items())[:MOST])
    blocks: list[Block] = []
    if drawn:
        left_out = len(runs) - len(drawn)
        pushed = " Grey: disturbances." if scenario.disturbances else ""
        more = f" The table below also has the other {left_out}." if left_out else ""
        blocks.append(
            Figure(
                name=name,
                title=f"The system, and the controllers on {scenario.name}",
                caption=(
                    f"Left: cart and pole at the start, to scale{_pale(scenario)}. Right: each run "
                    f"over time, as deployed in MuJoCo.{pushed}{more}"
                ),
                alt=f"{_plant(scenario)} Curves of {', '.join(drawn)}.",
                draw=partial(draw_opening, scenario, drawn),
            )
        )
    several = len({need.scenario for need in needs}) > 1
    blocks.append(
        Table(
            caption="What each run requires of the hardware",
            columns=(
                *([Column("Scenario")] if several else []),
                Column("Controller"),
                Column("Largest |z|", "m", number=True),
                Column("Largest command", "N", number=True),
                Column("Largest |F| exerted", "N", number=True),
                Column("Time at the force limit", "%", number=True),
                Column("Outcome"),
            ),
            rows=[
                (
                    *([need.scenario] if several else []),
                    need.controller,
                    *(short(need.metrics.get(key), 3) for key in _NEEDED),
                    percent(need.metrics.get("limited_share")),
                    need.outcome,
                )
                for need in needs
            ],
        )
    )
    return blocks


def draw_opening(scenario: Scenario, runs: Mapping[str, Shown]) -> Drawing:
    """Draw the system beside z, phi and F over time under each controller."""
    figure = new_figure(10.5, 4.6)
    grid = figure.add_gridspec(3, 2, width_ratios=(1.0, 1.35))
    _draw_system(figure.add_subplot(grid[:, 0]), scenario)
    colour, first = colours(runs), None
    order = quietest_on_top({name: run.force for name, run in runs.items()})
    for row, label in enumerate(_PANELS):
        axis = figure.add_subplot(grid[row, 1], sharex=first)
        first = first or axis
        for name, run in runs.items():
            axis.plot(
                run.time, run[row + 1], color=colour[name], label=name, linewidth=1.2,
                zorder=order[name],
            )  # fmt: skip
            if run.time[-1] < scenario.duration - 1e-9:
                axis.plot(run.time[-1], run[row + 1][-1], "x", color=colour[name], markersize=7)
        axis.set_ylabel(label)
        axis.set_xlim(0.0, scenario.duration)
        axis.tick_params(labelbottom=row == 2)
        for disturbance in scenario.disturbances:
            edges = disturbance.breakpoints
            axis.axvspan(min(edges), max(edges), color=GREY, alpha=0.3, linewidth=0.8)
    if first is not None:
        columns = min(len(runs), 3)
        first.legend(ncols=columns, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    axis.set_xlabel(TIME)
    return figure


def _draw_system(axis: Axes, scenario: Scenario) -> None:
    """Draw cart and pole at the start to scale, with their symbols."""
    z, phi = scenario.initial_state[:2]
    mass, length, pole_mass, _ = scenario.plants
    longest, now = 2.0 * length[1], 2.0 * scenario.half_length.at(0.0)
    unit = longest
    along = np.array([-math.sin(phi), math.cos(phi)])
    width, height = 0.32 * unit, 0.18 * unit
    axis.set_aspect("equal")
    axis.set_axis_off()
    axis.plot([z - 1.1 * unit, z + 1.1 * unit], [-height] * 2, color=GREY, linewidth=2.5, zorder=1)
    axis.add_patch(Rectangle((z - width / 2, -height), width, height, color=BLUE, zorder=2))
    pole: Any = {"solid_capstyle": "round", "zorder": 3}
    if _pale(scenario):
        axis.plot(*_from(z, along * longest), color=ORANGE, alpha=0.3, linewidth=5.0, **pole)
    axis.plot(*_from(z, along * now), color=ORANGE, linewidth=5.0, **pole)
    axis.add_patch(Circle((z, 0.0), 0.025 * unit, color=BLACK, zorder=4))
    axis.plot([z, z], [0.0, 1.05 * unit], color=GREY, linewidth=0.8, linestyle=(0, (4, 3)))
    if abs(phi) > 0.03:
        lean = math.degrees(phi)
        arc = (90.0, 90.0 + lean) if lean > 0.0 else (90.0 + lean, 90.0)
        size = 0.7 * unit
        axis.add_patch(Arc((z, 0.0), size, size, theta1=arc[0], theta2=arc[1], color=BLACK))
        at = 0.5 * phi if abs(phi) > 0.4 else -math.copysign(0.15, phi)  # else the pole is there
        middle = 0.42 * unit * np.array([-math.sin(at), math.cos(at)])
        axis.annotate("φ", (z + middle[0], middle[1]), ha="center", va="center", fontsize=12)
    arrow = {"arrowstyle": "-|>", "color": GREEN, "linewidth": 2.0, "shrinkA": 0.0, "shrinkB": 0.0}
    at = -0.5 * height
    right = z + 0.5 * width
    axis.annotate("", (right + 0.3 * unit, at), (right, at), arrowprops=arrow)
    axis.annotate("F, z", (right + 0.33 * unit, at), va="center", fontsize=12)
    poles = _span((2.0 * length[0], 2.0 * length[1]))
    said = f"cart M {_span(mass)} kg\npole m {short(pole_mass)} kg, 2 l {poles} m"
    below = (z, -height - 0.07 * unit)
    axis.annotate(said, below, ha="center", va="top", fontsize=11)
    axis.set_xlim(z - 1.15 * unit, z + 1.15 * unit)
    axis.set_ylim(-height - 0.4 * unit, 1.1 * unit)


def _pale(scenario: Scenario) -> str:
    """Say what the pale pole in the picture is, if there is one."""
    longest = scenario.plants.half_length[1]
    return " (pale: the longest pole)" if longest > 1.001 * scenario.half_length.at(0.0) else ""


def _from(z: float, tip: NDArray[np.float64]) -> tuple[list[float], list[float]]:
    """Return the ends of a pole from the pivot."""
    return [z, z + float(tip[0])], [0.0, float(tip[1])]


def _span(bounds: tuple[float, float]) -> str:
    """Return the range of a number, or its value if it is constant."""
    low, high = (short(x) for x in bounds)
    return low if low == high else f"{low} to {high}"


def _plant(scenario: Scenario) -> str:
    """Describe the system."""
    mass, length, pole_mass, _ = scenario.plants
    return (
        f"A cart of {_span(mass)} kg on a rail with a pole of {short(pole_mass)} kg, "
        f"half-length {_span(length)} m."
    )
