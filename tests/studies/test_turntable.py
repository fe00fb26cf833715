"""What a new user's plant showed: a wheel whose angle nothing depends on, and a pole above it."""

import inspect
from dataclasses import replace

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.control.catalogue import as_controller
from afl_mujoco.pool import open_executor
from afl_mujoco.scenario.sample_space import SampleSpace
from afl_mujoco.scenario.time_steps import DEFAULT
from afl_mujoco.simulation.bound_controllers import bound, lqr_of
from afl_mujoco.studies import attraction
from afl_mujoco.studies.shared.loop_margins import linearize, loop_margins
from afl_mujoco.studies.shared.robustness import sample, search_worst
from afl_mujoco.studies.shared.search import Budget

MODEL = """<mujoco><compiler angle="radian"/><worldbody>
<body name="pole"><joint name="pole" axis="0 1 0" damping="0.01"/>
<inertial pos="0 0 -.2" mass="1" diaginertia=".01 .01 .01"/>
<body name="wheel" pos="0 0 -.4"><joint name="wheel" axis="0 1 0" damping="0.01"/>
<inertial pos="0 0 0" mass=".5" diaginertia=".002 .002 .002"/></body></body></worldbody>
<actuator><motor name="torque" joint="wheel"/></actuator></mujoco>"""


def terms(q, v, p):
    pole = 0.01 + 1.0 * 0.2**2 + 0.5 * 0.4**2
    weight = 9.81 * (0.2 + 0.5 * 0.4) * np.sin(q[0])
    mass = ((pole + 0.002, 0.002), (0.002, 0.002))
    return mass, (weight + 0.01 * v[0], 0.01 * v[1]), ((0.0,), (1.0,))


PLANT = afl.Plant(
    name="hanging wheel", model=MODEL, coordinates=("pole", "wheel"), inputs=("torque",),
    parameters={}, write=lambda p: {}, terms=terms, upright=(0.0, 0.0), wraps=("pole",),
)  # fmt: skip
WHEEL = afl.Scenario(
    name="wheel", plant=PLANT, duration=2.0, initial_state={"pole": 0.1},
    requirements=afl.Requirements(max={"pole": 0.5}, bands={"pole": 0.02, "wheel": 3.0}),
)  # fmt: skip


def slowing(time, state, belief):
    return -0.05 * state[3]


def test_an_lqr_is_weighted_by_bands_and_a_spinning_wheel_takes_no_margin() -> None:
    assert lqr_of(WHEEL).largest == (0.5, 30.0, 2.5, 150.0)
    loop = linearize(bound(as_controller(slowing), WHEEL), WHEEL)
    assert loop.a.shape == (4, 4) and not loop.stable
    (found,) = loop_margins(loop) or [None]
    assert found is not None and found.gain_increase == np.inf
    (held,) = loop_margins(loop, 1e-3) or [None]
    assert held is not None and 0.0 < held.delay


@pytest.mark.parametrize(("old", "new", "said"), [
    ("0.01 * v[1]", "0.01 * (v[0] + v[1])", "has +0.01 pole_dot more: a relative rate in its"),
    ("+ 0.5 * 0.4**2", "", ", or "),
])  # fmt: skip
def test_a_mistake_has_its_name_or_those_that_look_alike(old, new, said) -> None:
    source = inspect.getsource(terms)
    assert source.count(old) == 1
    space: dict = {"np": np}
    exec(source.replace(old, new), space)
    headline = afl.check(replace(PLANT, terms=space["terms"]), 50).headline
    assert said in headline and "parameters that vary would tell" in headline  # here none does


def test_check_says_that_gravity_is_compensated_and_a_map_goes_half_a_turn() -> None:
    model = MODEL.replace('name="wheel" pos', 'name="wheel" gravcomp="1" pos')
    assert afl.check(PLANT, 20).headline.endswith(("e-16", "e-15"))
    assert "left out: gravity compensation" in afl.check(replace(PLANT, model=model), 20).headline
    assert attraction._reach("wheel", None, WHEEL) == pytest.approx(np.pi)


@pytest.mark.slow
def test_the_nearest_failure_of_a_scenario_that_fails_is_itself() -> None:
    strict = replace(WHEEL, requirements=afl.Requirements(max={"pole": 0.09}))
    space = SampleSpace(replace(strict, ranges={"pole": (0.0, 0.2)}))
    controller = as_controller(slowing)
    with open_executor(1) as executor:
        runs = sample([controller], space, 8, 1, DEFAULT)[controller.name]
        assert any(not run.failure for run in runs)
        how = (Budget(generations=1), DEFAULT, executor)
        *_, nearest = search_worst(controller, space, runs, 1, *how)
    assert nearest.run[0].failure and nearest.distance == 0.0


def test_a_signal_that_is_no_number_is_refused_by_its_name() -> None:
    plant = replace(PLANT, signals={"tip": lambda q, v, p: np.nan * q[0]})
    asked = afl.Requirements(min={"tip": 0.1})
    with pytest.raises(afl.AflMujocoError, match=r"^signal 'tip' must be a number along a run"):
        afl.simulate_mujoco(replace(WHEEL, plant=plant, requirements=asked), slowing)
