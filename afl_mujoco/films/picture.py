"""The frames of a film: one run, or up to four runs of one scenario side by side."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from textwrap import wrap
from typing import Any

import matplotlib
import mujoco
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from afl_mujoco.films.replay import AFTERWARDS, IDEAL, Replay
from afl_mujoco.films.scene import GHOST, Frame, Stage
from afl_mujoco.report.figures import BLACK, colours, styled
from afl_mujoco.scenario.parameters import labelled
from afl_mujoco.simulation.drawing import FORCE, PUSH, Colour

Picture = NDArray[np.uint8]
Rgb = tuple[int, int, int]
INK: Rgb = (238, 241, 246)
QUIET: Rgb = (164, 172, 186)
WARNING: Rgb = (255, 176, 102)
DIVIDER: Rgb = (70, 80, 98)
LIMIT = "#d55e00"
TOP, BOTTOM = (8, 10, 15), (33, 41, 56)
"""Gradient behind the scene, that of the sky of ``models/scene.xml``."""

DESIGN = (1280, 720)  # size of the picture for which the sizes of letters are given [px]

SMALLEST_LETTER = 10
BESIDE, PART_LETTERS = Frame(top=0.2, bottom=0.36), 1.15
"""Where plants stay in a part of a picture, and the size of letters there."""

MOST_CURVES, LETTER = 12, 0.62
"""Most curves, and the width of a letter over its height."""

PLOT_HEIGHT = 270
"""Height of plots for which the sizes of their letters and lines are given [px] at 100 dpi: legible
where a film is shown at half its size."""

FALLING = 0.2
"""Time before a fall in which a force without limits is not drawn whole [s]."""

LINES = ("-", "--", "-.", ":")


@dataclass(frozen=True, slots=True)
class Text:
    """A piece of text at a place [px], with the height of its letters [px] and Pillow's anchor."""

    x: float
    y: float
    text: str
    size: float
    colour: Rgb = INK
    anchor: str = "ls"
    mono: bool = False


def frames(
    replays: Sequence[Replay], held: str, size: tuple[int, int], fps: int, indices: Iterable[int]
) -> Iterator[Picture]:
    """Yield the frames of a film, each of shape (height, width, 3).

    One run fills the picture; several are side by side above curves that grow with time. `held`
    says how the controllers are deployed.
    """
    (width, height), count, alone = size, len(replays), len(replays) == 1
    part = size if alone else (width // count, height // 2)
    s = min(width / DESIGN[0], height / DESIGN[1]) * (1.0 if alone else PART_LETTERS)
    s = max(s, SMALLEST_LETTER / 16)  # of the labels
    frame = Frame() if alone else BESIDE
    plots = None if alone else draw_plots(replays, (width, height - part[1]))
    scenario = replays[0].plan.name
    titles = [f"{scenario}, {one.controller}" if alone else one.controller for one in replays]
    room = (part[0] / s - 56) / (LETTER * max(map(len, titles)))  # of a letter of the longest
    letters = min(28.0, room)
    behind = [write(backdrop(*part), [Text(28 * s, 46 * s, x, letters * s)]) for x in titles]
    subtitle = Text(28 * s, 76 * s, held if alone else scenario, 16 * s, QUIET)
    behind[0] = write(behind[0], [subtitle])
    above = max(letters * len(titles[-1]), 16 * len(subtitle.text) * alone) * LETTER * s
    behind[-1] = write(behind[-1], _legend(replays[0], held, alone, part[0], above, s))
    columns = [_columns(one, part[0], s) for one in replays]
    stage = Stage.of(replays, fps, part, frame)
    with mujoco.Renderer(stage.model.mj_model, part[1], part[0]) as renderer:
        end = min(_end(replays), replays[0].plan.duration)
        last = min(len(replays[0].time) - 1, math.ceil(end * fps))
        for index in itertools.takewhile(lambda index: index <= last, indices):
            ending = index >= last - round(AFTERWARDS * fps)
            picture = np.zeros((height, width, 3), np.uint8)
            parts = zip(replays, stage.paths, behind, strict=True)
            for k, (replay, path, back) in enumerate(parts):
                drawn, left = stage.draw(renderer, replay, index, path), k * part[0]
                texts = _numbers(replay, index, columns[k], part, s, ending)
                picture[: part[1], left : left + part[0]] = write(np.maximum(drawn, back), texts)
                if k > 0:
                    picture[: part[1], left] = DIVIDER
            if plots is not None:
                picture[part[1] :] = plots(float(replays[0].time[index]))
            yield picture


def _end(replays: Sequence[Replay]) -> float:
    return max(replay.end for replay in replays) + AFTERWARDS


def backdrop(width: int, height: int) -> Picture:
    """Return the gradient behind a scene, which is drawn on black: the brighter one is shown."""
    share = np.linspace(0.0, 1.0, height)[:, None]
    column = np.array(TOP) * (1.0 - share) + np.array(BOTTOM) * share
    return np.repeat(column.round().astype(np.uint8)[:, None, :], width, axis=1)


def write(picture: Picture, texts: Iterable[Text]) -> Picture:
    """Return the picture with texts on it."""
    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    for t in texts:
        font = _font(max(SMALLEST_LETTER, round(t.size)), t.mono)
        draw.text((t.x, t.y), t.text, font=font, fill=t.colour, anchor=t.anchor)
    return np.asarray(image)


@cache
def _font(size: int, mono: bool) -> ImageFont.FreeTypeFont:
    """Return a font of matplotlib's, which has the Greek letters."""
    folder = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    return ImageFont.truetype(folder / f"DejaVuSans{'Mono' if mono else ''}.ttf", size)


def _legend(
    replay: Replay, held: str, alone: bool, width: int, above: float, s: float
) -> list[Text]:
    """Return what the colours mean, and how the controllers of several runs are deployed.

    A line is left out where it does not fit beside what is written at the left, so wide [px].
    """
    short = held.removeprefix("as deployed: ")
    lines = [] if replay.ideal is None else [(f"pale: {IDEAL}", _rgb(GHOST))]
    if alone:
        force = ("force of a drive (length ~ √force)", _rgb(FORCE))
        lines = [("solid: MuJoCo", INK), *lines, force]
        lines += [("disturbance", _rgb(PUSH))] if replay.channels.any() else []
    else:
        lines.append((short, QUIET))
    lines = [x for x in lines if above + (16 * LETTER * len(x[0]) + 60) * s <= width]
    return [
        Text(width - 28 * s, (40 + 23 * row) * s, text, 16 * s, colour, "rs")
        for row, (text, colour) in enumerate(lines)
    ]


def _columns(replay: Replay, width: int, s: float) -> list[float]:
    """Return where readouts stand [px]: those that fit when each is as long as it ever is."""
    told = [replay.readouts(index) for index in range(len(replay.time))]
    labels = np.array([len(label) for label, _ in told[0]])
    values = np.max([[len(value) for _, value in one] for one in told], axis=0)
    letters = np.maximum(16 * labels, 24 * values)
    count = np.count_nonzero(np.cumsum(LETTER * letters + 12) <= (width - 28 * s) / s)
    weights = (np.maximum(labels, 1.5 * values) + 2.0)[:count]
    shares = (np.cumsum(weights) - weights) / weights.sum()
    places: list[float] = (28 * s + (width - 36 * s) * shares).tolist()
    return places


def _numbers(
    replay: Replay,
    index: int,
    columns: list[float],
    size: tuple[int, int],
    s: float,
    ending: bool,
) -> list[Text]:
    """Return what changes over a run: readouts, and how it ended."""
    width, height = size
    texts: list[Text] = []
    for x, (label, value) in zip(columns, replay.readouts(index), strict=False):
        texts.append(Text(x, height - 52 * s, label, 16 * s, QUIET))
        texts.append(Text(x, height - 20 * s, value.replace("-", "−"), 24 * s, mono=True))
    said = [one for one in (replay.ended(index), replay.verdict if ending else "") if one]
    most = max(8, int((width / s - 56) / (17 * LETTER)))
    lines = enumerate(line for one in said for line in wrap(one, most))
    return [*texts, *(Text(28 * s, (104 + 24 * k) * s, x, 17 * s, WARNING) for k, x in lines)]


def _rgb(colour: Colour) -> Rgb:
    red, green, blue = (round(255 * part) for part in colour[:3])
    return red, green, blue


def draw_plots(replays: Sequence[Replay], size: tuple[int, int]) -> Callable[[float], Picture]:
    """Draw curves of runs of one scenario, once.

    Returns the picture with the curves up to an instant [s] and a cursor there.
    """
    time = replays[0].time
    end = float(time[-1] + (time[1] - time[0] if len(time) > 1 else 1.0))
    end = min(end, _end(replays))
    with styled():
        dpi = 100.0 * size[1] / PLOT_HEIGHT
        figure = Figure(figsize=(size[0] / dpi, size[1] / dpi), dpi=dpi, layout="constrained")
        canvas = FigureCanvasAgg(figure)
        axes, curves = _plot(figure, replays, end)
        full = _drawn(canvas)
        for line in curves:
            line.set_visible(False)
        empty = _drawn(canvas)
    boxes = [[round(x) for x in axis.get_window_extent().extents] for axis in axes]

    def until(now: float) -> Picture:
        picture = empty.copy()
        for left, low, right, high in boxes:
            rows = slice(size[1] - high + 1, size[1] - low)
            cursor = left + 1 + round((right - left - 2) * min(now / end, 1.0))
            picture[rows, left + 1 : cursor] = full[rows, left + 1 : cursor]
            picture[rows, cursor] = 0  # black
        return picture

    return until


def _plot(figure: Figure, replays: Sequence[Replay], end: float) -> tuple[list[Axes], list[Line2D]]:
    """Draw coordinates, inputs with their limits, and parameters that change, in this order."""
    scenario = replays[0].plan
    longest = max(replays, key=lambda replay: replay.end)  # a run that ended keeps its parameters
    plant, changing = scenario.plant, longest.changing
    names, first = (*plant.coordinates, *plant.inputs), len(plant.coordinates)
    labels = [labelled(name, plant.units[name]) for name in names]
    labels += [labelled(name, unit) for name, unit, _ in changing]
    labels = labels[:MOST_CURVES]
    rows = 2 if len(labels) <= 8 else 3
    columns = -(-len(labels) // rows)
    axes: list[Axes] = []
    for i, label in enumerate(labels):
        below = "time t [s]" if i >= len(labels) - columns else ""
        place = {"ylabel": label, "xlabel": below, "xlim": (0.0, end)}
        axes.append(figure.add_subplot(rows, columns, 1 + i, **place))
        axes[i].xaxis.set_major_locator(MaxNLocator(nbins=5, steps=[1, 2, 5, 10]))
    lines: list[Line2D] = []
    shades = colours(replay.controller for replay in replays)
    for replay, dash in zip(replays, LINES, strict=False):
        who = replay.controller
        style: Any = {"color": shades[who], "ls": dash, "lw": 1.2, "label": who}
        courses = (*replay.run.state.T[:first], *replay.run.inputs.T)
        for i, (axis, curve) in enumerate(zip(axes, courses, strict=False)):
            thin = {"lw": 0.6} if i >= first else {}  # an input, in which noise shows
            lines += axis.plot(replay.run.time, curve, **style | thin)
    count = len(lines) // len(replays)
    drives = zip(axes[first:], plant.inputs, scenario.limits, strict=False)
    for i, (axis, name, limits) in enumerate(drives):
        for limit in limits[np.isfinite(limits)]:
            axis.axhline(limit, color=LIMIT, lw=1.0, ls=":")
        bounded = bool(np.isfinite(limits).all())  # else commands may diverge as a run falls
        until = [x.end if bounded else max(x.end - FALLING, 0.5 * x.end) for x in replays]
        usual = [
            np.abs(x.run.inputs[x.run.time < t, i]) for x, t in zip(replays, until, strict=True)
        ]
        most = 1.1 * max([*np.concatenate(usual), *np.abs(replays[0].limits(name))], default=0.0)
        axis.set_ylim(-(most or 1.0), most or 1.0)
    for axis, name in zip(axes, names, strict=False):
        for limit in replays[0].limits(name):
            axis.axhline(limit, color=LIMIT, lw=1.0, ls=":")
    for axis, (name, *_) in zip(axes[len(names) :], changing, strict=False):
        lines += axis.plot(longest.run.time, longest.run.parameters[name], color=BLACK, lw=1.2)
    handles = lines[: count * len(replays) : count]
    look: dict[str, Any] = {"ncols": 4, "frameon": False, "handlelength": 2.6}
    figure.legend(handles=handles, loc="outside upper center", **look)
    return axes, lines


def _drawn(canvas: FigureCanvasAgg) -> Picture:
    """Return what is drawn, shape (height, width, 3)."""
    canvas.draw()  # type: ignore[no-untyped-call]
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()  # type: ignore[no-untyped-call]
