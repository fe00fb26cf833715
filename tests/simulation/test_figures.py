import numpy as np

import afl_mujoco as afl
from afl_mujoco.simulation.figures import draw_runs

SHORT = afl.Scenario(name="short", duration=0.2)


def test_a_figure_of_two_runs_overlays_them_in_every_panel_and_shows_their_difference() -> None:
    fixed = afl.CONTROLLERS["fixed"]
    runs = [afl.simulate_mujoco(SHORT, fixed, "sampled"), afl.simulate_ode(SHORT, fixed)]
    axes = draw_runs(runs, "two runs").axes
    assert [len(axis.lines) for axis in axes] == [2] * 5 + [4]
    assert all(axis.get_ylabel() for axis in axes)
    np.testing.assert_array_equal(axes[2].lines[1].get_ydata(), runs[1].state[:, 1])
    np.testing.assert_array_equal(axes[4].lines[0].get_ydata(), runs[0].force)
