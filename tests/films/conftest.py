from dataclasses import replace

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.films.replay import record
from afl_mujoco.scenario.time_steps import Deployed

FPS = 30


@pytest.fixture(scope="session")
def growing():
    """A pole that grows from 0.3 to 0.9 m of half-length at 0.2 s, pushed at 0.3 s; 0.5 s."""
    return afl.Scenario(
        name="growing",
        disturbances=(afl.ForcePulse(force=-10.0, start=0.3, duration=0.1),),
        schedule={
            "cart_mass": afl.staircase((0.2,), (0.5, 2.0)),
            "half_length": afl.staircase((0.2,), (0.3, 0.9)),
        },
        duration=0.5,
    )


@pytest.fixture(scope="session")
def replay(growing):
    return record(growing, afl.CONTROLLERS["adaptive"], Deployed(), FPS)


@pytest.fixture
def apart(replay):
    """The same, the ideal cart 0.8 m to the left and its pole turned by 0.4 rad."""
    return replace(replay, ideal=replay.state + np.array([-0.8, 0.4, 0.0, 0.0]))
