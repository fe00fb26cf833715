"""M and l, true and estimated, and the pole angle of the loops that use them."""

from __future__ import annotations

from matplotlib.figure import Figure

from afl_mujoco.report.style import (
    BLACK,
    BLUE,
    LENGTH,
    MASS,
    TIME,
    VERMILION,
    new_figure,
)
from afl_mujoco.studies.estimation.result import UNTIL, Case, Result

SHOWN = ("step-step", "trapezoid-trapezoid")
"""Schedules that are drawn if they were studied."""


def shown_cases(result: Result) -> list[Case]:
    """Return the schedules that are drawn: those of `SHOWN`, or the first."""
    found = [case for case in result.cases if case.scenario in SHOWN]
    return found or list(result.cases[:1])


def draw_estimation(result: Result) -> Figure:
    """Draw M, l and the pole angle, one column for each schedule."""
    shown = shown_cases(result)
    figure = new_figure(5.2 * len(shown) + 0.6, 7.2)
    panels = figure.subplots(3, len(shown), sharex=True, sharey="row", squeeze=False)
    for (mass, length, angle), case in zip(panels.T, shown, strict=True):
        curves = case.curves
        mass.set_title(case.scenario)
        for axis, true, estimated in (
            (mass, curves.true_cart_mass, curves.cart_mass),
            (length, curves.true_half_length, curves.half_length),
        ):
            axis.plot(curves.time, true, color=BLACK, linewidth=1.2, label="true")
            axis.plot(curves.time, estimated, color=VERMILION, linewidth=1.0, label="estimated")
            axis.set_ylim(bottom=0.0)
        angle.plot(
            curves.estimated_time, curves.estimated_angle, color=BLUE, linewidth=1.1,
            label="estimated parameters",
        )  # fmt: skip
        angle.plot(
            curves.true_time, curves.true_angle, color=BLACK, linewidth=1.1,
            linestyle=(0.0, (4.0, 3.0)), label="true parameters",
        )  # fmt: skip
        mass.set_xlim(0.0, UNTIL)
        angle.set_xlabel(TIME)
    for axis, label in zip(panels[:, 0], (MASS, LENGTH, "pole angle φ [rad]"), strict=True):
        axis.set_ylabel(label)
    panels[0, 0].legend(loc="lower right")
    panels[2, 0].legend(loc="lower right")
    return figure
