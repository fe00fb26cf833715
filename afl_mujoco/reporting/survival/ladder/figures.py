"""The ladder as figures: thresholds at a glance, and what a rig does as its flaws add up."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.patches import Patch

from afl_mujoco.document.style import (
    BLACK,
    BLUE,
    ORANGE,
    VERMILION,
    Drawn,
    new_figure,
    styled,
)
from afl_mujoco.reporting.survival.ladder.words import (
    CLASSES,
    FAILS,
    MUCH,
    Row,
    class_of,
    level_text,
    rise_of,
    settles_at_typical,
    threshold_text,
)

COLOURS = (VERMILION, "#F3C65F", "#BFE0F5", BLUE)
"""Of the classes of a threshold, the worst first; light ones carry black text."""

WENT = {"settled": BLUE, "upright, not settled": ORANGE, "failed": VERMILION}
"""How a run of a rig ends, and its colour."""

WHITE = "#FFFFFF"


def draw_ladder(ladder: Row) -> list[Drawn]:
    """Draw the figures of a ladder.

    Parameters
    ----------
    ladder
        What a ladder.json holds.
    """
    return [draw_thresholds(ladder), draw_together(ladder)]


@styled()
def draw_thresholds(ladder: Row) -> Drawn:
    """Draw the thresholds: a row for each rung, a column for each controller.

    Parameters
    ----------
    ladder
        What a ladder.json holds.
    """
    rungs, controllers = ladder["rungs"], ladder["controllers"]
    figure = new_figure(2.9 + 1.05 * len(controllers), 1.3 + 0.3 * len(rungs))
    axes = figure.subplots()
    rises = [[rise_of(ladder, rung["name"], name) for name in controllers] for rung in rungs]
    kinds = np.array(
        [[class_of(rung, rise) for rise in row] for rung, row in zip(rungs, rises, strict=True)]
    )
    axes.imshow(np.array([to_rgba(c) for c in COLOURS])[kinds], aspect="auto")
    for i, (rung, row) in enumerate(zip(rungs, rises, strict=True)):
        for j, rise in enumerate(row):
            unsettled = kinds[i, j] != FAILS and not settles_at_typical(rise)
            text = threshold_text(rung, rise["survives"]) + (" ~" if unsettled else "")
            colour = WHITE if kinds[i, j] in (FAILS, MUCH) else BLACK
            axes.text(j, i, text, ha="center", va="center", fontsize=8.5, color=colour)
    labels = [f"{r['title']}  (rig: {level_text(r, r['typical'])} {r['unit']})" for r in rungs]
    axes.set_yticks(range(len(rungs)), labels)
    _name_controllers(axes, controllers)
    _draw_grid(axes, len(rungs), len(controllers))
    handles = [Patch(facecolor=c, label=text) for c, text in zip(COLOURS, CLASSES, strict=True)]
    figure.legend(handles=handles, loc="outside lower center", ncols=2)
    failing = int((kinds == FAILS).sum())
    return Drawn(
        name="ladder-thresholds",
        title="From where each controller no longer survives",
        caption=(
            f"Scenario {_scenarios(ladder)}. In each cell the level, in the unit of its row, from "
            "which the pole falls, the run diverges or the cart reaches an end stop, by bisection "
            f"to {100.0 * ladder['settings']['tolerance']:g} %. Its colour compares that with a "
            "good laboratory rig, whose level stands with the rung. ~ : on such a rig the cart "
            "stays up but does not come to rest at the middle of its rail."
        ),
        alt=(
            f"A table of {len(rungs)} departures from the ideal loop by {len(controllers)} "
            f"controllers; {failing} of {kinds.size} fail at the level of a typical rig."
        ),
        figure=figure,
    )


@styled()
def draw_together(ladder: Row) -> Drawn:
    """Draw how each controller ends as the flaws of a typical rig are switched on in turn.

    Parameters
    ----------
    ladder
        What a ladder.json holds.
    """
    names = ladder["together"]["rungs"]
    verdicts = ladder["together"]["verdicts"]
    titles = {rung["name"]: rung["title"] for rung in ladder["rungs"]}
    controllers = ladder["controllers"]
    figure = new_figure(2.2 + 0.42 * len(names), 2.6 + 0.3 * len(controllers))
    axes = figure.subplots()
    kinds = np.array([[_went(verdict) for verdict in verdicts[c]] for c in controllers])
    axes.imshow(np.array([to_rgba(c) for c in WENT.values()])[kinds], aspect="auto")
    labels = [("+ " if i else "") + titles.get(name, name) for i, name in enumerate(names)]
    axes.set_xticks(range(len(names)), labels, rotation=55.0, ha="right", rotation_mode="anchor")
    axes.set_yticks(range(len(controllers)), controllers)
    _draw_grid(axes, len(controllers), len(names))
    handles = [Patch(facecolor=colour, label=text) for text, colour in WENT.items()]
    figure.legend(handles=handles, loc="outside upper center", ncols=3)
    return Drawn(
        name="ladder-together",
        title="The flaws of a typical rig, switched on one after another",
        caption=(
            f"Scenario {_scenarios(ladder)}. Each column adds one departure from the ideal "
            "loop, at the level of a good laboratory rig, to those before it."
        ),
        alt="; ".join(f"{name}: {_story(verdicts[name], labels)}" for name in controllers) + ".",
        figure=figure,
    )


def _went(verdict: Row) -> int:
    """Return how a run of a rig ends, as a place in `WENT`."""
    return 0 if verdict["settles"] else 1 if verdict["survives"] else 2


def _story(verdicts: list[Row], labels: list[str]) -> str:
    """Say from which rung on a controller does not settle, and does not survive."""
    said = []
    for key, words in (("settles", "does not settle"), ("survives", "fails")):
        first = next((i for i, verdict in enumerate(verdicts) if not verdict[key]), None)
        if first is not None:
            said.append(f"{words} from {labels[first].removeprefix('+ ')} on")
    return " and ".join(said) or "settles throughout"


def _scenarios(ladder: Row) -> str:
    """Return the names of the scenarios."""
    return " and ".join(ladder["settings"]["scenarios"])


def _name_controllers(axes: Axes, controllers: list[str]) -> None:
    """Write the names of the controllers over the columns."""
    axes.xaxis.tick_top()
    wrapped = [name.replace("-", "-\n", 1) for name in controllers]
    axes.set_xticks(range(len(controllers)), wrapped)


def _draw_grid(axes: Axes, rows: int, columns: int) -> None:
    """Draw white lines between the cells instead of a frame."""
    axes.grid(False)
    axes.tick_params(length=0.0)
    axes.spines[:].set_visible(False)
    for i in range(1, rows):
        axes.axhline(i - 0.5, color=WHITE, linewidth=1.5)
    for j in range(1, columns):
        axes.axvline(j - 0.5, color=WHITE, linewidth=1.5)
