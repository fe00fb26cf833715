"""The camera follows smoothly and loses nothing that it can hold."""

from dataclasses import replace

import numpy as np
import pytest

from afl_mujoco.films.camera import NUMBERS_Y, NUMBERS_Z, TRACK, Frame, follow

FPS = 30
SIZES = [(1280, 720), (640, 360), (640, 480), (320, 1080), (1920, 200)]


def wild(replay, seed, gap=0.0):
    """Return a run of 4 s that races along the rail with any lean; its ghost `gap` metres off."""
    rng = np.random.default_rng(seed)
    count = 4 * FPS
    state = np.zeros((count, 4))
    state[:, 0] = np.cumsum(rng.uniform(-0.4, 0.4) + 0.2 * rng.standard_normal(count))
    state[:, 1] = rng.uniform(-1.2, 1.2, count)
    ideal = state + np.array([gap, 0.2, 0.0, 0.0])
    values = np.ones((count, 4))
    values[:, 2] = rng.uniform(0.05, 1.0, count)
    return replace(
        replay, time=np.arange(count) / FPS, state=state, ideal=ideal, values=values,
        inputs=np.ones((count, 1)), channels=np.ones((count, 3)),
    )  # fmt: skip


def corners(path, index, state, half_length):
    z, phi = state[:2]
    x = np.array([z, z, z - 2.0 * half_length * np.sin(phi)])
    height = np.array([0.0, TRACK, 2.0 * half_length * np.cos(phi)])
    return path.project(index, x, 0.0, height)


@pytest.mark.parametrize("size", SIZES, ids=lambda size: f"{size[0]}x{size[1]}")
@pytest.mark.parametrize("gap", [0.0, 0.5, 40.0], ids=["together", "close", "lost"])
def test_the_cart_pole_stays_in_the_frame_and_its_ghost_while_they_are_close(replay, size, gap):
    frame = Frame()
    for seed in range(3):
        run = wild(replay, seed, gap)
        path = follow(run, FPS, size, frame)
        followed = (run.state, run.ideal) if gap < 1.0 else (run.state,)
        for states in followed:
            seen = np.array([corners(path, k, x, run.half_length[k]) for k, x in enumerate(states)])
            numbers = path.project(0, path.x[:1], NUMBERS_Y, np.array([NUMBERS_Z]))
            slack = 1e-6
            assert numbers[0, 1] <= (1.0 - frame.foot) * size[1] + slack
            assert seen[..., 0].min() >= frame.side * size[0] - slack
            assert seen[..., 0].max() <= (1.0 - frame.side) * size[0] + slack
            assert seen[..., 1].min() >= frame.top * size[1] - slack
            assert seen[..., 1].max() <= (1.0 - frame.bottom) * size[1] + slack
