"""An arm that its motor holds out against gravity: margins and LQR where inputs act at rest."""

import math
from dataclasses import replace

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.control.own import PythonController
from afl_mujoco.simulation.bound_controllers import bound
from afl_mujoco.studies import margins
from afl_mujoco.studies.margins import MEASURED, START, Request, decays, run

MODEL = """<mujoco><option integrator="RK4"/><worldbody><body>
<joint name="arm" axis="0 1 0" damping="0.02"/>
<inertial pos="0 0 -0.4" mass="1.5" diaginertia="0.08 0.08 0.01"/></body></worldbody>
<actuator><motor name="motor" joint="arm"/></actuator></mujoco>"""
HOLDING = 9.81 * 1.5 * 0.4  # at a quarter turn from hanging [N m]

PLANT = afl.Plant(
    name="held-arm",
    model=MODEL,
    coordinates=("arm",),
    inputs=("motor",),
    upright=(math.pi / 2.0,),
)
HARDWARE = {"control_period": 0.005, "delay": 0.003, "lag": 0.004}
SCENARIO = afl.Scenario(
    name="out",
    plant=PLANT,
    duration=2.0,
    imperfections=afl.Imperfections(**HARDWARE),
    requirements=afl.Requirements(max={"arm": 0.5}, bands={"arm": 0.05}),
)


class Remembering:
    """PD about the holding torque, with a memory that changes nothing."""

    def __init__(self) -> None:
        self.calls = 0

    def __call__(self, time, state, belief):
        self.calls += 1
        return HOLDING + 20.0 * (math.pi / 2.0 - state[0]) - 2.0 * state[1]


@pytest.mark.slow
def test_margins_hold_where_inputs_act_at_rest_and_what_remembers_is_stable(monkeypatch) -> None:
    monkeypatch.setattr(margins, "DURATION", 6.0)  # it moves at some rad/s
    own = PythonController(name="remembering", function=Remembering)
    lqr = afl.find_controller("lqr")
    found = run(Request(SCENARIO, [lqr, own], {}, 0.005, None, [()]))
    measured = {one.controller: one for one in found.rows if one.loop == MEASURED}
    assert measured["remembering"].stable and measured["remembering"].delay > 0.01
    (held,) = [x for x in found.rows if (x.controller, x.loop) == ("lqr", "held")]
    assert measured["lqr"].stable
    assert measured["lqr"].delay == pytest.approx(held.delay, rel=2e-3)


@pytest.mark.parametrize(("rate", "floor", "decayed"), [
    (-3.0, 1e-16, True), (-0.01, 1e-16, True), (0.01, 1e-16, False), (-3.0, 1e-6, False),
])  # fmt: skip
def test_what_has_decayed_to_round_off_decays_whatever_this_does(rate, floor, decayed) -> None:
    time = np.linspace(0.0, 20.0, 2001)
    away = np.maximum(START * np.exp(rate * time), floor * (1.0 + time))  # round-off that grows
    assert decays(np.array([away, away]).T) is decayed


def test_lqr_is_the_same_whatever_the_hardware() -> None:
    limited = replace(SCENARIO, imperfections=afl.Imperfections(input_limit=9.0))
    gains = [bound(afl.find_controller("lqr"), one).gains(()) for one in (SCENARIO, limited)]
    assert gains[0][1].tolist() == gains[1][1].tolist()
