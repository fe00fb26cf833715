"""An arm that its motor holds out against gravity: margins and LQR where inputs act at rest."""

import math
from dataclasses import replace

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.simulation.bound_controllers import bound
from afl_mujoco.studies.margins import HELD, Request, run
from afl_mujoco.studies.shared.loop_margins import linearize

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


def test_margins_hold_where_inputs_act_at_rest() -> None:
    lqr = afl.find_controller("lqr")
    (held,) = run(Request(SCENARIO, [lqr], {}, 0.005)).of("lqr", HELD)
    assert HOLDING == pytest.approx(linearize(bound(lqr, SCENARIO), SCENARIO).held[0])
    for share, decays in ((0.97, True), (1.03, False)):
        late = replace(SCENARIO.imperfections, delay=HARDWARE["delay"] + share * held.delay)
        start = {"arm": math.pi / 2.0 + 1e-3}
        moved = replace(SCENARIO, initial_state=start, duration=6.0, imperfections=late)
        away = np.abs(afl.simulate_mujoco(moved, lqr).state[:, 0] - math.pi / 2.0)
        first, last = (part.max() for part in np.array_split(away, 3)[:3:2])
        assert bool(last < first) is decays


def test_lqr_is_the_same_whatever_the_hardware() -> None:
    limited = replace(SCENARIO, imperfections=afl.Imperfections(input_limit=9.0))
    gains = [bound(afl.find_controller("lqr"), one).gains(()) for one in (SCENARIO, limited)]
    assert gains[0][1].tolist() == gains[1][1].tolist()
