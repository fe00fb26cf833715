import pytest

import afl_mujoco as afl
from afl_mujoco.scenario.requirements import Requirements, recoveries
from afl_mujoco.simulation.judgement import judge

PUSHES = (
    afl.ForcePulse(force=5.0, start=2.0, duration=0.5),
    afl.ForcePulse(force=-5.0, start=2.4, duration=0.2), afl.Impulse(momentum=1.0, time=6.0),
)  # fmt: skip


@pytest.mark.parametrize(("asked", "message"), [
    ({"settling_time": 2.1}, "must be at most 2 s, the start of the first disturbance"),
    ({"recover_within": 3.5}, "must be at most 3.4 s, the time left after the disturbance"),
])  # fmt: skip
def test_what_a_run_could_not_show_is_refused(asked: dict[str, float], message: str) -> None:
    given = {"requirements": Requirements(**asked), "duration": 10.0}
    with pytest.raises(afl.AflMujocoError, match=message):
        afl.Scenario(name="pushed", disturbances=PUSHES, **given)


def test_rest_may_be_asked_for_until_the_first_disturbance_itself() -> None:
    """As in the example of the public face: settled by 6 s, and pushed at 6 s."""
    push, asked = afl.ForcePulse(force=1.0, start=1.0, duration=0.2), Requirements(settling_time=1)
    for angle, met in ((0.01, True), (1.0, False)):
        what = {"initial_state": {"phi": angle}, "disturbances": (push,), "requirements": asked}
        scenario = afl.Scenario(name="own", duration=2.0, **what)
        found = judge(scenario, afl.simulate_mujoco(scenario, "lqr"))
        assert [one.met for one in found if one.requirement == "settling_time"] == [met]
    # all the time that is left may be asked for, whatever its last bit
    hits = (afl.ForcePulse(force=1.0, start=3.5, duration=0.1), afl.Impulse(momentum=1.0, time=4.5))
    asked = Requirements(recover_within=0.9)  # 4.5 - 3.6 is less by a bit
    assert afl.Scenario(name="own", disturbances=hits, requirements=asked).judged


@pytest.mark.parametrize(("times", "expected"), [
    ([(2.0, 0.5), (2.4, 0.2), (6.0, 0.0)], [(2.6, 6.0), (6.0, 10.0)]),  # 0: of an impulse
    ([(2.0, 0.5), (2.5, 0.2)], [(2.7, 10.0)]),  # they touch
    ([(1.0, 2.0), (1.5, 0.5)], [(3.0, 10.0)]),  # one within the other
    ([(1.0, 2.0), (2.9, 0.0)], [(3.0, 10.0)]),
    ([(1.0, 0.1), (3.0, 0.2), (3.1, 0.5), (5.0, 0.1)], [(1.1, 3.0), (3.6, 5.0), (5.1, 10.0)]),
])  # fmt: skip
def test_disturbances_that_overlap_are_recovered_from_together(times, expected) -> None:
    hits = [afl.ForcePulse(force=5.0, start=t, duration=x) if x else
            afl.Impulse(momentum=1.0, time=t) for t, x in times]  # fmt: skip
    for given in (hits, hits[::-1]):
        assert [pytest.approx(end) for end in recoveries(10.0, tuple(given))] == expected


@pytest.mark.parametrize(("asked", "judged"), [
    ({"bands": {"phi": 0.0201}}, False), ({"target": {"z": 5.0}}, False),
    ({"ends_at": {}}, False), ({"end_stops_allowed": True}, False), ({"completes": False}, True),
    ({"max": {"z": 1.0}}, True), ({"settling_time": 1.0}, True),
], ids=str)  # fmt: skip
def test_what_only_says_how_rest_is_measured_asks_for_nothing(asked, judged: bool) -> None:
    rail = afl.Imperfections(end_stops={"z": 1.0})
    assert not afl.Scenario(name="own", imperfections=rail).judged
    found = afl.Scenario(name="own", imperfections=rail, requirements=Requirements(**asked))
    assert found.judged == judged
