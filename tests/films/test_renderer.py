"""Films as files: they decode, have the right frames, and are whole or not there (Tier D)."""

from __future__ import annotations

import itertools
import resource
import subprocess
from dataclasses import replace

import imageio_ffmpeg
import mediapy
import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.errors import FileError, InvalidValueError
from afl_mujoco.films.film import RESULT_TIME, TITLE_TIME
from afl_mujoco.films.listing import LISTING, load_listing
from afl_mujoco.films.plan import COMPARISON, SHOWCASE, SINGLE, plan
from afl_mujoco.films.renderer import make_films, write_stills
from afl_mujoco.films.replay import Deployment, record
from afl_mujoco.films.video import write_video

pytestmark = pytest.mark.slow

SIZE = (256, 144)
CONTROLLERS = [afl.CONTROLLERS[name] for name in ("fixed", "adaptive")]


def decode(path):
    """Return what ffmpeg says of a film, and its frames, shape (N, height, width, 3)."""
    ffmpeg = imageio_ffmpeg.get_ffmpeg_exe()
    mediapy.set_ffmpeg(ffmpeg)
    about = subprocess.run([ffmpeg, "-i", path], capture_output=True, text=True, check=False).stderr
    return about, mediapy.read_video(path)


@pytest.fixture
def films(growing):
    four = [replace(growing, name=f"growing-{k}") for k in range(4)]
    return plan([growing], CONTROLLERS, four, size=SIZE, fps=30)


def test_every_film_decodes_with_each_of_its_frames(graphics, films, tmp_path):
    assert [film.kind for film in films] == [SINGLE, SINGLE, COMPARISON, SHOWCASE]
    counted = []
    files = make_films(films, tmp_path, progress=counted.append)
    assert counted == list(range(1, sum(film.frames for film in films) + 1))
    for film, file in zip(films, files, strict=True):
        about, frames = decode(file)
        title_frames = round(30 * (TITLE_TIME + RESULT_TIME)) if film.kind == SHOWCASE else 0
        assert len(frames) == film.frames == round(0.5 * 30) + title_frames
        assert frames.shape[1:] == (SIZE[1], SIZE[0], 3)
        assert "Video: h264" in about
        assert "yuv420p" in about
        assert "30 fps" in about
        running = frames[film.title_frames[0] : len(frames) - film.title_frames[1]].astype(int)
        moved = [np.abs(b - a).max() for a, b in itertools.pairwise(running)]
        assert min(moved) > 16, "two frames in a row are the same"
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(
        [LISTING, *(film.file for film in films), *(film.poster for film in films)]
    )


def test_the_index_keeps_what_is_there_and_says_what_it_shows(graphics, films, tmp_path):
    make_films(films[:1], tmp_path)
    make_films(films[2:3], tmp_path)
    make_films(films[:1], tmp_path)
    entries = load_listing(tmp_path)
    assert entries == tuple(sorted((films[0].entry, films[2].entry), key=lambda e: e.file))
    (tmp_path / films[0].file).unlink()
    make_films(films[2:3], tmp_path)
    assert len(load_listing(tmp_path)) == 1
    (tmp_path / LISTING).write_text("[]")
    with pytest.raises(FileError, match=r"films\.json does not list films: .*: remove it"):
        make_films(films[:1], tmp_path)


def test_processes_make_the_same_films(graphics, films, tmp_path):
    one, two = tmp_path / "one", tmp_path / "two"
    for folder, workers in ((one, 1), (two, 2)):
        folder.mkdir()
        make_films(films[:2], folder, workers=workers)
    for film in films[:2]:
        np.testing.assert_array_equal(decode(one / film.file)[1], decode(two / film.file)[1])


def test_a_still_is_the_frame_of_its_instant(graphics, films, tmp_path):
    files = write_stills(films, 0.3, tmp_path)
    assert [file.name for file in files] == [film.poster for film in films]
    with pytest.raises(InvalidValueError, match=r"still must lie between 0 and 0\.466667 s, got 9"):
        write_stills(films, 9.0, tmp_path)


@pytest.mark.parametrize(
    ("size", "fps", "message"),
    [
        ((641, 480), 30, "film width must be even, for H.264, got 641"),
        ((640, 481), 30, "film height must be even, for H.264, got 481"),
        ((3840, 2160), 30, "film width must lie between 128 and 1920 pixels, .*got 3840"),
        ((640, 32), 30, "film height must lie between 128 and 1080 pixels, .*got 32"),
        ((640, 480), 0, "fps must lie between 1 and 240, got 0"),
    ],
    ids=["odd width", "odd height", "beyond the buffer", "too small", "no frames"],
)
def test_what_cannot_be_filmed_is_refused_at_once(growing, size, fps, message):
    with pytest.raises(InvalidValueError, match=message):
        plan([growing], CONTROLLERS, size=size, fps=fps)


def test_two_films_of_one_name_are_refused(growing):
    with pytest.raises(
        InvalidValueError, match="film names must differ, got 'growing-fixed' twice"
    ):
        plan([growing], [CONTROLLERS[0], CONTROLLERS[0]], size=SIZE)


def test_a_scenario_shorter_than_a_frame_is_refused(growing):
    blink = replace(growing, disturbances=(), duration=0.01)
    with pytest.raises(InvalidValueError, match=r"must last a frame at 30 frames .*got 0\.01 s"):
        plan([blink], CONTROLLERS, size=SIZE)


def test_a_list_that_cannot_be_read_is_refused_before_anything_is_filmed(films, tmp_path):
    (tmp_path / LISTING).write_text("{}")
    with pytest.raises(FileError, match=r"films\.json does not list films: .*: remove it"):
        make_films(films, tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == [LISTING]


def test_a_run_that_has_fallen_stands_still_without_forces(growing):
    tipping = replace(growing, initial_state=(0.0, 1.5, 0.0, 8.0))
    fallen = record(tipping, CONTROLLERS[0], Deployment(), 30)
    (time, said), *_ = fallen.endings
    after = fallen.time > time
    assert said.startswith("MuJoCo fell")
    assert after.sum() > 5
    assert not fallen.force[after].any()
    assert not fallen.push[after].any()
    for array in (fallen.state, fallen.cart_mass, fallen.half_length):
        assert len(np.unique(array[after], axis=0)) == 1


def test_an_interrupt_leaves_no_half_of_a_film(tmp_path):
    def interrupted():
        yield np.zeros((144, 256, 3), np.uint8)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_video(interrupted(), tmp_path / "film.mp4", SIZE, 30, "film")
    assert list(tmp_path.iterdir()) == []


def test_a_film_that_does_not_fit_on_the_disk_is_one_line(tmp_path, monkeypatch):
    """The encoder may write 20 kB and not more, as on a disk that is full."""
    real = subprocess.Popen

    def limited(*args, **kwargs):
        def limit():
            resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))

        return real(*args, **{**kwargs, "preexec_fn": limit})

    monkeypatch.setattr(subprocess, "Popen", limited)
    rng = np.random.default_rng(0)
    noise = (rng.integers(0, 255, (144, 256, 3)).astype(np.uint8) for _ in range(200))
    with pytest.raises(FileError, match=r"film\.mp4 cannot be written: ") as refusal:
        write_video(noise, tmp_path / "film.mp4", SIZE, 30, "film")
    assert "\n" not in str(refusal.value)
    assert list(tmp_path.iterdir()) == []
