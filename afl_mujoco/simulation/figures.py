"""Figure of one run."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from afl_mujoco.plants.plant import Floats
from afl_mujoco.report.style import SKY, TIME, new_figure, styled
from afl_mujoco.scenario.parameters import labelled
from afl_mujoco.simulation.trajectory import Trajectory


@styled()
def draw_run(run: Trajectory, title: str) -> Figure:
    """Draw states, inputs, signals and parameters over time."""
    shown = _panels(run)
    rows = -(-len(shown) // 2)
    figure = new_figure(11.0, 2.5 * rows)
    axes = figure.subplots(rows, 2, sharex=True, squeeze=False).ravel()
    for axis, (label, curve, pale) in zip(axes, shown, strict=False):
        axis.plot(run.time, curve, label=run.simulator, color=SKY, linewidth=2.6)
        if pale is not None:
            axis.plot(run.time, pale, color=SKY, linewidth=0.6, alpha=0.5)
        axis.set_ylabel(label)
    for axis in axes:
        axis.margins(x=0.01)
    for axis in axes[-2:]:
        axis.set_xlabel(TIME)
    axes[0].legend()
    for axis in axes[len(shown) :]:
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
