import pytest

import afl_mujoco as afl
from afl_mujoco.films.replay import record
from afl_mujoco.scenario.time_steps import Deployed


@pytest.fixture(scope="session")
def growing():
    """A pole that grows from 0.3 to 0.9 m of half-length at 0.2 s, pushed at 0.3 s; 0.5 s."""
    push = afl.ForcePulse(force=-10.0, start=0.3, duration=0.1)
    values = {"cart_mass": (0.5, 2.0), "half_length": (0.3, 0.9)}
    schedule = {name: afl.staircase((0.2,), both) for name, both in values.items()}
    return afl.Scenario(name="growing", disturbances=(push,), schedule=schedule, duration=0.5)


@pytest.fixture(scope="session")
def replay(growing):
    return record(growing, afl.CONTROLLERS["adaptive"], Deployed(), 30)
