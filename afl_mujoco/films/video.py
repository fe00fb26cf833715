"""MP4 files and pictures, written completely or not at all."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from pathlib import Path

import imageio_ffmpeg
import mediapy
import numpy as np
from numpy.typing import NDArray

from afl_mujoco.errors import FileError, GraphicsError
from afl_mujoco.execution.processes import interrupts_held
from afl_mujoco.files import atomic_file
from afl_mujoco.films.listing import MARK

QUALITY = 21
"""Constant rate factor of x264: a little better than its default."""


def write_video(
    pictures: Iterable[NDArray[np.uint8]], path: Path, size: tuple[int, int], fps: int, title: str
) -> None:
    """Write an MP4: H.264, yuv420p, playable before it has loaded completely.

    Parameters
    ----------
    pictures
        The frames, each of shape (height, width, 3).
    size
        Width and height [px], even.
    """
    mediapy.set_ffmpeg(_encoder())
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


def _encoder() -> str:
    """Return the path of ffmpeg."""
    try:
        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except RuntimeError:
        rule = "must be installed to write films; the wheel of imageio-ffmpeg contains it"
        raise GraphicsError("ffmpeg", rule) from None


def _end(writer: mediapy.VideoWriter) -> str | None:
    """Finish a video and return why it failed, if it did."""
    with contextlib.suppress(BrokenPipeError):  # data left for an encoder that has ended
        return _close(writer)
    return _close(writer)


def _close(writer: mediapy.VideoWriter) -> str | None:
    """Close a writer and return the last message of an encoder that failed."""
    try:
        writer.close()
    except RuntimeError as error:
        if writer._popen is not None:  # mediapy leaves the pipes of an encoder that failed open
            writer._popen.__exit__(None, None, None)
        said = str(error).strip().splitlines()
        return said[-1].rpartition(": ")[2].strip() or "the encoder ended early"
    return None


def write_picture(picture: NDArray[np.uint8], path: Path) -> None:
    """Write a PNG, completely or not at all.

    Parameters
    ----------
    picture
        Shape (height, width, 3).
    """
    with atomic_file(path) as temporary:
        mediapy.write_image(temporary, picture, fmt="png")
