"""The frames of a film: one run, two side by side, four cases at once."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.films.camera import CameraPath, Frame, follow
from afl_mujoco.films.captions import (
    INK,
    QUIET,
    Text,
    backdrop,
    columns,
    endings,
    heading,
    rail_numbers,
    readouts,
    write,
)
from afl_mujoco.films.plots import draw_plots
from afl_mujoco.films.replay import Replay
from afl_mujoco.films.scene import Scene, open_scene

Picture = NDArray[np.uint8]
HALF = Frame(top=0.16, bottom=0.30, foot=0.21)
"""Where the cart-poles stay in a picture that is only a part of the film's."""

DIVIDER = (70, 80, 98)

TITLE_TIME, RESULT_TIME = 2.0, 3.0
"""How long the first and the last title frame of the showcase are shown [s]."""


@dataclass(frozen=True, slots=True)
class Shot:
    """One run's part of a picture.

    Attributes
    ----------
    replay, path, scene
        The run, the path of the camera, and the scene that draws it.
    behind
        Picture behind the scene.
    """

    replay: Replay
    path: CameraPath
    scene: Scene
    behind: Picture

    def draw(self, index: int) -> Picture:
        """Return the scene of a frame over the picture behind it."""
        return np.maximum(self.scene.draw(self.replay, index, self.path), self.behind)


def _scale(size: tuple[int, int]) -> float:
    """Return the scale of letters, 1 in a picture of 1280 x 720; they fit its width as well."""
    return min(size[1] / 720, size[0] / 1280)


def single(
    replay: Replay, held: str, size: tuple[int, int], fps: int, indices: Iterable[int]
) -> Iterator[Picture]:
    """Yield the frames of a film of one run.

    Parameters
    ----------
    size
        Width and height [px].
    """
    width, height = size
    s = _scale(size)
    behind = write(backdrop(width, height), heading(replay, held, width, height), s)
    with open_scene(replay, width, height) as scene:
        shot = Shot(replay, follow(replay, fps, width, height, Frame()), scene, behind)
        for index in indices:
            texts = rail_numbers(shot.path, index)
            texts += columns(readouts(replay, index), 28 * s, width - 8 * s, height - 28 * s, s)
            texts += endings(replay, index, 0.5 * width, 110 * s)
            yield write(shot.draw(index), texts, s)


def comparison(
    replays: Sequence[Replay], held: str, size: tuple[int, int], fps: int, indices: Iterable[int]
) -> Iterator[Picture]:
    """Yield the frames of a film of up to four runs of one scenario.

    Two are side by side above curves that grow with time; four form a square; with three, the
    curves take the fourth place.
    """
    width, height = size
    s = _scale(size)
    part = (2 * (width // 4), 2 * (height // 4))
    two = len(replays) == 2
    left = 0 if two else part[0]
    plots = draw_plots(replays, (width - left, height - part[1])) if len(replays) < 4 else None
    key = _key(held, width, s)
    head = replays[0]
    places = list(itertools.product((0, height - part[1]), (0, width - part[0])))
    with open_scene(head, *part) as scene:
        shots = _shots(replays, part, fps, scene)
        for index in indices:
            picture = np.zeros((height, width, 3), np.uint8)
            for shot, (y, x) in zip(shots, places, strict=False):
                picture[y : y + part[1], x : x + part[0]] = _part(shot, index, s)
            picture[: part[1] if two else height, part[0]] = DIVIDER
            if not two:
                picture[part[1]] = DIVIDER
            if plots is not None:
                picture[part[1] :, left:] = plots.until(float(head.time[index]))
            yield write(picture, key, s)


def showcase(
    replays: Sequence[Replay], held: str, size: tuple[int, int], fps: int, indices: Iterable[int]
) -> Iterator[Picture]:
    """Yield the frames of the showcase: four runs at once."""
    width, height = size
    s = _scale(size)
    part = (2 * (width // 4), 2 * (height // 4))
    behind = backdrop(width, height)
    with open_scene(replays[0], *part) as scene:
        shots = _shots(replays, part, fps, scene)
        for index in indices:
            picture = behind.copy()
            for shot, (row, column) in zip(shots, itertools.product((0, 1), (0, 1)), strict=True):
                y, x = row * (height - part[1]), column * (width - part[0])
                picture[y : y + part[1], x : x + part[0]] = _part(shot, index, s)
            picture[part[1]], picture[:, part[0]] = DIVIDER, DIVIDER
            yield picture


def _shots(replays: Sequence[Replay], part: tuple[int, int], fps: int, scene: Scene) -> list[Shot]:
    """Return the shots of the parts of a film, which one scene draws in turn."""
    behind = backdrop(*part)
    return [Shot(replay, follow(replay, fps, *part, HALF), scene, behind) for replay in replays]


def _part(shot: Shot, index: int, s: float) -> Picture:
    """Return a part of a picture with its title and numbers."""
    replay, width, height = shot.replay, shot.path.width, shot.path.pixel_height
    numbers = [(label.rpartition(": ")[2], value) for label, value in readouts(replay, index)]
    texts = [
        Text(20 * s, 34 * s, f"{replay.controller}", 22),
        Text(20 * s, 58 * s, replay.scenario, 14, QUIET),
        *rail_numbers(shot.path, index, 12),
        *columns(numbers, 20 * s, width, height - 12 * s, 0.8 * s),
        *endings(replay, index, 0.5 * width, 124 * s, 16),
    ]
    return write(shot.draw(index), texts, s)


def _key(held: str, width: int, s: float) -> list[Text]:
    """Return what the colours of a film with parts mean, and how the controller is deployed."""
    lines = ("solid: MuJoCo, pale rim: ideal ODE", held)
    return [
        Text(width - 20 * s, (30 + 20 * row) * s, line, 14, QUIET, "rs")
        for row, line in enumerate(lines)
    ]


def title_card(replays: Sequence[Replay], held: str, size: tuple[int, int]) -> Picture:
    """Return the showcase's first title frame."""
    width, height = size
    s = _scale(size)
    lines = (
        ("A published cart-pole controller in MuJoCo", 44, INK),
        (f"{replays[0].controller}, four schedules of mass and length", 26, INK),
        ("solid: MuJoCo, its model changed while it runs", 20, QUIET),
        ("pale rim: the paper's ideal equations", 20, QUIET),
        (held, 20, QUIET),
    )
    texts = [
        Text(0.5 * width, (250 + 56 * row) * s, text, letters, colour, "ms")
        for row, (text, letters, colour) in enumerate(lines)
    ]
    return write(backdrop(width, height), texts, s)


def result_card(replays: Sequence[Replay], size: tuple[int, int]) -> Picture:
    """Return the showcase's last title frame: how far MuJoCo is from the ideal equations."""
    width, height = size
    s = _scale(size)
    head = "Largest |MuJoCo - ideal ODE| in the frames shown"
    texts = [Text(0.5 * width, 190 * s, head, 34, anchor="ms")]
    for row, replay in enumerate(replays):
        both = replay.time <= min((end for end, _ in replay.endings), default=np.inf)
        y, apart = (280 + 62 * row) * s, replay.difference[both].max(axis=0)
        texts.append(Text(0.47 * width, y, replay.scenario, 24, anchor="rs"))
        numbers = f"{apart[0]:.0e} m   {apart[1]:.0e} rad"
        texts.append(Text(0.5 * width, y, numbers, 24, mono=True))
    note = "the error budget in the report explains it"
    texts.append(Text(0.5 * width, 570 * s, note, 18, QUIET, "ms"))
    return write(backdrop(width, height), texts, s)
