"""Controllers over time: states, force, and the plant under them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from afl_mujoco.document.style import BLACK, GREY, TIME, colours, new_figure, quietest_on_top
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.studies.compare.result import Curves

_PANELS = ("cart position z [m]", "pole angle φ [rad]", "force F [N]\n(pale: command)")
_LIMITS = ("max_position", "max_angle", "max_force")
_DASHED = (0.0, (6.0, 3.0))


def draw_responses(scenario: Scenario, curves: Mapping[str, Curves]) -> Figure:
    """Draw z, phi and F under each controller, their limits and bands, and M(t) and l(t)."""
    figure = new_figure(9.0, 8.4)
    axes = figure.subplots(4, 1, sharex=True, height_ratios=(3, 3, 3, 1.6))
    colour = colours(curves)
    asked = scenario.requirements
    order = quietest_on_top({name: run.force for name, run in curves.items()})
    for name, run in curves.items():
        _draw_run(axes, run, name, colour[name], order[name])
        if run.time[-1] < scenario.duration:
            axes[1].plot(run.time[-1], run.state[-1, 1], "x", color=colour[name], markersize=8)
    for axis, label, limit in zip(axes, _PANELS, _LIMITS, strict=False):
        axis.set_ylabel(label)
        if (value := getattr(asked, limit)) is not None:
            _draw_limits(axis, value)
    rests = asked.settling_time is not None or asked.recover_within is not None
    for axis, band in zip(axes, (asked.position_band, asked.angle_band), strict=False):
        if rests:
            axis.axhspan(-band, band, color=GREY, alpha=0.18, linewidth=0.0)
    _draw_plant(axes[3], scenario)
    for disturbance in scenario.disturbances:
        for axis in axes:
            edges = disturbance.breakpoints
            axis.axvspan(min(edges), max(edges), color=GREY, alpha=0.25, linewidth=0.8)
    axes[0].legend(ncols=min(len(curves), 5), loc="lower left", bbox_to_anchor=(0.0, 1.0))
    axes[3].set_xlabel(TIME)
    axes[3].set_xlim(0.0, scenario.duration)
    return figure


def _draw_run(axes: Sequence[Axes], run: Curves, name: str, colour: str, order: float) -> None:
    """Draw z, phi, the exerted force and, where the drive changes it, the command."""
    line: Any = {"color": colour, "label": name, "linewidth": 1.3, "zorder": order}
    for axis, values in zip(axes, (run.state[:, 0], run.state[:, 1], run.force), strict=False):
        axis.plot(run.time, values, **line)
    if not np.array_equal(run.command, run.force):
        axes[2].plot(run.time, run.command, color=colour, linewidth=0.6, alpha=0.4, zorder=1.0)


def _draw_limits(axis: Axes, value: float) -> None:
    """Draw a limit on either side."""
    for limit in (-value, value):
        axis.axhline(limit, color=BLACK, linewidth=0.9, linestyle=_DASHED)


def _draw_plant(axis: Axes, scenario: Scenario) -> None:
    """Draw M and l over time."""
    instants = np.array(scenario.breakpoints)
    around = np.concatenate([np.nextafter(instants, 0.0), instants])
    time = np.unique([*np.linspace(0.0, scenario.duration, 500), *around])
    axis.plot(time, scenario.cart_mass(time), color=BLACK, label="M [kg]", linewidth=1.2)
    axis.plot(
        time, scenario.half_length(time), color=BLACK, label="l [m]", linewidth=1.2, linestyle=":"
    )
    axis.set_ylim(bottom=0.0)
    axis.legend(ncols=2, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    axis.set_ylabel("plant")
