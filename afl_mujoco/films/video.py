"""Films to make, and their MP4 files and stills, written completely or not at all."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import mediapy

from afl_mujoco.control.catalogue import digests
from afl_mujoco.control.controller import Controller
from afl_mujoco.errors import FileError, GraphicsError, InvalidValueError, writing
from afl_mujoco.files import atomic_file, hidden_folder
from afl_mujoco.films.listing import MARK, REMOVE, Entry, list_film, load_listing
from afl_mujoco.films.picture import Picture, frames
from afl_mujoco.films.replay import frame_times, record
from afl_mujoco.films.scene import require_size
from afl_mujoco.pool import interrupts_held, open_executor
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.time_steps import DEFAULT, Deployed
from afl_mujoco.values import require_distinct

MOST_RUNS, MOST_FPS = 4, 240  # largest number of runs in a film, and of frames per second
POSTER_TIME = 1.0  # instant of the poster [s], by which no film has stopped early
QUALITY = 21  # constant rate factor of x264: a little better than its default


@dataclass(frozen=True, slots=True, kw_only=True)
class Film:
    """A film of one controller on a scenario, or of several side by side."""

    scenario: Scenario
    controllers: tuple[Controller, ...]
    deployment: Deployed = DEFAULT
    size: tuple[int, int] = (1280, 720)
    fps: int = 30
    command: str = ""

    def __post_init__(self) -> None:
        require_size(self.size)
        if not 1 <= self.fps <= MOST_FPS:
            raise InvalidValueError("fps", f"must lie between 1 and {MOST_FPS}", self.fps)
        if self.length < 1:
            rule = f"must last a frame at {self.fps} frames per second"
            thing = f"scenario {self.scenario.name!r}"
            raise InvalidValueError(thing, rule, f"{self.scenario.duration} s")

    @property
    def length(self) -> int:
        """Number of frames."""
        return len(frame_times(self.scenario.duration, self.fps))

    @property
    def entry(self) -> Entry:
        """Its entry in the list of films."""
        names = tuple(controller.name for controller in self.controllers)
        name = f"{self.scenario.name}-{'-and-'.join(names)}"
        return Entry(
            file=f"{name}.mp4",
            poster=f"{name}.png",
            title=f"{self.scenario.name}, {' beside '.join(names)}",
            scenario=self.scenario.name,
            controllers=names,
            width=self.size[0],
            height=self.size[1],
            deployment=self.deployment,
            command=self.command,
            inputs=digests([self.scenario], self.controllers),
        )

    def pictures(self, indices: Iterable[int]) -> Iterator[Picture]:
        """Run what it shows, and yield some of its frames."""
        replays = [record(self.scenario, c, self.deployment, self.fps) for c in self.controllers]
        names = self.scenario.plant.inputs
        held = self.deployment.describe(names[0] if len(names) == 1 else "inputs")
        return frames(replays, held, self.size, self.fps, indices)


def side_by_side(
    scenario: Scenario,
    controllers: Sequence[Controller],
    deployment: Deployed = DEFAULT,
    **settings: Any,
) -> Film:
    """Return the film of the first `MOST_RUNS` controllers on a scenario."""
    return Film(
        scenario=scenario,
        controllers=tuple(controllers[:MOST_RUNS]),
        deployment=deployment.on(scenario),
        **settings,
    )


def plan(
    scenarios: Sequence[Scenario],
    controllers: Sequence[Controller],
    deployment: Deployed = DEFAULT,
    **settings: Any,
) -> list[Film]:
    """Return the films of some scenarios: one per controller, and several side by side."""
    casts = [[controller] for controller in controllers]
    casts += [list(controllers)] if len(controllers) > 1 else []
    planned = [side_by_side(s, cast, deployment, **settings) for s in scenarios for cast in casts]
    require_distinct("film", [film.entry.file for film in planned])
    return planned


def make_films(
    planned: Sequence[Film],
    folder: Path,
    *,
    workers: int = 1,
    progress: Callable[[int], None] = lambda films: None,
) -> list[Path]:
    """Make films on several processes, and list them in the folder.

    A film is made in a hidden folder and moved when it is complete; an interrupt leaves the films
    that were finished, which are listed, and nothing else.
    """
    load_listing(folder, REMOVE)  # a list that cannot be read is refused before anything is filmed
    workers = min(workers, len(planned))
    if workers > 1:  # else each process would draw with as many threads as there are cores
        os.environ.setdefault("LP_NUM_THREADS", str(max(1, (os.cpu_count() or 1) // workers)))
    with hidden_folder(folder, "films") as hidden, open_executor(workers) as executor:
        units = [(film, hidden) for film in planned]
        try:
            for done, (index, _) in enumerate(executor(_make, units), start=1):
                entry = planned[index].entry
                for name in (entry.poster, entry.file):
                    with writing(folder / name):
                        (hidden / name).replace(folder / name)
                list_film(folder, entry)
                progress(done)
        except FileError as error:
            thing = error.thing.replace(str(hidden), str(folder))
            raise FileError(thing, error.rule, error.value) from None
    return [folder / film.entry.file for film in planned]


def _make(unit: tuple[Film, Path]) -> None:
    film, folder = unit
    entry, poster = film.entry, min(round(POSTER_TIME * film.fps), film.length - 1)
    made = film.pictures(range(film.length))  # simulates, before a file is open

    def pictures() -> Iterator[Picture]:
        for index, picture in enumerate(made):
            if index == poster:
                with atomic_file(folder / entry.poster) as temporary:
                    mediapy.write_image(temporary, picture, fmt="png")
            yield picture

    write_video(pictures(), folder / entry.file, film.size, film.fps, entry.title)


def write_video(
    pictures: Iterable[Picture], path: Path, size: tuple[int, int], fps: int, title: str
) -> None:
    """Write an MP4: H.264, yuv420p, playable before it has loaded."""
    with contextlib.suppress(RuntimeError):  # it finds none
        mediapy.set_ffmpeg(str(imageio_ffmpeg.get_ffmpeg_exe()))
    if not mediapy.video_is_available():
        rule = "must be installed to write films; the wheel of imageio-ffmpeg contains it"
        raise GraphicsError("ffmpeg", rule, os.environ.get("IMAGEIO_FFMPEG_EXE"))
    arguments = ["-preset", "veryfast", "-movflags", "+faststart"]
    arguments += ["-metadata", f"title={title}", "-metadata", f"comment={MARK}"]
    with atomic_file(path) as temporary:
        writer = mediapy.VideoWriter(
            temporary, size[::-1], fps=fps, crf=QUALITY, ffmpeg_args=arguments
        )
        refusal = None
        try:
            with interrupts_held():  # a Ctrl-C is for this process to answer, not the encoder
                writer.__enter__()
            for picture in pictures:
                writer.add_image(picture)
        except (BrokenPipeError, RuntimeError) as error:
            refusal = str(error) if isinstance(error, RuntimeError) else "the encoder ended early"
        finally:
            refusal = _end(writer) or refusal
        if refusal:
            raise FileError(str(path), f"cannot be written: {refusal}")


def _end(writer: mediapy.VideoWriter) -> str | None:
    """Finish a video and return why it failed, if it did: the last message of its encoder."""
    try:
        with contextlib.suppress(BrokenPipeError):  # data left for an encoder that has ended
            writer.close()
            return None
        writer.close()
    except RuntimeError as error:
        if writer._popen is not None:  # mediapy leaves the pipes of an encoder that failed open
            writer._popen.__exit__(None, None, None)
        said = str(error).strip().splitlines()
        return said[-1].rpartition(": ")[2].strip() or "the encoder ended early"
    return None
