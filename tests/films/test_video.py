"""Films as files: they decode, have the right frames, and are whole or not there (Tier D)."""

import itertools
import math
import resource
import subprocess
from dataclasses import replace
from functools import partial

import imageio_ffmpeg
import mediapy
import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.errors import FileError
from afl_mujoco.films.listing import LISTING
from afl_mujoco.films.replay import record
from afl_mujoco.films.video import make_films, plan, side_by_side, write_video
from afl_mujoco.scenario.time_steps import Deployed
from tests.messages import line

pytestmark = pytest.mark.slow

SIZE = (256, 144)
NAMES = ("fixed", "adaptive", "lqr", "fixed-retuned", "adaptive-retuned")
CONTROLLERS = [afl.CONTROLLERS[name] for name in NAMES]


def decode(path):
    ffmpeg = imageio_ffmpeg.get_ffmpeg_exe()
    mediapy.set_ffmpeg(ffmpeg)
    about = subprocess.run([ffmpeg, "-i", path], capture_output=True, text=True, check=False).stderr
    return about, mediapy.read_video(path)


@pytest.fixture
def films(growing):
    return plan([growing], CONTROLLERS[:2], size=SIZE, fps=30)


@pytest.mark.parametrize("beside", [1, 3, 5])
def test_a_film_decodes_with_each_of_its_frames(graphics, growing, tmp_path, beside):
    film = side_by_side(growing, CONTROLLERS[:beside], size=SIZE)
    (file,) = make_films([film], tmp_path)
    about, frames = decode(file)
    assert frames.shape == (15, SIZE[1], SIZE[0], 3)
    assert all(part in about for part in ("Video: h264", "yuv420p", "30 fps")), about
    moved = [np.abs(b - a).max() for a, b in itertools.pairwise(frames.astype(int))]
    assert min(moved) > 16, "two frames in a row are the same"
    names = {LISTING, film.entry.file, film.entry.poster}
    assert {path.name for path in tmp_path.iterdir()} == names
    assert film.entry.controllers == NAMES[: min(beside, 4)]


def test_a_film_stops_a_second_after_every_run_has_fallen(graphics, growing, tmp_path):
    falling = replace(growing, initial_state=(0.0, 1.5, 0.0, 8.0), duration=3.0)
    film = side_by_side(falling, CONTROLLERS[:2], size=SIZE)
    (file,) = make_films([film], tmp_path)
    end = max(record(falling, one, Deployed(), 30).end for one in CONTROLLERS[:2])
    assert len(decode(file)[1]) == math.ceil(30 * (end + 1.0)) + 1 < film.length


def test_a_film_knows_its_limits_and_verdict_and_a_fallen_run_stands_still(growing):
    asked = afl.Requirements(max={"z": 0.05, "force": 500.0})
    stops = afl.Imperfections(end_stops={"z": 5.0})
    rail = replace(growing, requirements=asked, imperfections=stops)
    found = record(rail, CONTROLLERS[1], Deployed(), 30)
    assert found.limits("z") == [-0.05, 0.05, -5.0, 5.0]
    assert (found.limits("force"), found.limits("phi")) == ([-500.0, 500.0], [])
    assert np.abs(found.state[:, 0]).max() > 0.05 and found.verdict == "meets 3 of 4 requirements"
    tipping = replace(growing, initial_state=(0.0, 1.5, 0.0, 8.0))
    fallen = record(tipping, CONTROLLERS[0], Deployed(), 30)
    (time, said), *_ = fallen.endings
    after = fallen.time > time
    assert said.startswith("MuJoCo fell")
    assert (said in fallen.ended(0), said in fallen.ended(-1)) == (False, True)
    assert after.sum() > 5 and not fallen.inputs[after].any()
    assert not fallen.channels[after].any()
    for array in (fallen.state, fallen.values):
        assert len(np.unique(array[after], axis=0)) == 1


def test_processes_make_the_same_films_each_alone_and_side_by_side(graphics, films, tmp_path):
    one, two, counted = tmp_path / "one", tmp_path / "two", []
    for folder, workers in ((one, 1), (two, 2)):
        folder.mkdir()
        files = make_films(films, folder, workers=workers, progress=counted.append)
        names = ["fixed", "adaptive", "fixed-and-adaptive"]
        assert [file.name for file in files] == [f"growing-{name}.mp4" for name in names]
    assert counted == [1, 2, 3] * 2
    for film in films:
        name = film.entry.file
        np.testing.assert_array_equal(decode(one / name)[1], decode(two / name)[1])


def test_a_list_that_cannot_be_read_is_refused_before_anything_is_filmed(films, tmp_path):
    (tmp_path / LISTING).write_text("{}")
    with pytest.raises(FileError, match=r"films\.json does not list films: .*: remove it"):
        make_films(films, tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == [LISTING]


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
    limit = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (20_000, 20_000))

    def limited(*args, **kwargs):
        return real(*args, **{**kwargs, "preexec_fn": limit})

    monkeypatch.setattr(subprocess, "Popen", limited)
    rng = np.random.default_rng(0)
    noise = (rng.integers(0, 255, (144, 256, 3)).astype(np.uint8) for _ in range(200))
    with pytest.raises(FileError, match=line(..., "film.mp4 cannot be written: ", ...)):
        write_video(noise, tmp_path / "film.mp4", SIZE, 30, "film")
    assert list(tmp_path.iterdir()) == []
