import numpy as np
import pytest

from afl_mujoco import Scenario, staircase
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.time_steps import time_grid, whole_steps
from tests.messages import line

PERIODS = [1e-3, 2e-3, 7e-3, 0.8]


@pytest.mark.parametrize("end", [0.3, 0.25])
def test_a_scenario_without_breakpoints_gets_the_multiples_of_the_period_and_its_end(end):
    grid = time_grid(Scenario(name="x", duration=end), 0.1)
    np.testing.assert_allclose(grid, [0.0, 0.1, 0.2, end], rtol=0, atol=1e-15)


@pytest.mark.parametrize("period", PERIODS, ids=str)
def test_the_grid_holds_every_breakpoint_exactly_and_no_step_straddles_one(odd_scenario, period):
    grid = time_grid(odd_scenario, period)
    assert set(odd_scenario.breakpoints) <= set(grid.tolist())
    assert (grid[0], grid[-1]) == (0.0, odd_scenario.duration)
    widths = np.diff(grid)
    assert widths.min() > 0.0
    assert widths.max() <= period * (1 + 1e-12)  # rounding of k * period


def test_whole_steps_refuse_a_remainder_and_a_breakpoint_replaces_a_multiple():
    assert whole_steps("control_period", 0.01, "timestep", 0.001) == 10
    assert whole_steps("duration", 20.0, "timestep", 1e-3) == 20_000
    for period, timestep in ((0.01, 0.003), (0.1, 1.0)):
        said = line(f"timestep {timestep:g} s must divide control_period {period:g} s")
        with pytest.raises(InvalidValueError, match=said):
            whole_steps("control_period", period, "timestep", timestep)
    jump = Scenario(name="x", schedule={"cart_mass": staircase((0.3,), (1.0, 2.0))}, duration=0.5)
    assert 3 * 0.1 > 0.3  # but for round-off the same
    grid = time_grid(jump, 0.1)
    assert len(grid) == 6 and 0.3 in grid
    late = jump.with_schedule(cart_mass=staircase((np.nextafter(0.2, 1.0),), (1.0, 2.0)))
    assert np.diff(time_grid(late, 0.1)).min() > 0.09
