"""Nothing before an instant depends on what comes after it: of every controller, in every mode."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.control.names import ESTIMATED, INFORMED, NAMES
from afl_mujoco.scenario.belief import is_error
from afl_mujoco.scenario.imperfections import DECLARATIONS, IDEAL

CHANGE = 0.6  # when the futures part [s]


def imperfect():
    plain = {"velocity_filter": 0.01, "dry_friction.phi": 1e-3}
    found = {"seed": {"seed": 3}}
    for path, declaration in DECLARATIONS.items():
        if declaration.swept and not is_error(path):
            found[path] = declaration.swept[0].options(declaration.swept[0].reference)
        elif not is_error(path):
            drawn = declaration.drawn
            found[path] = {path: plain[path] if drawn is None else drawn.range[1]}
    found["all"] = {name: value for one in found.values() for name, value in one.items()}
    return {"ideal": IDEAL, **{name: IDEAL.changed(options) for name, options in found.items()}}


NEAR = afl.Scenario(name="near", duration=0.9, initial_state=(0.0, 0.1, 0.0, 0.0), schedule={
    "cart_mass": afl.staircase((CHANGE,), (3.0, 3.0001)),
    "half_length": afl.staircase((CHANGE,), (1.2, 1.2001)),
})  # fmt: skip
FAR = replace(NEAR, name="far", duration=1.2, schedule={
    **NEAR.schedule, "cart_mass": afl.staircase((CHANGE,), (3.0, 12.0)),
    "half_length": afl.staircase((CHANGE,), (1.2, 0.3)),
}, disturbances=(afl.ForcePulse(force=60.0, start=0.7, duration=0.1),))  # fmt: skip


def differing(controller, mode, imperfections=IDEAL):
    found = afl.find_controller(controller)
    scenarios = [replace(one, imperfections=imperfections) for one in (NEAR, FAR)]
    simulate = afl.simulate_ode if mode == "ode" else partial(afl.simulate_mujoco, mode=mode)
    runs = [simulate(one, found) for one in scenarios]
    count = int(np.searchsorted(runs[0].time, CHANGE))
    assert all(len(run.time) >= count for run in runs), [str(run.outcome) for run in runs]
    one, other = (np.c_[run.time, run.state, run.force][:count] for run in runs)
    np.testing.assert_array_equal(one[:, 0], other[:, 0])
    return one[(one != other).any(axis=1), 0]


@pytest.mark.parametrize("controller", [*NAMES, *(f"{name}{ESTIMATED}" for name in INFORMED)])
def test_two_futures_give_the_same_past_to_the_last_bit(controller):
    """With each imperfection where plant and belief meet, with all of them everywhere."""
    every = controller in ("adaptive", "lqr-estimated")
    asked = {name: x for name, x in imperfect().items() if every or name in ("ideal", "all")}
    found = {name: differing(controller, "sampled", x) for name, x in asked.items()}
    assert {name: times[0] for name, times in found.items() if len(times)} == {}


def test_a_plant_that_leaves_the_range_of_the_estimator_is_remarked_on():
    said = afl.compare(FAR, ["lqr-estimated", "lqr"]).remarks
    (remark,) = [one for key, found in said.items() for one in found if "estimator" in one]
    assert remark.startswith("M goes to 12 kg, beyond the 0.08 to 6 kg that the estimator may")
    assert remark in said[f"{FAR.name}/lqr-estimated"]


@pytest.mark.parametrize("mode", ["exact", "continuous", "ode"])
@pytest.mark.parametrize("controller", INFORMED)
def test_nor_does_the_past_of_the_other_modes_know_the_future(controller, mode):
    assert differing(controller, mode).size == 0
