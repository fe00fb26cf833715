"""The text over a scene: what runs, the current numbers, what the colours mean."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from afl_mujoco.films.camera import NUMBERS_Y, NUMBERS_Z, CameraPath
from afl_mujoco.films.overlays import GHOST, marks
from afl_mujoco.films.replay import Replay
from afl_mujoco.simulation.decor import BAR, FORCE, PUSH

Rgb = tuple[int, int, int]
INK: Rgb = (238, 241, 246)
QUIET: Rgb = (164, 172, 186)
WARNING: Rgb = (255, 176, 102)
POLE: Rgb = (217, 115, 38)
TOP, BOTTOM = (8, 10, 15), (33, 41, 56)
"""Gradient behind the scene, that of the sky of ``models/scene.xml``."""

_DESIGN_HEIGHT = 720
"""Height of the picture for which the sizes of letters are given [px]."""

_SMALLEST_LETTER = 10


@dataclass(frozen=True, slots=True)
class Text:
    """A piece of text.

    Attributes
    ----------
    x, y
        Position of its anchor [px].
    text
        The text.
    size
        Height of the letters at `_DESIGN_HEIGHT` [px].
    colour
        Colour of the letters.
    anchor
        Pillow's anchor: ``"ls"`` left on the baseline, ``"ms"`` in the middle, ``"rs"`` right.
    mono
        Whether all letters are equally wide, for numbers that change.
    """

    x: float
    y: float
    text: str
    size: int = 18
    colour: Rgb = INK
    anchor: str = "ls"
    mono: bool = False


def backdrop(width: int, height: int) -> NDArray[np.uint8]:
    """Return the gradient behind a scene, shape (height, width, 3).

    A scene is drawn on black; the brighter of the two is shown.

    Parameters
    ----------
    width, height
        Size of the picture [px].
    """
    share = np.linspace(0.0, 1.0, height)[:, None]
    column = np.array(TOP) * (1.0 - share) + np.array(BOTTOM) * share
    return np.ascontiguousarray(
        np.broadcast_to(column.round().astype(np.uint8)[:, None, :], (height, width, 3))
    )


def write(picture: NDArray[np.uint8], texts: Iterable[Text], scale: float) -> NDArray[np.uint8]:
    """Return the picture with texts on it.

    Parameters
    ----------
    picture
        The picture, shape (height, width, 3).
    """
    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    for t in texts:
        font = _font(max(_SMALLEST_LETTER, round(t.size * scale)), t.mono)
        draw.text((t.x, t.y), t.text, font=font, fill=t.colour, anchor=t.anchor)
    return np.asarray(image)


def heading(replay: Replay, held: str, width: int, height: int) -> list[Text]:
    """Return the text that stays over a film: what runs, and the legend.

    Parameters
    ----------
    width, height
        Size of the picture [px].
    """
    s = height / _DESIGN_HEIGHT
    legend = (
        ("solid: MuJoCo", POLE),
        (f"pale rim: {replay.ghost}", _rgb(GHOST)),
        ("force F of the controller (length ~ √F)", _rgb(FORCE)),
        ("disturbance D", _rgb(PUSH)),
    )
    return [
        Text(28 * s, 46 * s, f"{replay.scenario}, {replay.controller}", 28),
        Text(28 * s, 76 * s, held, 16, QUIET),
        *(
            Text(width - 28 * s, (40 + 23 * row) * s, text, 16, colour, "rs")
            for row, (text, colour) in enumerate(legend)
        ),
    ]


def readouts(replay: Replay, index: int) -> list[tuple[str, str]]:
    """Return the numbers of a frame with their labels."""
    apart, other = replay.difference[index], replay.ghost.removeprefix("ideal ")
    return [
        ("t [s]", f"{replay.time[index]:.2f}"),
        ("M [kg]", f"{replay.cart_mass[index]:.2f}"),
        ("l [m]", f"{replay.half_length[index]:.2f}"),
        ("F [N]", f"{replay.force[index]:+.2f}"),
        ("D [N]", f"{replay.push[index]:+.0f}" if replay.push[index] else "0"),
        (f"MuJoCo-{other}: |Δz| [m]", f"{apart[0]:.0e}" if apart[0] else "0"),
        ("|Δφ| [rad]", f"{apart[1]:.0e}" if apart[1] else "0"),
    ]


def columns(
    numbers: list[tuple[str, str]], left: float, right: float, baseline: float, s: float
) -> list[Text]:
    """Return readouts as columns, the label over the number.

    Parameters
    ----------
    left, right, baseline
        Where the columns go [px].
    """
    weights = np.array([max(len(label), 1.25 * len(value)) + 2.0 for label, value in numbers])
    places = left + (right - left) * np.concatenate([[0.0], np.cumsum(weights / weights.sum())])
    texts = []
    for x, (label, value) in zip(places.tolist(), numbers, strict=False):
        texts.append(Text(x, baseline - 32 * s, label, 16, QUIET))
        texts.append(Text(x, baseline, value, 24, mono=True))
    return texts


def rail_numbers(path: CameraPath, index: int, size: int = 15) -> list[Text]:
    """Return the distances along the rail as texts at their positions."""
    places = np.array(marks(path, index, 2.0 * BAR))
    spots = path.project(index, places, NUMBERS_Y, np.full(places.shape, NUMBERS_Z))
    return [
        Text(x, y, f"{round(place)} m", size, QUIET, "mt")
        for place, (x, y) in zip(places.tolist(), spots.tolist(), strict=True)
        if 0.0 < x < path.width
    ]


def endings(replay: Replay, index: int, x: float, y: float, size: int = 20) -> list[Text]:
    """Return the text about runs that have ended before a frame.

    Parameters
    ----------
    x, y
        Middle of the text [px].
    """
    said = [text for time, text in replay.endings if replay.time[index] >= time]
    return [Text(x, y, "; ".join(said), size, WARNING, "ms")] if said else []


def _rgb(colour: tuple[float, float, float, float]) -> Rgb:
    """Return a colour of the scene as one of a text."""
    red, green, blue = (round(255 * part) for part in colour[:3])
    return red, green, blue


@cache
def _font(size: int, mono: bool) -> ImageFont.FreeTypeFont:
    """Return a font of matplotlib's, which has the Greek letters."""
    folder = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    return ImageFont.truetype(folder / f"DejaVuSans{'Mono' if mono else ''}.ttf", size)
