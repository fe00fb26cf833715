"""Figures of a run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

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
_STYLES = ({"lw": 2.4, "alpha": 0.45}, {"lw": 1.1, "ls": "--"}, {"lw": 1.0, "ls": ":"})


def draw_runs(runs: Sequence[Trajectory], title: str) -> Figure:
    """Draw z, z', phi, phi', F, M and l over time, the runs overlaid.

    Parameters
    ----------
    runs
        One run, or several of the same scenario.
    title
        Above the figure.
    """
    figure = Figure(figsize=(11.0, 10.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(4, 2, sharex=True).ravel()
    for run, style in zip(runs, _STYLES, strict=False):
        for axis, (label, column) in zip(axes, _STATE_PANELS, strict=False):
            axis.plot(run.time, run.state[:, column], label=run.simulator, **style)
            axis.set_ylabel(label)
        axes[4].plot(run.time, run.force, label=run.simulator, **style)
        axes[5].plot(run.time, run.cart_mass, **style)
        axes[6].plot(run.time, run.half_length, **style)
    for axis, label in zip(
        axes[4:7], ("force F [N]", "cart mass M [kg]", "half-length l [m]"), strict=True
    ):
        axis.set_ylabel(label)
    for axis in axes[:7]:
        axis.grid(alpha=0.3)
        axis.margins(x=0.01)
        axis.tick_params(labelbottom=axis in axes[5:7])
    for axis in axes[5:7]:
        axis.set_xlabel("time t [s]")
        axis.set_ylim(bottom=0.0)
    handles, labels = axes[0].get_legend_handles_labels()
    axes[7].axis("off")
    axes[7].legend(handles, labels, loc="center", frameon=False, fontsize="large")
    figure.suptitle(title)
    return figure


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
