"""Films as files: they decode, have the right frames, and are whole or not there (Tier D)."""

import itertools
import subprocess
from dataclasses import replace

import imageio_ffmpeg
import mediapy
import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.errors import FileError, GraphicsError
from afl_mujoco.films.listing import LISTING
from afl_mujoco.films.replay import record
from afl_mujoco.films.video import make_films, plan, side_by_side, write_video
from afl_mujoco.scenario.time_steps import Deployed

pytestmark = pytest.mark.slow

SIZE = (256, 144)
NAMES = ("fixed", "adaptive", "lqr", "fixed-retuned", "adaptive-retuned")
CONTROLLERS = [afl.CONTROLLERS[name] for name in NAMES]


def decode(path):
    ffmpeg = imageio_ffmpeg.get_ffmpeg_exe()
    mediapy.set_ffmpeg(ffmpeg)
    about = subprocess.run([ffmpeg, "-i", path], capture_output=True, text=True, check=False).stderr
    return about, mediapy.read_video(path)


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


def test_a_film_knows_its_limits_and_verdict_and_a_fallen_run_stands_still(growing):
    asked = afl.Requirements(max={"z": 0.05, "force": 500.0})
    found = record(replace(growing, requirements=asked), CONTROLLERS[1], Deployed(), 30)
    assert (found.limits("z"), found.limits("force")) == ([-0.05, 0.05], [-500.0, 500.0])
    assert np.abs(found.state[:, 0]).max() > 0.05 and found.verdict == "meets 2 of 3 requirements"
    tipping = replace(growing, initial_state=(0.0, 1.5, 0.0, 8.0))
    fallen = record(tipping, CONTROLLERS[0], Deployed(), 30)
    (time, said), *_ = fallen.endings
    after = fallen.time > time
    assert said.startswith("MuJoCo fell")
    assert (said in fallen.ended(0), said in fallen.ended(-1)) == (False, True)
    assert after.sum() > 5 and not fallen.inputs[after].any() and not fallen.channels[after].any()
    for array in (fallen.state, fallen.values):
        assert len(np.unique(array[after], axis=0)) == 1


def test_an_encoder_that_is_not_there_is_named_and_nothing_is_written(tmp_path, monkeypatch):
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", "/nowhere/ffmpeg")
    with pytest.raises(GraphicsError, match=r"ffmpeg must be installed .*, got /nowhere/ffmpeg"):
        write_video([], tmp_path / "film.mp4", SIZE, 30, "film")
    assert not [*tmp_path.iterdir()]


def test_processes_make_the_same_films_each_alone_and_side_by_side(graphics, growing, tmp_path):
    films = plan([growing], CONTROLLERS[:2], size=SIZE, fps=30)
    (tmp_path / LISTING).write_text("{}")  # is refused before anything is filmed
    with pytest.raises(FileError, match=r"films\.json does not list films: .*: remove it"):
        make_films(films, tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == [LISTING]
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
