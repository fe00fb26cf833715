"""Requirements judged: on runs made by hand, whose figures one can read off."""

import math
from dataclasses import replace

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.control.catalogue import as_controller
from afl_mujoco.plants.cartpole import CART_POLE
from afl_mujoco.scenario.imperfections import IDEAL, Imperfections
from afl_mujoco.scenario.requirements import Requirements, asked_of
from afl_mujoco.simulation.judgement import failure_of, judge, remarks_on, unit_remarks
from tests.plants.plants import known

PULSE = afl.ForcePulse(force=1.0, start=4.0, duration=1.0)
ALL = Requirements(max={
    **{"z": 2.0, "phi": 0.5, "z_dot": 3.0, "phi_dot": 4.0},
    **{"force_command": 45.0, "force": 30.0},
}, settling_time=3.0, recover_within=2.0, bands={"z": 0.1, "phi": 0.05})  # fmt: skip
SCENARIO = afl.Scenario(name="judged", disturbances=(PULSE,), duration=10.0, requirements=ALL)
RAIL = Imperfections(end_stops={"z": 2.5})
NOISY = Imperfections(noise={"phi": 1e-3, "phi_dot": 1.0})


def made(z=lambda t: 0.0 * t, phi=lambda t: 0.0 * t, force=lambda t: 1.0, command=None, end=None):
    time = np.round(np.arange(0.0, (10.0 if end is None else end) + 1e-9, 0.01), 9)
    state = np.zeros((len(time), 4))
    state[:, 0], state[:, 1] = z(time), phi(time)
    return afl.Trajectory(
        time=time, state=state, input=force(time) + 0.0 * time,
        command=(command or force)(time) + 0.0 * time,
        parameters={"cart_mass": np.ones_like(time), "half_length": np.ones_like(time)},
        outcome=afl.Outcome("completed", 10.0) if end is None else afl.Outcome("fell", end),
    )  # fmt: skip


def judged(run, **asked):
    scenario = replace(SCENARIO, requirements=replace(ALL, **asked), imperfections=RAIL)
    return {one.requirement: one for one in judge(scenario, run)}


def test_the_least_angle_is_measured_modulo_a_turn_about_its_target() -> None:
    for turns in (0, -1, 1):
        run = made(phi=lambda t, turns=turns: -0.3 + 0.0 * t + 2.0 * math.pi * turns)
        found = judged(run, min={"phi": -0.4}, ends_at={})["min.phi"]
        assert (found.value, found.margin) == pytest.approx((-0.3, 0.25))


def test_every_requirement_is_judged_in_its_unit() -> None:
    run = made(z=lambda t: -1.5 * (t < 2.0) + 1.0 * ((t >= 4.5) & (t < 6.5)),
               phi=lambda t: 0.4 * (t < 2.5), force=lambda t: -40.0 * (t < 0.02))  # fmt: skip
    found = judged(run)
    assert list(found) == [x for x in asked_of(CART_POLE) if not x.startswith("min.")]
    expected = {
        "completes": (10.0, 0.0), "max.z": (1.5, 0.25), "end_stops": (1.5, 0.4),
        "max.phi": (0.4, 0.2), "max.force_command": (40.0, 1 / 9), "max.force": (40.0, -1 / 3),
        "settling_time": (2.5, 1 / 6),
        "recover_within": (1.5, 0.25),  # from 5 s, the end of the pulse, to 6.5 s
    }  # fmt: skip
    for name, values in expected.items():
        assert (found[name].value, found[name].margin) == pytest.approx(values), name
    assert [name for name, one in found.items() if not one.met] == ["max.force"]


def test_each_requirement_fails_alone_and_without_rest_by_a_graded_measure() -> None:
    faults = {
        "max.z": {"z": lambda t: 2.1 * (t < 1.0)}, "max.phi": {"phi": lambda t: -0.6 * (t < 1.0)},
        "max.force": {"force": lambda t: 31.0 * (t > 9.0)},
        "max.force_command": {"command": lambda t: 46.0 * (t > 9.0)},
        "settling_time": {"phi": lambda t: 0.06 * (t < 3.2)},
        "recover_within": {"z": lambda t: 0.2 * ((t > 4.0) & (t < 7.3))},
    }  # fmt: skip
    for name, fault in faults.items():
        assert [k for k, one in judged(made(**fault)).items() if not one.met] == [name]
    found = judged(made(z=lambda t: 0.2 + 0.0 * t))
    rests = [found[name] for name in ("settling_time", "recover_within")]
    assert [(one.value, one.margin, one.met) for one in rests] == [(None, None, False)] * 2
    assert [one.graded for one in rests] == pytest.approx([-1.0 / 3.0, -1.5])


@pytest.mark.parametrize(("run", "asked", "failure"), [
    (made(), {}, ""), (made(end=4.0), {}, "fell"),
    (made(end=4.0), {"completes": False}, "fell"),  # what it did not show
    (made(z=lambda t: 2.6 * (t < 1.0)), {"max": {}}, "end_stops"),
    (made(z=lambda t: 2.6 * (t < 1.0)), {"max": {}, "end_stops_allowed": True}, ""),
    (made(z=lambda t: 2.1 * (t < 1.0), force=lambda t: 41.0 * (t < 1.0)), {}, "max.force"),
    (made(z=lambda t: 0.2, force=lambda t: 41.0 * (t < 1.0)), {}, "settling_time"),
])  # fmt: skip
def test_a_run_fails_by_how_it_ended_else_by_the_least_margin(run, asked, failure) -> None:
    assert failure_of(run.outcome.kind, tuple(judged(run, **asked).values())) == failure


def test_a_run_that_fell_shows_only_what_it_broke_and_had_come_to_rest_before() -> None:
    found = judged(made(phi=lambda t: t, end=1.5))
    assert (found["completes"].value, found["completes"].margin) == (1.5, -0.85)
    assert found["max.phi"].margin == pytest.approx(-2.0)
    for name in ("max.z", "max.force_command", "max.force"):
        assert (found[name].margin, found[name].met) == (None, False)
    assert not any(one.met for one in found.values())
    found = judged(made(phi=lambda t: 0.04 * (t < 9.0) + (t >= 9.0), end=9.5))
    assert found["settling_time"].met and not found["recover_within"].met


@pytest.mark.parametrize(("changes", "said", "ends"), [
    ({"encoder_step.phi": 0.15}, "encoder_step.phi, 0.15 rad, is no less", "degrees or counts"),
    ({"noise.z": 0.5}, "noise.z, 0.5 m, is no less than the 0.1 m", "in mm"),
    ({"delay": 8.0}, "the delay, 8 s, is 80 % of the run", "not in ms or Hz"),
], ids=str)  # fmt: skip
def test_a_value_in_another_unit_is_remarked_on(changes: dict, said: str, ends: str) -> None:
    (remark,) = unit_remarks(replace(SCENARIO, imperfections=IDEAL.changed(changes)), 0.001)
    assert remark.startswith(said) and remark.endswith(ends)


@pytest.mark.parametrize(("start", "force", "expected"), [
    (2.0, 0.0, "φ is at the start where a run ends, 2 rad (114.6°) from its target"),
    (0.1, math.nan, "force was nan at 0.02 s; a run ends where a command is no number, or 1e+06"),
    (0.1, 3e6, "force was 3e+06 at 0.02 s; "), (0.1, 1e6, "force was 1e+06 at 0.02 s; "),
    (1.45, math.nan, None),  # fell at once, but the pole did not lie
    (0.1, 1.0, None),
])  # fmt: skip
def test_why_a_run_ended_is_said_where_the_outcome_does_not_say_it(start, force, expected) -> None:
    def own(time, state, belief):
        return force if time > 0.015 or start > 1.4 else 0.0

    scenario = afl.Scenario(name="ends", initial_state=(0.0, start, 0.0, 0.0), duration=0.1)
    run = afl.simulate_mujoco(scenario, own, "sampled", control_period=0.02)
    found = remarks_on(run, scenario, as_controller(own))
    assert len(found) == (expected is not None)
    assert not expected or found[0].startswith(expected)


@pytest.mark.parametrize(("limit", "said"), [(20.0, "asks for up to 2"), (1e3, None)])
def test_a_drive_that_cuts_the_command_off_is_remarked_on_and_said_in_the_row(limit, said) -> None:
    asked = Requirements(max={"force": 40.0, "force_command": 25.0})
    what = {"imperfections": Imperfections(input_limit=limit), "requirements": asked}
    scenario = afl.Scenario(name="limited", initial_state=(0, 0.3, 0, 0), duration=3.0, **what)
    run = afl.simulate_mujoco(scenario, "lqr")
    found = [one for one in remarks_on(run, scenario, afl.find_controller("lqr")) if "drive" in one]
    by_name = {one.requirement: one for one in judge(scenario, run)}
    assert np.abs(run.force).max() == min(limit, np.abs(run.command).max())
    assert by_name["max.force_command"].value == np.abs(run.command).max()
    assert bool(found) == (said is not None) == (by_name["max.force"].limited > 0.0)
    assert said is None or said in found[0]


def test_a_controller_that_does_nothing_is_remarked_on() -> None:
    still = "force is 0 throughout and nothing moves: the run tests no"
    for start, said in (((0.2, 0, 0, 0), still), ((0, 0.1, 0, 0), "force is 0 throughout")):
        scenario = afl.Scenario(name="idle", initial_state=start, duration=0.1)
        run = afl.simulate_mujoco(scenario, lambda t, state, belief: 0.0, "sampled")
        (remark,) = remarks_on(run, scenario, afl.find_controller("fixed"))
        assert remark.startswith(said)


@pytest.mark.parametrize(("changes", "said"), [
    ({"imperfections": NOISY}, ""),
    ({"imperfections": replace(NOISY, differentiated=True)},
     "noise.phi_dot has no effect, because velocities are diff"),
    ({"imperfections": Imperfections(end_stops={"z": 1.5})},
     "z hits the end stop, 1.5 m from the middle, first at 2 s, short of"),
    ({"imperfections": Imperfections(end_stops={"z": 1.51})}, ""),
    ({"schedule": {"cart_mass": afl.trapezoid((8.0, 9.0, 11.0, 13.0), 1.0, 2.0)}},
     "cart_mass changes at 13 s, after"),
    ({"schedule": {"cart_mass": afl.piecewise_linear((0.0, 5.0, 12.0), (1.0, 2.0, 2.0))}}, ""),
], ids=str)  # fmt: skip
def test_what_is_odd_in_a_scenario_is_remarked_on_and_nothing_else(changes, said: str) -> None:
    run = made(z=lambda t: -1.5 * (t == 2.0))
    found = remarks_on(run, replace(SCENARIO, **changes), afl.CONTROLLERS["fixed-retuned"])
    assert len(found) == bool(said) and all(one.startswith(said) for one in found)


@pytest.mark.parametrize(("names", "unit"), [("cart", "m"), ("lower", "rad"), ("cart lower", "")])
def test_the_unit_of_end_stops_is_that_of_the_coordinates_that_have_them(names, unit) -> None:
    rails = Imperfections(end_stops=dict.fromkeys(names.split(), 1.0))
    own = afl.Scenario(name="s", plant=known("cart_double_pendulum.py:plant"), imperfections=rails)
    assert own.unit_of("end_stops") == unit


def test_what_never_left_its_bands_has_recovered_at_once_wherever_the_disturbance_ends() -> None:
    push = afl.ForcePulse(force=1e-6, start=0.2, duration=0.10037)
    asked = Requirements(recover_within=0.5)
    scenario = afl.Scenario(name="s", disturbances=(push,), requirements=asked, duration=1.0,
                            initial_state=(0.0, 0.0, 0.0, 0.0))  # fmt: skip
    (*_, judged) = judge(scenario, afl.simulate_mujoco(scenario, "lqr"))
    assert (judged.requirement, judged.value, judged.margin) == ("recover_within", 0.0, 1.0)
