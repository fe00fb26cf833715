"""A recording beside its predictions, and errors against the horizon."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from afl_mujoco.report.style import BLACK, GREY, TIME, VERMILION, new_figure
from afl_mujoco.studies.hardware.result import Result
from afl_mujoco.studies.identified_parts import draw_log

NAMES = {
    "nominal": "as its owners give it",
    "uncoupled": "without coupling",
    "constant_velocity": "constant velocity",
}
"""The baselines in words."""

_MARKS = {"nominal": "s", "uncoupled": "^", "constant_velocity": "v"}


def draw_recording(result: Result) -> Figure:
    """Draw a recording, and its predictions half a second at a time."""
    r = result.recorded
    predicted = list(zip(r.predicted_time, r.predicted_z, r.predicted_phi, strict=True))
    horizons, z, phi = result.band
    return draw_log(r.time, r.z, r.phi, r.command, predicted, (horizons, 2.0 * z, 2.0 * phi))


def draw_residuals(result: Result) -> Figure:
    """Draw the errors of the predictions of a recording."""
    r = result.recorded
    figure = new_figure(9.0, 4.2)
    axes = figure.subplots(2, 1, sharex=True)
    for k in range(len(r.starts)):
        when = r.predicted_time[k]
        rows = np.searchsorted(r.time, when - 1e-9)
        rows = np.minimum(rows, len(r.time) - 1)
        for axis, read, predicted in (
            (axes[0], r.z, r.predicted_z), (axes[1], r.phi, r.predicted_phi),
        ):  # fmt: skip
            axis.plot(when, 1e3 * (predicted[k] - read[rows]), color=VERMILION, linewidth=1.2)
            axis.plot(when[0], 0.0, ".", color=BLACK, markersize=5.0)
    axes[0].set_ylabel("error of z [mm]")
    axes[1].set_ylabel("error of φ [mrad]")
    axes[1].set_xlabel(TIME)
    axes[1].set_xlim(float(r.time[0]), float(r.time[-1]))
    return figure


def draw_horizons(result: Result) -> Figure:
    """Draw the rms error against the horizon, of the model and of the baselines."""
    figure = new_figure(9.0, 4.0)
    axes = figure.subplots(1, 2)
    for axis, name, label in (
        (axes[0], "rms_z", "rms error of z [m]"), (axes[1], "rms_phi", "rms error of φ [rad]"),
    ):  # fmt: skip
        for key, errors in result.baselines.items():
            points = [(e.horizon, getattr(e, name)) for e in errors]
            axis.plot(
                *zip(*points, strict=True), marker=_MARKS[key], color=GREY, linewidth=1.0,
                markersize=5.0, markerfacecolor="none", label=NAMES[key],
            )  # fmt: skip
        points = [(e.horizon, getattr(e, name)) for e in result.held_out]
        axis.plot(*zip(*points, strict=True), "o-", color=VERMILION, label="identified, in MuJoCo")
        if name == "rms_phi":
            driven = [(e.horizon, e.rms_phi) for e in result.pole]
            axis.plot(
                *zip(*driven, strict=True), "D-", color=BLACK, markersize=4.0,
                label="pole alone, cart known",
            )  # fmt: skip
        axis.set_yscale("log")
        axis.set_xlabel("horizon [s]")
        axis.set_ylabel(label)
    figure.legend(*axes[1].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure
