"""Figure of one run, or of two runs overlaid."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from afl_mujoco.report.style import BLACK, LENGTH, MASS, SKY, TIME, new_figure, styled
from afl_mujoco.simulation.trajectory import Trajectory

_STATE_PANELS = (
    ("cart position z [m]", 0),
    ("cart velocity z′ [m/s]", 2),
    ("pole angle φ [rad]", 1),
    ("pole rate φ′ [rad/s]", 3),
)
_INPUT_LABELS = ("force F [N] (thin: command)", MASS, LENGTH)
_STYLES: tuple[dict[str, Any], ...] = (
    {"color": SKY, "linewidth": 2.6},
    {"color": BLACK, "linewidth": 0.9, "linestyle": (0.0, (4.0, 3.0))},
)


@styled()
def draw_runs(runs: Sequence[Trajectory], title: str) -> Figure:
    """Draw z, z', phi, phi', F, M and l over time, and the difference of two runs."""
    figure = new_figure(11.0, 10.0)
    axes = figure.subplots(4, 2, sharex=True).ravel()
    for run, style in zip(runs, _STYLES, strict=False):
        curves = [run.state[:, column] for _, column in _STATE_PANELS]
        curves += [run.force, run.cart_mass, run.half_length]
        for axis, curve in zip(axes, curves, strict=False):
            axis.plot(run.time, curve, label=run.simulator, **style)
        if not np.array_equal(run.command, run.force):
            axes[4].plot(run.time, run.command, **style | {"linewidth": 0.6, "alpha": 0.5})
    labels = [label for label, _ in _STATE_PANELS] + list(_INPUT_LABELS)
    for axis, label in zip(axes, labels, strict=False):
        axis.set_ylabel(label)
    for axis in axes[5:7]:
        axis.set_ylim(bottom=0.0)
    for axis in axes:
        axis.margins(x=0.01)
    for axis in axes[6:]:
        axis.set_xlabel(TIME)
    axes[0].legend()
    if len(runs) > 1:
        _draw_difference(axes[7], runs[0], runs[1])
    else:
        axes[7].axis("off")
        axes[5].tick_params(labelbottom=True)
        axes[5].set_xlabel(TIME)
    figure.suptitle(title)
    return figure


def _draw_difference(axis: Axes, one: Trajectory, other: Trajectory) -> None:
    """Draw the difference of two runs at the instants that both report."""
    time, here, there = np.intersect1d(one.time, other.time, return_indices=True)
    difference = np.abs(one.state[here] - other.state[there])
    for label, column in _STATE_PANELS:
        symbol = label.split()[-2]
        axis.semilogy(time, difference[:, column], lw=0.9, label=symbol)
    axis.set_ylim(bottom=max(1e-17, axis.get_ylim()[0]))
    axis.set_ylabel("|difference| [SI]")
    axis.legend(ncols=4, fontsize="small")
