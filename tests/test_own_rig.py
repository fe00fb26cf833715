"""A rig with three controllers of one's own goes as an integration written from scratch."""

from dataclasses import replace

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.control.own import PythonController
from afl_mujoco.studies.shared.robustness import Settings
from afl_mujoco.studies.thresholds import Request
from afl_mujoco.studies.thresholds import run as find_thresholds
from tests.own_rig import Rig, move

RIG = Rig()
SCENARIO = afl.Scenario(
    name="own-rig",
    duration=RIG.duration,
    initial_state=(0.0, RIG.start, 0.0, 0.0),
    schedule={"cart_mass": RIG.cart, "half_length": RIG.half, "pole_mass": RIG.pole},
    disturbances=(afl.ForcePulse(force=RIG.push[0], start=RIG.push[1], duration=RIG.push[2]),),
    imperfections=afl.Imperfections(
        control_period=RIG.period,
        delay=RIG.delay,
        lag=RIG.lag,
        input_limit=RIG.limit,
        encoder_step={"z": RIG.step_z, "phi": RIG.step_phi},
        differentiated=True,
        damping={"z": RIG.rail_damping, "phi": RIG.hinge_damping},
    ),
    requirements=afl.Requirements(
        max={"force": 60.0, "force_command": 200.0}, settling_time=1.5, recover_within=1.4
    ),
)
GAINS = {
    "gentle": (9.0, -95.0, 17.0, -21.0), "firm": (14.0, -140.0, 24.0, -28.0),
    "greedy": (14.0, -420.0, 24.0, -42.0),
}  # fmt: skip


def law_of(name):
    gains = np.array(GAINS[name])

    def law(time, state, belief=None):
        return float(gains @ state)

    law.__name__ = name
    return law


@pytest.mark.parametrize("name", GAINS)
def test_states_forces_and_times_are_those_of_the_integration_from_scratch(name: str) -> None:
    """Encoders amplify round-off, a count at a time, so that the runs agree to a few counts."""
    mine, law = move(RIG, law_of(name)), law_of(name)
    run = afl.simulate_mujoco(SCENARIO, law)
    assert not mine.fell and run.outcome.kind == "completed"
    for column, most in ((0, 8.0 * RIG.step_z), (1, 3.0 * RIG.step_phi)):
        there = np.interp(run.time, mine.time, mine.state[:, column])
        assert np.abs(run.state[:, column] - there).max() <= most < 0.02 * np.ptp(there)
    found = run.metrics
    assert found["max_command"] == pytest.approx(np.abs(mine.command).max(), rel=0.02)
    assert found["max_force"] == pytest.approx(np.abs(mine.force).max(), rel=0.02)
    squared = float(np.trapezoid(mine.force**2, mine.time))
    assert found["force_squared"] == pytest.approx(squared, rel=0.02)
    limited = np.mean(np.abs(mine.command) >= RIG.limit)
    assert found["limited_share"] == pytest.approx(limited, abs=0.01)
    assert (limited > 0.0) == (name == "greedy")
    (row,) = afl.compare(SCENARIO, law, draws=1).rows
    judged = {one.requirement: one.value for one in row.requirements}
    for key, (begin, end) in (
        ("settling_time", (0.0, RIG.push[1])),
        ("recover_within", (RIG.push[1] + RIG.push[2], RIG.duration)),
    ):
        expected = mine.rest(begin, end)
        assert (judged[key] is None) == (expected is None)
        assert expected is None or judged[key] == pytest.approx(expected, abs=0.03)


@pytest.mark.slow
def test_thresholds_of_delay_and_limit_are_those_of_the_integration_from_scratch() -> None:
    free = replace(SCENARIO, requirements=afl.Requirements())
    own = PythonController(name="firm", function=law_of("firm"))
    settings = Settings(seeds=1, scan=5, tolerance=0.06)
    found = find_thresholds(Request([own], (free,), settings, ("delay", "input_limit")))
    for name, field, worse in (("delay", "delay", 1.1), ("input_limit", "limit", 1.0 / 1.1)):
        level = found.sweep(name, "firm").survives.fails_at
        falls = [move(replace(RIG, **{field: x}), law_of("firm")).fell
                 for x in (level / worse, level * worse)]  # fmt: skip
        assert falls == [False, True], name
