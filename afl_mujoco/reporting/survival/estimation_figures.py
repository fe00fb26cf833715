"""M and l as they are and as they are estimated, and the pole under the law that is told so."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from afl_mujoco.document.style import (
    BLACK,
    BLUE,
    LENGTH,
    MASS,
    TIME,
    VERMILION,
    Drawn,
    in_words,
    new_figure,
    styled,
)
from afl_mujoco.validation.estimation.study import Case
from afl_mujoco.validation.estimation.tracking import FOUND, Tracking

SHOWN = ("step-step", "trapezoid-trapezoid")
"""Which schedules are drawn, of those that were studied."""

UNTIL = 12.0
"""Where the panels end [s]: nothing happens after that."""


@styled()
def draw_estimation(cases: Sequence[Case]) -> Drawn:
    """Draw M, l and the pole angle, one column for each of `SHOWN`.

    Parameters
    ----------
    cases
        From `study_estimation`; if none is of `SHOWN`, the first is drawn.
    """
    shown = [case for case in cases if case.scenario.name in SHOWN] or list(cases[:1])
    figure = new_figure(5.2 * len(shown) + 0.6, 7.2)
    panels = figure.subplots(3, len(shown), sharex=True, sharey="row", squeeze=False)
    for column, case in zip(panels.T, shown, strict=True):
        column[0].set_title(case.scenario.name)
        _draw_parameters(column[0], column[1], case)
        _draw_angles(column[2], case)
        column[2].set_xlabel(TIME)
    for axis, label in zip(panels[:, 0], (MASS, LENGTH, "pole angle φ [rad]"), strict=True):
        axis.set_ylabel(label)
    panels[0, 0].legend(loc="lower right")
    panels[2, 0].legend(loc="lower right")
    controller, noise = cases[0].controller, cases[0].noise
    return Drawn(
        name="estimation",
        title="M and l estimated online",
        caption=(
            f"The {controller} law told M, l and the state by the estimator, as deployed at 1 kHz, "
            f"with {1e3 * noise.noise_z:g} mm and {1e3 * noise.noise_phi:g} mrad of noise on the "
            "measured z and φ. Black: the truth, and the "
            "same law told the truth without noise. An estimate is frozen while the motion says "
            "nothing about it: a plant that changes at rest is found when it next moves."
        ),
        alt=" ".join(_said(case) for case in shown),
        figure=figure,
    )


def _draw_parameters(mass: Axes, length: Axes, case: Case) -> None:
    """Draw M and l, true and estimated."""
    found = case.estimated
    time = np.linspace(0.0, UNTIL, 4001)
    for axis, truth, estimate in (
        (mass, case.scenario.cart_mass, found.cart_mass),
        (length, case.scenario.half_length, found.half_length),
    ):
        axis.plot(time, truth(time), color=BLACK, linewidth=1.2, label="true")
        part = found.time <= UNTIL
        axis.plot(
            found.time[part], estimate[part], color=VERMILION, linewidth=1.0, label="estimated"
        )
        axis.set_ylim(bottom=0.0)
    mass.set_xlim(0.0, UNTIL)


def _draw_angles(axis: Axes, case: Case) -> None:
    """Draw the pole angle of both loops."""
    dashes = (0.0, (4.0, 3.0))
    for run, colour, style, label in (
        (case.estimated.run, BLUE, "-", "told by the estimator"),
        (case.oracle, BLACK, dashes, "told the truth"),
    ):
        part = run.time <= UNTIL
        axis.plot(
            run.time[part], run.state[part, 1], color=colour, linestyle=style, linewidth=1.1,
            label=label,
        )  # fmt: skip


def _said(case: Case) -> str:
    """Say with numbers how one schedule is followed."""
    told = {loop.told: loop for loop in case.loops if loop.noise == (loop.told == "estimator")}
    forces = [told[who].figures["max_force"] for who in ("truth", "estimator")]
    text = ["none" if x is None else f"{in_words(x)} N" for x in forces]
    return (
        f"{case.scenario.name}: M {_followed(case.cart_mass[0])}, l "
        f"{_followed(case.half_length[0])}; the largest force is {text[0]} told the truth, "
        f"{text[1]} told by the estimator."
    )


def _followed(one: Tracking) -> str:
    """Say how soon steps are found, or how late ramps are."""
    said = []
    for step in one.steps:
        after = step.reached_after
        late = "never" if after is None else f"{in_words(after)} s later"
        said.append(f"stepped at {step.at:g} s is first within {100 * FOUND:g} % {late}")
    for ramp in one.ramps:
        if ramp.lag is not None:
            said.append(f"lags {in_words(ramp.lag)} s on the ramp from {ramp.start:g} s")
    return " and ".join(said) or "does not change"
