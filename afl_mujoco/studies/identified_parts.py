"""Parts shared by studies of measured cart-poles: tables of estimates, a log beside the model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure as Drawing
from numpy.typing import NDArray

from afl_mujoco.identification.identify import Estimate, Identified, Step
from afl_mujoco.identification.pole import linearity
from afl_mujoco.report.numbers import listed, short
from afl_mujoco.report.old import Column, Table
from afl_mujoco.report.style import BLACK, BLUE, GREY, TIME, VERMILION, new_figure

Array = NDArray[np.float64]

MOST_PAIRS = 4
"""Largest number of pairs of correlated estimates that are named."""


def estimates_table(caption: str, estimates: Sequence[Estimate]) -> Table:
    """Return estimates with their intervals; the harmonics of the linearity are left out."""
    return Table(
        caption=caption,
        columns=(
            Column("Parameter"),
            Column("Unit"),
            Column("Estimate", number=True),
            Column("95 % interval", number=True),
        ),
        rows=[
            (
                one.title,
                one.unit,
                short(one.value),
                _interval(one),
            )
            for one in estimates
            if not one.name.startswith(("sin_", "cos_"))
        ],
    )


def _interval(estimate: Estimate) -> str:
    """Return the interval of an estimate, if it has one."""
    if estimate.on_bound:
        return "on its bound"
    return f"{short(estimate.low)} to {short(estimate.high)}"


def nominal_table(identified: Identified) -> Table:
    """Return masses, forces and frictions beside the values that the owners give."""
    n = identified.description.nominal
    given = {
        "half_length": n.half_length, "cart_mass": n.cart_mass, "force": n.force,
        "rail_damping": n.rail_damping, "hinge_damping": n.hinge_damping,
    }  # fmt: skip
    return Table(
        caption=f"For a pole of {short(n.pole_mass)} kg; motion alone does not determine it",
        columns=(
            Column("Quantity"),
            Column("Unit"),
            Column("Given", number=True),
            Column("Identified", number=True),
            Column("95 % interval", number=True),
        ),
        rows=[
            (
                one.title,
                one.unit,
                short(given.get(one.name)),
                short(one.value),
                _interval(one),
            )
            for one in identified.physical
        ],
    )


def indistinct(identified: Identified) -> list[str]:
    """Say what the logs cannot tell apart, a sentence each."""
    steps: list[Step] = [identified.pole, *([identified.drive] if identified.drive else [])]
    told = [
        "Motion alone determines only ratios of masses and forces: all of them scale with the "
        "given mass of the pole.",
        "The back-EMF of a motor and the viscous friction of the rail act alike and are "
        "estimated as one; so are the mass of the cart and the inertia of its drive.",
        "A short lag of the drive acts like a delay: it is estimated only if the logs resolve it.",
        "A wrong scale of the position and a wrong coupling look the same: k is 1 for any rigid "
        "pole, so the deviation of k from 1 is the error of the position scale.",
    ]
    titles = {one.name: one.title for step in steps for one in step.estimates}
    pairs = [pair for step in steps for pair in step.alike if not _is_linearity(pair)]
    if pairs:
        strongest = sorted(pairs, key=lambda pair: -abs(pair[2]))[:MOST_PAIRS]
        named = [f"{titles[a]} and {titles[b]} ({r:.2f})" for a, b, r in strongest]
        named += [f"{len(pairs) - MOST_PAIRS} more pairs"] if len(pairs) > MOST_PAIRS else []
        told.append(
            "Highly correlated, so known better in combination than individually: "
            f"{listed(named, 'and')}."
        )
    bound = [
        f"{one.title} ({short(one.value)}{'' if one.unit == '1' else f' {one.unit}'})"
        for step in steps
        for one in step.estimates
        if one.on_bound
    ]
    if bound:
        told.append(
            f"On the bound of the allowed range, without an interval: {listed(bound, 'and')}."
        )
    if identified.drive is None:
        told.append("The command is constant in every log: cart and drive cannot be identified.")
    return told


def linearity_text(identified: Identified) -> str:
    """Say how far the angle sensor deviates from a line; empty if it is taken as linear."""
    values = identified.values
    if "sin_1" not in values:
        return ""
    off = linearity(values, np.linspace(-np.pi, np.pi, 1000))
    off = off - off.mean()
    count = identified.description.angle_count
    size = f"{short(1e3 * float(np.abs(off).max()), 2)} mrad"
    counts = f", {short(float(np.abs(off).max()) / count, 2)} counts" if count else ""
    return f"The angle readings deviate from a straight line by up to {size}{counts}."


def _is_linearity(pair: tuple[str, str, float]) -> bool:
    """Return whether a pair involves the sensor's linearity, where correlation is expected."""
    return any(name.startswith(("sin_", "cos_")) for name in pair[:2])


def draw_log(
    time: Array,
    z: Array,
    phi: Array,
    command: Array,
    simulated: Sequence[tuple[Array, Array, Array]] = (),
    bands: tuple[Array, Array, Array] | None = None,
) -> Drawing:
    """Draw a log, and simulations that start from its readings.

    Parameters
    ----------
    time, z, phi, command
        The log, shape (N,) [s, m, rad].
    simulated
        Time, position and angle of each simulation.
    bands
        Time since a start [s], and the half-widths of a band about position and angle.
    """
    figure = new_figure(9.0, 7.0)
    axes = figure.subplots(3, 1, sharex=True, height_ratios=(3, 3, 1.4))
    labels = ("cart position z [m]", "pole angle φ [rad]")
    for axis, values, label in zip(axes, (z, phi), labels, strict=False):
        axis.plot(time, values, ".", color=BLACK, markersize=3.0, label="measured")
        axis.set_ylabel(label)
    for i, (when, position, angle) in enumerate(simulated):
        name = "simulated from a fitted state" if i == 0 else None
        for k, (axis, values) in enumerate(zip(axes, (position, angle), strict=False)):
            colour = (VERMILION, BLUE)[i % 2]
            axis.plot(when, values, color=colour, linewidth=1.2, label=name)
            if bands is not None:
                width = np.interp(when - when[0], bands[0], bands[1 + k])
                axis.fill_between(
                    when, values - width, values + width, color=colour, alpha=0.2, linewidth=0.0
                )
    axes[2].step(time, command, where="post", color=GREY, linewidth=1.0)
    axes[2].set_ylabel("command")
    axes[2].set_xlabel(TIME)
    axes[2].set_xlim(float(time[0]), float(time[-1]))
    axes[0].legend(ncols=2, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    return figure
