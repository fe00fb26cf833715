"""Figure of one run, or of two runs overlaid."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from afl_mujoco.plants.plant import Floats
from afl_mujoco.report.style import BLACK, SKY, TIME, new_figure, styled
from afl_mujoco.scenario.parameters import labelled, symbol
from afl_mujoco.simulation.trajectory import Layout, Trajectory

_STYLES: tuple[dict[str, Any], ...] = (
    {"color": SKY, "linewidth": 2.6},
    {"color": BLACK, "linewidth": 0.9, "linestyle": (0.0, (4.0, 3.0))},
)


@styled()
def draw_runs(runs: Sequence[Trajectory], title: str) -> Figure:
    """Draw states, inputs, signals and parameters over time, and the difference of two runs."""
    layout, several = runs[0].layout, len(runs) > 1
    shown = _panels(runs[0])
    rows = -(-(len(shown) + several) // 2)
    figure = new_figure(11.0, 2.5 * rows)
    axes = figure.subplots(rows, 2, sharex=True, squeeze=False).ravel()
    for run, style in zip(runs, _STYLES, strict=False):
        for axis, (label, curve, pale) in zip(axes, _panels(run), strict=False):
            axis.plot(run.time, curve, label=run.simulator, **style)
            if pale is not None:
                axis.plot(run.time, pale, **style | {"linewidth": 0.6, "alpha": 0.5})
            axis.set_ylabel(label)
    for axis in axes:
        axis.margins(x=0.01)
    for axis in axes[-2:]:
        axis.set_xlabel(TIME)
    axes[0].legend()
    left = len(shown)
    if several:
        _draw_difference(axes[left], runs[0], runs[1], layout)
        left += 1
    for axis in axes[left:]:
        axis.axis("off")
        axes[-3].tick_params(labelbottom=True)
        axes[-3].set_xlabel(TIME)
    figure.suptitle(title)
    return figure


_Panel = tuple[str, Floats, Floats | None]


def _panels(run: Trajectory) -> list[_Panel]:
    """Return label, curve and a pale curve of each panel: each coordinate beside its rate."""
    layout, n = run.layout, len(run.layout.coordinates)
    found: list[_Panel] = []

    def label(name: str) -> str:
        return labelled(name, layout.units.get(name, ""))

    for i, name in enumerate(layout.coordinates):
        for column, state in ((i, name), (n + i, f"{name}_dot")):
            found.append((label(state), run.state[:, column], None))
    for name, force, command in zip(layout.inputs, run.inputs.T, run.commands.T, strict=True):
        differs = bool((force != command).any())
        told = label(name) + " (thin: command)" * differs
        found.append((told, force, command if differs else None))
    found += [(name, values, None) for name, values in run.signals.items()]
    return [*found, *((label(name), x, None) for name, x in run.parameters.items() if np.ptp(x))]


def _draw_difference(axis: Axes, one: Trajectory, other: Trajectory, layout: Layout) -> None:
    """Draw the difference of two runs at the instants that both report."""
    time, here, there = np.intersect1d(one.time, other.time, return_indices=True)
    difference = np.abs(one.state[here] - other.state[there])
    for column, name in enumerate(layout.states):
        axis.semilogy(time, difference[:, column], lw=0.9, label=symbol(name))
    axis.set_ylim(bottom=max(1e-17, axis.get_ylim()[0]))
    axis.set_ylabel("|difference| [SI]")
    axis.legend(ncols=4, fontsize="small")
