"""Figures of a run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from afl_mujoco.output import atomic_file
from afl_mujoco.simulation.trajectory import Trajectory

_STATE_PANELS = (
    ("cart position z [m]", 0),
    ("cart velocity z′ [m/s]", 2),
    ("pole angle φ [rad]", 1),
    ("pole rate φ′ [rad/s]", 3),
)
_INPUT_LABELS = ("force F [N]", "cart mass M [kg]", "half-length l [m]")
_STYLES: tuple[dict[str, Any], ...] = ({"lw": 2.4, "alpha": 0.45}, {"lw": 1.1, "ls": "--"})


def draw_runs(runs: Sequence[Trajectory], title: str) -> Figure:
    """Draw z, z', phi, phi', F, M and l over time, and how far two runs are apart.

    Parameters
    ----------
    runs
        One run, or two of the same scenario, which are overlaid.
    title
        Above the figure.
    """
    figure = Figure(figsize=(11.0, 10.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(4, 2, sharex=True).ravel()
    for run, style in zip(runs, _STYLES, strict=False):
        curves = [run.state[:, column] for _, column in _STATE_PANELS]
        curves += [run.force, run.cart_mass, run.half_length]
        for axis, curve in zip(axes, curves, strict=False):
            axis.plot(run.time, curve, label=run.simulator, **style)
    labels = [label for label, _ in _STATE_PANELS] + list(_INPUT_LABELS)
    for axis, label in zip(axes, labels, strict=False):
        axis.set_ylabel(label)
    for axis in axes[5:7]:
        axis.set_ylim(bottom=0.0)
    for axis in axes:
        axis.grid(alpha=0.3)
        axis.margins(x=0.01)
    for axis in axes[6:]:
        axis.set_xlabel("time t [s]")
    axes[0].legend(frameon=False)
    if len(runs) > 1:
        _draw_difference(axes[7], runs[0], runs[1])
    else:
        axes[7].axis("off")
        axes[5].tick_params(labelbottom=True)
        axes[5].set_xlabel("time t [s]")
    figure.suptitle(title)
    return figure


def _draw_difference(axis: Axes, one: Trajectory, other: Trajectory) -> None:
    """Draw how far two runs are apart, at the instants that both report."""
    time, here, there = np.intersect1d(one.time, other.time, return_indices=True)
    difference = np.abs(one.state[here] - other.state[there])
    for label, column in _STATE_PANELS:
        symbol = label.split()[-2]
        axis.semilogy(time, difference[:, column], lw=0.9, label=symbol)
    axis.set_ylim(bottom=max(1e-17, axis.get_ylim()[0]))
    axis.set_ylabel("|difference| [SI]")
    axis.legend(ncols=4, frameon=False, fontsize="small")


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, whole or not at all.

    Parameters
    ----------
    figure
        What to write.
    path
        The file.
    """
    with atomic_file(path) as temporary:
        figure.savefig(temporary, dpi=110, format="png")
