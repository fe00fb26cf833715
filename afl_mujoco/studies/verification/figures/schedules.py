"""How M and l change in each case: the analogue of the paper's Fig. 6."""

from __future__ import annotations

from collections.abc import Sequence

from afl_mujoco.document.style import (
    BLUE,
    LENGTH,
    MASS,
    TIME,
    VERMILION,
    Drawn,
    new_figure,
    styled,
)
from afl_mujoco.studies.verification.curves import Curves

TAIL = 2.0
"""How long a schedule is drawn after its last change [s]."""


@styled()
def draw_schedules(cases: Sequence[Curves]) -> Drawn:
    """Draw M and l over time, a column for each case."""
    figure = new_figure(2.6 * len(cases) + 0.6, 3.9)
    axes = figure.subplots(2, len(cases), sharex=True, sharey="row", squeeze=False)
    until = min(max(map(last_change, cases)) + TAIL, max(float(c.time[-1]) for c in cases))
    for column, case in zip(axes.T, cases, strict=True):
        column[0].plot(case.time, case.cart_mass, color=VERMILION)
        column[1].plot(case.time, case.half_length, color=BLUE)
        column[0].set_title(case.scenario)
        column[1].set(xlabel=TIME, xlim=(0.0, until))
        for axis in column:
            axis.set_ylim(bottom=0.0)
            axis.margins(y=0.08)
            axis.tick_params(labelleft=True)
    axes[0, 0].set_ylabel(MASS)
    axes[1, 0].set_ylabel(LENGTH)
    return Drawn(
        name="schedules",
        title="How the plant changes",
        caption="Analogue of the paper's Fig. 6: cart mass M and half-length l over time in the "
        "four cases. Times and values are not in the paper's text; these are ours (decision D3).",
        alt=f"{2 * len(cases)} panels over the first {until:g} s. "
        + " ".join(f"{case.scenario}: {_in_words(case)}." for case in cases),
        figure=figure,
    )


def last_change(curves: Curves) -> float:
    """Return when M or l changes for the last time [s]."""
    inputs = zip(curves.cart_mass.tolist(), curves.half_length.tolist(), strict=True)
    *before, last = inputs
    changed = [k for k, values in enumerate(before) if values != last]
    return float(curves.time[changed[-1] + 1]) if changed else 0.0


def _in_words(case: Curves) -> str:
    """Say between which values M and l move."""
    said = []
    for name, unit, values in (("M", "kg", case.cart_mass), ("l", "m", case.half_length)):
        first, last = values[0], values[-1]
        low, high = values.min(), values.max()
        back = first == last and low != high
        far = f"from {first:g} to {high if back else last:g} {unit}{' and back' * bool(back)}"
        said.append(f"{name} stays {first:g} {unit}" if low == high else f"{name} {far}")
    return ", ".join(said)
