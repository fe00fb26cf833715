"""States and force over time: the analogues of the paper's Figs. 7 to 11."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import partial

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from afl_mujoco.report import old as blocks
from afl_mujoco.report.numbers import sentence
from afl_mujoco.report.style import (
    BLACK,
    GREY,
    LENGTH,
    MASS,
    STATE_LABELS,
    TIME,
    colours,
    in_words,
    new_figure,
)
from afl_mujoco.studies.cases import DEPLOYED
from afl_mujoco.studies.verification.curves import REFERENCE, Curves

FIRST = 0.05
"""Length of the separate panel for the force at the start [s]."""

SETTLED = 0.01
"""Share of its peak below which a state is no longer worth drawing."""

WINDOW = (9.5, 14.0)
"""Time window that is drawn around the disturbance of the paper's Fig. 11 [s]."""

FORCE = 4
"""Column of the force, after those of the states."""

_LABELS = (*STATE_LABELS, "force F [N]")
_DASHES = ((0.0, (4.0, 3.0)), (0.0, (1.2, 1.8)), (0.0, (6.0, 2.0, 1.0, 2.0)))


def response_figure(
    name: str, heading: str, curves: Sequence[Curves], hold: float
) -> blocks.Figure:
    """Return a scenario under each controller: M and l, the four states, the force.

    Parameters
    ----------
    hold
        How long the control is held [s].
    """
    until = max(map(_settled, curves))
    return blocks.Figure(
        name=name,
        title=curves[0].scenario,
        caption=f"{heading} {_drawn(curves, hold)}{_ending(curves, until)}".lstrip(),
        alt=f"Eight panels over {until:g} s: M, l, the four states, and the force, whose first "
        f"{FIRST:g} s stand apart. {' '.join(map(_peaks, curves))} {_closeness(curves)}",
        draw=partial(_draw_response, curves, until),
    )


def _draw_response(curves: Sequence[Curves], until: float) -> Figure:
    """Draw the eight panels."""
    figure = new_figure(9.6, 9.0)
    axes = figure.subplots(4, 2, height_ratios=(0.55, 1.0, 1.0, 1.0))
    schedules = ((MASS, curves[0].cart_mass), (LENGTH, curves[0].half_length))
    for axis, (label, values) in zip(axes[0], schedules, strict=True):
        axis.plot(curves[0].time, values, color=GREY)
        axis.set(ylabel=label, xlim=(0.0, until), ylim=(0.0, 1.15 * float(values.max())))
    for axis, column in zip(axes[1:3].ravel(), (0, 2, 1, 3), strict=True):
        _draw_column(axis, curves, column, (0.0, until))
    for axis, window in zip(axes[3], ((0.0, FIRST), (FIRST, until)), strict=True):
        _draw_column(axis, curves, FORCE, window, held=window[0] == 0.0)
        _draw_push(axis, curves[0], window)
    axes[3, 0].set_title(f"the first {FIRST:g} s", fontsize=8.5)
    axes[3, 1].set_title(f"from {FIRST:g} s on", fontsize=8.5)
    for axis in axes[2:].ravel():
        axis.set_xlabel(TIME)
    for axis, lowest in zip(axes[:2].ravel(), (*axes[2], *axes[2]), strict=True):
        axis.sharex(lowest)
        axis.tick_params(labelbottom=False)
    figure.align_ylabels()
    _draw_legend(figure, curves, pushed=bool(curves[0].push.any()))
    return figure


def impulse_figure(cases: Sequence[Sequence[Curves]], hold: float) -> blocks.Figure:
    """Return angle, position and force around the disturbance, a column for each scenario.

    Parameters
    ----------
    hold
        How long the control is held [s].
    """
    every = [one for curves in cases for one in curves]
    return blocks.Figure(
        name="report-impulse",
        title="The disturbance",
        caption=f"Analogue of the paper's Fig. 11: {', '.join(c[0].scenario for c in cases)}, "
        f"disturbed by a force of {_strongest(every[0].push):g} N on the cart for 0.1 s at "
        "t = 10 s (decision D6). "
        f"{_drawn(cases[0], hold)}",
        alt=f"{3 * len(cases)} panels from {WINDOW[0]:g} to {WINDOW[1]:g} s: angle, position and "
        f"force in each scenario. After the disturbance: {' '.join(map(_deflections, cases))} "
        f"{_closeness(every)}",
        draw=partial(_draw_impulse, cases),
    )


def _draw_impulse(cases: Sequence[Sequence[Curves]]) -> Figure:
    """Draw the columns."""
    figure = new_figure(max(2.7 * len(cases) + 0.7, 4.8), 6.6)
    axes = figure.subplots(3, len(cases), sharex=True, sharey="row", squeeze=False)
    for panels, curves in zip(axes.T, cases, strict=True):
        for axis, column in zip(panels, (1, 0, FORCE), strict=True):
            _draw_column(axis, curves, column, WINDOW)
            axis.label_outer()
        _draw_push(panels[2], curves[0], WINDOW)
        panels[0].set_title(curves[0].scenario)
        panels[2].set_xlabel(TIME)
    _draw_legend(figure, cases[0], pushed=True, columns=2 if len(cases) == 1 else 5)
    return figure


def _column(one: Curves, simulator: str, column: int) -> tuple[np.ndarray, np.ndarray]:
    """Return instants [s] and values of a state, or of the force, in a simulator."""
    force = column == FORCE
    values = one.forces[simulator] if force else one.states[simulator][:, column]
    return one.time[: len(values)], values


def _draw_column(
    axis: Axes,
    curves: Sequence[Curves],
    column: int,
    window: tuple[float, float],
    *,
    held: bool = False,
) -> None:
    """Draw a state, or the force, of every controller: MuJoCo solid, the ODE dashed over it."""
    stepped = "steps-post" if held else "default"
    shades = colours(one.controller for one in curves)
    for simulator in (DEPLOYED, REFERENCE):
        for one, dashes in zip(curves, _DASHES * len(curves), strict=False):
            time, values = _column(one, simulator, column)
            first, last = np.searchsorted(time, window, side="right")
            here = slice(max(0, first - 1), last + 1)  # to both edges of the panel
            over = {"color": BLACK, "linewidth": 0.9, "linestyle": dashes}
            under = {"color": shades[one.controller], "linewidth": 2.4, "drawstyle": stepped}
            style = over if simulator == REFERENCE else under
            axis.plot(time[here], values[here], **style)  # type: ignore[arg-type]
    axis.set(ylabel=_LABELS[column], xlim=window)


def _draw_push(axis: Axes, one: Curves, window: tuple[float, float]) -> None:
    """Draw the disturbing force."""
    here = (one.time >= window[0]) & (one.time <= window[1]) & one.push.any()
    axis.fill_between(
        one.time[here], one.push[here], step="post", color=GREY, alpha=0.4, linewidth=0.0
    )


def _draw_legend(
    figure: Figure, curves: Sequence[Curves], *, pushed: bool, columns: int = 5
) -> None:
    """Draw the legend below the figure."""
    handles: dict[str, Artist] = {}
    shades = colours(one.controller for one in curves)
    for one, dashes in zip(curves, _DASHES * len(curves), strict=False):
        colour = shades[one.controller]
        handles[f"{one.controller}, MuJoCo"] = Line2D([], [], color=colour, linewidth=2.4)
        handles[f"{one.controller}, ODE"] = Line2D(
            [], [], color=BLACK, linewidth=0.9, linestyle=dashes
        )
    if pushed:
        handles["disturbing force"] = Patch(color=GREY, alpha=0.4)
    figure.legend(
        list(handles.values()), list(handles), loc="outside lower center",
        ncols=len(handles) if len(handles) <= columns else min(columns, 4),
        handlelength=3.0,
    )  # fmt: skip


def _settled(one: Curves) -> float:
    """Return the whole second after which every state stays within `SETTLED` of its peak."""
    state = np.abs(one.states[DEPLOYED])
    moving = np.flatnonzero((state > SETTLED * np.nanmax(state, axis=0)).any(axis=1))
    last = float(one.time[moving[-1]]) if len(moving) else 0.0
    return min(max(1.0, math.ceil(last + 1e-9)), float(one.time[-1]))


def _ending(curves: Sequence[Curves], until: float) -> str:
    """Say which runs ended early, or what happens in the time that is not drawn."""
    broken = [
        f" The run with {one.controller} ends at t = {one.time[reached - 1]:.3g} s."
        for one in curves
        if (reached := len(one.states[DEPLOYED])) < len(one.time)
    ]
    if broken:
        return "".join(broken)
    rest = f" From t = {until:g} s on every state stays within {100 * SETTLED:g} % of its peak."
    return rest if until < curves[0].time[-1] else ""


def _drawn(curves: Sequence[Curves], hold: float) -> str:
    """Say what is drawn, and how."""
    names = ", ".join(one.controller for one in curves)
    return (
        f"Controllers: {names}. Solid: MuJoCo as deployed, control held for {1e3 * hold:g} ms; "
        "dashed: the ideal ODE."
    )


def _peaks(one: Curves) -> str:
    """Say how far a run goes."""
    state, force = one.states[DEPLOYED], one.forces[DEPLOYED]
    z, _, z_dot, phi_dot = map(in_words, np.nanmax(np.abs(state), axis=0))
    return (
        f"{sentence(one.controller)}: the pole starts at {in_words(state[0, 1])} rad and swings "
        f"{in_words(_beyond(state[:, 1]))} rad beyond upright, the cart moves {z} m away, its "
        f"speed peaks at {z_dot} m/s, the pole's rate at {phi_dot} rad/s, the force at "
        f"{in_words(_largest(force))} N."
    )


def _largest(values: np.ndarray) -> float:
    """Return the largest absolute value, NaN left out; 0 if there is none, as without a force."""
    return float(np.abs(values[~np.isnan(values)]).max(initial=0.0))


def _beyond(values: np.ndarray) -> float:
    """Return how far a curve goes to the other side of zero."""
    return max(0.0, float((-np.sign(values[0]) * values).max()))


def _deflections(curves: Sequence[Curves]) -> str:
    """Say how far the disturbance moves pole and cart."""
    said = []
    for one in curves:
        time, states = one.time[: len(one.states[DEPLOYED])], one.states[DEPLOYED]
        later = np.abs(states[time >= 10.0])
        if not len(later):
            said.append(f"{one.controller} fell before the disturbance")
            continue
        z, phi = (in_words(float(later[:, column].max())) for column in (0, 1))
        said.append(f"{one.controller} {phi} rad and {z} m")
    return f"{curves[0].scenario}: {', '.join(said)}."


def _closeness(curves: Sequence[Curves]) -> str:
    """Say how far MuJoCo's curves are from the ODE's."""
    state, force = (max(_apart(one, which) for one in curves) for which in (range(FORCE), (FORCE,)))
    return (
        "Over the whole run the dashed curves of the ODE differ from the solid ones by at most "
        f"{in_words(state)} in any state (SI units) and by {in_words(force)} N in the force."
    )


def _apart(one: Curves, columns: Iterable[int]) -> float:
    """Return the largest difference from the ODE in some columns."""
    largest = 0.0
    for column in columns:
        (_, deployed), (_, ideal) = (_column(one, run, column) for run in (DEPLOYED, REFERENCE))
        both = min(len(deployed), len(ideal))
        largest = max(largest, _largest(deployed[:both] - ideal[:both]))
    return largest


def _strongest(push: np.ndarray) -> float:
    """Return the disturbing force that is largest in size [N]."""
    return float(push[np.abs(push).argmax()])
