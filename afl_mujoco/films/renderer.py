"""Rendering of films, on several processes."""

from __future__ import annotations

import contextlib
import itertools
import os
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.errors import FileError, InvalidValueError
from afl_mujoco.execution.executors import open_executor
from afl_mujoco.files import hidden_folder
from afl_mujoco.films import film as films
from afl_mujoco.films.listing import REMOVE, list_film, load_listing
from afl_mujoco.films.plan import COMPARISON, SHOWCASE, SINGLE, Film
from afl_mujoco.films.replay import Replay, record
from afl_mujoco.films.video import write_picture, write_video

POSTER_TIME = 1.2
"""Instant of the poster of a film [s], at which the pole is moving."""

Picture = NDArray[np.uint8]
Unit = tuple[Film, Path]


def write_stills(planned: Sequence[Film], time: float, folder: Path) -> list[Path]:
    """Write the frame of each film that is nearest to an instant.

    Parameters
    ----------
    time
        The instant [s].
    """
    for film in planned:
        last = (film.running - 1) / film.fps
        if not 0.0 <= time <= last:
            raise InvalidValueError("still", f"must lie between 0 and {last:g} s", time)
    files = []
    for film in planned:
        picture = next(_scenes(film, _record(film), [round(time * film.fps)]))
        files.append(folder / film.poster)
        write_picture(picture, files[-1])
    return files


def render_film(film: Film, folder: Path, progress: Callable[[], None] = lambda: None) -> None:
    """Write a film and its poster."""
    replays = _record(film)
    poster = min(round(POSTER_TIME * film.fps), film.running - 1)

    def running() -> Iterator[Picture]:
        for index, picture in enumerate(_scenes(film, replays, range(film.running))):
            if index == poster:
                write_picture(picture, folder / film.poster)
            yield picture

    def counted() -> Iterator[Picture]:
        for picture in _with_cards(film, replays, running()):
            yield picture
            progress()

    write_video(counted(), folder / film.file, film.size, film.fps, film.title)


def make_films(
    planned: Sequence[Film],
    folder: Path,
    *,
    workers: int = 1,
    progress: Callable[[int], None] = lambda frames: None,
) -> list[Path]:
    """Make films, and list them in the folder.

    A film is made in a hidden folder and moved when it is complete; an interrupt leaves the films
    that were finished, which are listed, and nothing else.
    """
    workers = min(workers, len(planned))
    if workers > 1:  # else each process would draw with as many threads as there are cores
        os.environ.setdefault("LP_NUM_THREADS", str(max(1, (os.cpu_count() or 1) // workers)))
    load_listing(folder, REMOVE)  # a list that cannot be read is refused before anything is filmed
    with hidden_folder(folder, "films") as hidden:
        done = itertools.count(1)
        each = (lambda: progress(next(done))) if workers == 1 else None
        try:
            with contextlib.closing(_made(planned, hidden, workers, each)) as made:
                for film in made:
                    _publish(film, hidden, folder)
                    if each is None:
                        for _ in range(film.frames):
                            progress(next(done))
        except FileError as error:
            raise FileError(
                error.thing.replace(str(hidden), str(folder)), error.rule, error.value
            ) from None
    return [folder / film.file for film in planned]


def _made(
    planned: Sequence[Film], folder: Path, workers: int, each: Callable[[], None] | None
) -> Generator[Film]:
    """Make films and yield each as it is done."""
    if each is not None:
        for film in planned:
            render_film(film, folder, each)
            yield film
        return
    units = [(film, folder) for film in planned]
    with open_executor(workers) as executor:
        for index, _ in executor(_shoot_unit, units):
            yield planned[index]


def _shoot_unit(unit: Unit) -> None:
    """Make a film in a separate process."""
    render_film(*unit)


def _record(film: Film) -> list[Replay]:
    """Return the runs of a film."""
    if film.replay is not None:
        return [film.replay]
    return [record(s, c, film.deployment, film.fps) for s, c in film.runs]


def _scenes(film: Film, replays: Sequence[Replay], indices: Iterable[int]) -> Iterator[Picture]:
    """Return the frames of a film without the title frames."""
    held = film.deployment.describe()
    if film.kind == SINGLE:
        return films.single(replays[0], held, film.size, film.fps, indices)
    several = films.comparison if film.kind == COMPARISON else films.showcase
    return several(replays, held, film.size, film.fps, indices)


def _with_cards(
    film: Film, replays: Sequence[Replay], scenes: Iterable[Picture]
) -> Iterable[Picture]:
    """Return all frames of a film: those of a showcase are between title frames."""
    if film.kind != SHOWCASE:
        return scenes
    title = films.title_card(replays, film.deployment.describe(), film.size)
    results = films.result_card(replays, film.size)
    before, after = film.title_frames
    return itertools.chain(
        itertools.repeat(title, before), scenes, itertools.repeat(results, after)
    )


def _publish(film: Film, hidden: Path, folder: Path) -> None:
    """Move a film to its folder, and list it."""
    for name in (film.poster, film.file):
        try:
            (hidden / name).replace(folder / name)
        except OSError as error:
            raise FileError.cannot_be("written", folder / name, error) from None
    list_film(folder, film.entry)
