"""The map of a scenario: each point is a run of the scenario from there, judged as any other."""

from dataclasses import replace

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.control.own import PythonController
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.report.terminal import to_text
from afl_mujoco.simulation.judgement import judge
from afl_mujoco.studies import attraction
from afl_mujoco.studies.attraction import run
from afl_mujoco.studies.shared.run import run_all
from tests.plants.plants import cart, known

STEP = afl.staircase([1.0], [8.0, 10.0])
RIG = afl.Scenario(
    name="rig", duration=5.0, initial_state=(0.1, 0.2, 0.0, 0.0),
    schedule={"cart_mass": STEP, "half_length": 1.5, "pole_mass": 0.2},
    disturbances=(afl.ForcePulse(force=20.0, start=2.0, duration=0.1),),
    imperfections=afl.Imperfections(control_period=0.01, delay=0.004, input_limit=150.0),
    requirements=afl.Requirements(max={"z": 1.0}),
)  # fmt: skip
PLAIN = replace(RIG, requirements=afl.Requirements(), duration=8.0)
LQR = afl.CONTROLLERS["lqr"]


def mapped(scenario, *controllers, angle=0.8, rate=2.0, count=5, **how):
    axes = (np.linspace(-most, most, count) for most in (angle, rate))
    asked = attraction.Request(scenario, controllers or (LQR,), ("phi", "phi_dot"), *axes)
    return run(asked, **how)


@pytest.mark.parametrize("scenario", [RIG, PLAIN], ids=["rig", "plain"])
def test_every_point_is_a_run_from_there(scenario) -> None:
    result = mapped(scenario, count=3)
    kinds, runs = result.kinds("lqr"), result.runs("lqr")
    assert [run.draw for run in runs] == list(range(10))
    assert replace(runs[-1], draw=0) == run_all(LQR, [scenario])[0]
    for (row, column), kind in np.ndenumerate(kinds):
        start = (0.1, result.angles[column], 0.0, result.rates[row])
        started = replace(scenario, initial_state=start)
        alone, one = afl.simulate_mujoco(started, LQR), runs[3 * row + column]
        assert (one.outcome, one.time) == (alone.outcome.kind, alone.outcome.time)
        if alone.outcome.kind != "completed":
            expected = attraction.FALLEN
        elif scenario is RIG:
            met = all(one.met for one in judge(started, alone))
            expected = attraction.GOOD if met else attraction.MISSED
        else:
            last = np.abs(alone.state[alone.time >= 7.0])
            rests = (last[:, 0] <= 0.05).all() and (last[:, 1] <= 0.02).all()
            expected = attraction.GOOD if rests else attraction.UNSETTLED
        assert kind == expected, (row, column)
    assert len(np.unique(kinds)) > 1


def test_the_cross_is_judged_for_itself_between_points_that_end_otherwise() -> None:
    result = mapped(RIG, angle=1.5, rate=4.0, count=2)
    assert (result.kinds("lqr") != attraction.GOOD).all() and not result.runs("lqr")[-1].failure
    shown = attraction.report(result)
    assert "✓ passes" in to_text(shown.blocks)
    said = "rig: of 4 starts, |φ| up to 1.5 rad and |φ′| up to 4 rad/s, lqr copes with 0 %."
    assert shown.headline == said
    cross = shown.blocks[0].draw().axes[0].lines[0]
    assert (cross.get_xdata()[0], cross.get_ydata()[0]) == (0.2, 0.0)


def test_the_reach_is_asked_for_and_ends_where_a_run_does_and_deviations_are_called_so(monkeypatch):
    asked = attraction.prepare(attraction.Options(grid=3, reach=(0.6, 1.0)))
    assert [*asked.angles, *asked.rates] == [-0.6, 0.0, 0.6, -1.0, 0.0, 1.0]
    for reach, said in (((1.6, 1.0), r"be below 1\.57 rad for phi, got 1\.6"), ((1.0,), "be two")):
        with pytest.raises(InvalidValueError, match=rf"^reach must {said}"):
            attraction.prepare(attraction.Options(reach=reach))
    target = afl.Requirements(target={"z": 0.5})
    aside = replace(PLAIN, requirements=target, disturbances=(), duration=0.1)
    axes = (np.array([-0.5, 1.5]), np.array([-1.0, 1.0]))
    result = run(attraction.Request(aside, [LQR], ("z", "phi_dot"), *axes))
    assert "|z − 0.5| up to 1 m and |φ′| up to 1 rad/s" in attraction.report(result).headline
    target = afl.Requirements(target={"shoulder": 6.2}, ends_at={})
    far = afl.Scenario(name="far", plant=known("double_pendulum.py:plant"), requirements=target)
    falls = replace(far, requirements=afl.Requirements(ends_at={"shoulder": 1.0}))
    for one, axes in ((falls, ("shoulder", "shoulder_dot")), (far, ("elbow", "elbow_dot"))):
        monkeypatch.setattr(attraction, "find_scenario", lambda name, one=one: one)
        assert attraction.prepare(attraction.Options(grid=3)).axes == axes
    about = attraction.prepare(attraction.Options(axes=("shoulder", "elbow"), grid=3)).angles
    assert about[1] == pytest.approx(6.2 - 2.0 * np.pi) and about.max() < np.pi
    short = afl.Scenario(name="short", plant=cart(joint=' range="-0.2 0.3"'))
    for x, most in ((0.1, 0.19), (-0.1, 0.095)):  # 95 % of the way to the nearer end
        rail = replace(short, requirements=afl.Requirements(target={"x": x}))
        monkeypatch.setattr(attraction, "find_scenario", lambda name, rail=rail: rail)
        found = attraction.prepare(attraction.Options(axes=("x", "x_dot"), grid=3)).angles
        assert found == pytest.approx([x - most, x, x + most])


def test_a_controller_that_fails_fails_there_only_and_a_fall_is_a_fall() -> None:
    def fragile(time, state, belief):
        if abs(state[1]) > 0.6:
            raise RuntimeError("far")
        return 0.0

    own = PythonController(name="fragile", function=fragile)
    kinds = mapped(replace(RIG, duration=0.3, disturbances=()), own).kinds("fragile")
    assert (kinds[:, [0, -1]] == attraction.FAILED).all()
    assert (kinds[2, 1:-1] == attraction.GOOD).all()
    careless = replace(PLAIN, requirements=afl.Requirements(completes=False), duration=3.0)
    kinds = mapped(careless, angle=1.5, rate=4.0, count=3).kinds("lqr")
    assert kinds[2, 2] == attraction.FALLEN and kinds[1, 1] != attraction.FALLEN
