"""The time grid: every breakpoint is in it, each step's parameters are those of its inside."""

import numpy as np
import pytest

from afl_mujoco import Scenario, staircase
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.sampling import time_grid, whole_steps

PERIODS = [1e-3, 2e-3, 7e-3, 0.8]


def test_a_scenario_without_breakpoints_gets_the_multiples_of_the_period():
    grid = time_grid(Scenario(name="x", duration=0.5), 0.1)
    np.testing.assert_allclose(grid, [0.0, 0.1, 0.2, 0.3, 0.4, 0.5], rtol=0, atol=1e-15)


def test_a_horizon_that_is_no_multiple_ends_with_a_short_step():
    grid = time_grid(Scenario(name="x", duration=0.25), 0.1)
    np.testing.assert_allclose(grid, [0.0, 0.1, 0.2, 0.25], rtol=0, atol=1e-15)


@pytest.mark.parametrize("period", PERIODS, ids=str)
def test_the_grid_holds_every_breakpoint_exactly_and_no_step_straddles_one(odd_scenario, period):
    grid = time_grid(odd_scenario, period)
    assert set(odd_scenario.breakpoints) <= set(grid.tolist())
    assert (grid[0], grid[-1]) == (0.0, odd_scenario.duration)
    widths = np.diff(grid)
    assert widths.min() > 0.0
    assert widths.max() <= period * (1 + 1e-12)  # rounding of k * period


def test_whole_steps_counts_and_refuses_a_remainder():
    assert whole_steps("control_period", 0.01, "timestep", 0.001) == 10
    assert whole_steps("duration", 20.0, "timestep", 1e-3) == 20_000
    with pytest.raises(InvalidValueError) as caught:
        whole_steps("control_period", 0.01, "timestep", 0.003)
    assert str(caught.value) == "timestep 0.003 s must divide control_period 0.01 s"
    with pytest.raises(InvalidValueError, match=r"^timestep 1 s must divide control_period 0.1 s$"):
        whole_steps("control_period", 0.1, "timestep", 1.0)


def test_a_breakpoint_beside_a_multiple_of_the_period_replaces_it():
    jump = Scenario(name="x", schedule={"cart_mass": staircase((0.3,), (1.0, 2.0))}, duration=0.5)
    assert 3 * 0.1 > 0.3  # but for round-off the same
    grid = time_grid(jump, 0.1)
    assert len(grid) == 6 and 0.3 in grid
    late = Scenario(
        name="x",
        schedule={"cart_mass": staircase((np.nextafter(0.2, 1.0),), (1.0, 2.0))},
        duration=0.5,
    )
    assert np.diff(time_grid(late, 0.1)).min() > 0.09
