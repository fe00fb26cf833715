"""Targets that are not 0, of coordinates that come round too: what is measured from them."""

import math
from dataclasses import replace

import gymnasium
import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.control.catalogue import find_controller
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.simulation.bound_controllers import bound
from afl_mujoco.simulation.metrics import label_of
from afl_mujoco.studies.shared.tables import how
from tests.plants.plants import PENDULUM, known

NEAR = afl.Scenario(
    name="near", plant=PENDULUM, duration=2.0, initial_state={"angle": -3.0},
    requirements=afl.Requirements(ends_at={"angle": 0.3}),
)  # fmt: skip


LEAN = afl.Scenario(name="lean", duration=1.0, initial_state={"phi": 0.1})
THERE = replace(LEAN, initial_state={"z": 1.0, "phi": 0.1},
                requirements=afl.Requirements(target={"z": 1.0}))  # fmt: skip
ARM = """<mujoco><worldbody><body><joint name="turn" axis="0 1 0"/>
  <geom pos=".2 0 0" size=".05" mass="1"/></body></worldbody>
  <actuator><motor name="big" joint="turn" ctrlrange="{0} {1}"/>
  <motor name="small" joint="turn" {2}range="-.5 .5"/></actuator></mujoco>"""


def worlds(scenario):
    settings, name = {"control_period": 0.01, "scenario": scenario}, "afl_mujoco/Scenario-v0"
    yield gymnasium.make(name, **settings)
    yield gymnasium.make_vec(name, 1, vectorization_mode="vector_entry_point", **settings)


@pytest.mark.parametrize("angle", [-3.0, 3.2])
def test_environments_end_an_episode_when_the_run_ends(angle: float) -> None:
    scenario = replace(NEAR, initial_state={"angle": angle})
    run = afl.simulate_mujoco(scenario, lambda *_: 0.0, control_period=0.01)
    ends = [math.ceil(run.outcome.time / 0.01 - 1e-6)]
    world, ticks = afl.load(scenario, control_period=0.01), 1
    world.reset()
    while not world.step([0.0]).last():
        ticks += 1
    ends.append(ticks)
    for world in worlds(scenario):
        world.reset()
        shape, ticks, ended = world.action_space.shape, 0, False
        while not ended:
            *_, ended, _, _ = world.step(np.zeros(shape))
            ticks += 1
        ends.append(ticks)
    assert run.outcome.kind == "fell" and len(set(ends)) == 1


def test_a_fall_inside_a_control_period_ends_an_episode_as_it_ends_a_run() -> None:
    """A kick there and a kick back: at neither end of the period is it far from its target."""
    kicks = [afl.Impulse(momentum=m, time=t, coordinate="angle")
             for m, t in ((20.0, 0.102), (-40.0, 0.104), (20.0, 0.106))]  # fmt: skip
    scenario = replace(NEAR, initial_state={"angle": 3.14}, disturbances=tuple(kicks))
    assert afl.simulate_mujoco(scenario, lambda *_: 0.0).outcome.time < 0.11
    for world in worlds(scenario):
        world.reset()
        shape = world.action_space.shape
        assert [bool(world.step(np.zeros(shape))[2]) for _ in range(11)] == [*[False] * 10, True]


def test_starts_are_measured_from_the_target_the_shorter_way() -> None:
    for bounds in ([3.0, 3.3], [-3.2, -3.0], [9.3, 9.5]):
        replace(NEAR, ranges={"angle": bounds})
    said = r"ranges.angle must lie between 2.842 and 3.442 rad, where a run ends, got -0.1 to 0.1"
    with pytest.raises(InvalidValueError, match=said):
        replace(NEAR, ranges={"angle": [-0.1, 0.1]})


def test_metrics_and_tables_say_from_where_a_deviation_is_measured(tmp_path) -> None:
    most = {"z": 1.0, "load_height": 1.0}
    asked = afl.Requirements(target={"z": 0.5, "load_height": -0.25}, max=most, min={"x": -1.0})
    plant = known("quadrotor_load.py:plant")
    scenario = afl.Scenario(name="lift", plant=plant, duration=0.5, requirements=asked)
    result = afl.compare(scenario, ["lqr"])
    run = afl.simulate_mujoco(scenario, "lqr")
    values = {one["requirement"]: one["value"] for one in result.requirements}
    for name, x, target in (("z", run.state[:, 1], 0.5),
                            ("load_height", run.signals["load_height"], -0.25)):  # fmt: skip
        assert values[f"max.{name}"] == run.metrics[f"peak_{name}"] == np.abs(x - target).max()
    printed, shown = str(result), {label_of(name, run.layout) for name in run.metrics}
    assert "|z − 0.5| at most 1 m" in printed and "|load_height + 0.25| at most 1 " in printed
    assert {"∫|z − 0.5| dt", "max |x|", "least load_height"} <= shown
    assert how("max.z", scenario) == "misses “|z − 0.5| at most 1 m”"
    run.save(tmp_path / "run.npz")
    assert afl.Trajectory.load(tmp_path / "run.npz").metrics == run.metrics


@pytest.mark.parametrize("simulate", [afl.simulate_ode_rk4, afl.simulate_ode_held])
def test_every_simulator_of_equations_takes_a_controller_by_its_name(simulate) -> None:
    plant = known("cart_double_pendulum.py:plant")
    lean = afl.Scenario(name="lean", plant=plant, duration=0.2, initial_state={"lower": 0.02})
    run, reference = simulate(lean, "lqr"), afl.simulate_ode(lean, "lqr")
    np.testing.assert_allclose(run.state[-1], reference.state[-1], atol=1e-3)
    with pytest.raises(InvalidValueError, match="controller 'adaptive' is of the cart-pole"):
        simulate(lean, "adaptive")


@pytest.mark.parametrize("name", ["lqr", "adaptive", "partial-linearization", "adaptive-estimated"])
def test_the_controllers_of_the_cart_pole_bring_it_to_its_target(name: str) -> None:
    for mode in ("sampled",) if name.endswith("estimated") else ("sampled", "exact", "continuous"):
        here, there = (afl.simulate_mujoco(x, name, mode) for x in (LEAN, THERE))
        np.testing.assert_allclose(there.state - here.state, [[1, 0, 0, 0]] * len(here.state),
                                   atol=1e-10)  # fmt: skip
        np.testing.assert_allclose(there.force, here.force, atol=1e-9)
        assert there.metrics.get("saturated_share") == here.metrics.get("saturated_share")
    assert there.provenance["controller"] != here.provenance["controller"]
    again = bound(bound(find_controller(name), THERE), LEAN)  # it is of no scenario before
    assert again.describe() == find_controller(name).describe()


def test_a_target_that_a_controller_cannot_have_is_refused() -> None:
    with pytest.raises(InvalidValueError, match="'adaptive-angle' brings z to 0 alone, not to a t"):
        afl.simulate_mujoco(THERE, "adaptive-angle")
    tilted = replace(LEAN, requirements=afl.Requirements(target={"phi": 0.2}))
    with pytest.raises(InvalidValueError, match="'lqr' balances upright: its target of phi must"):
        afl.compare(tilted, ["lqr"])
    afl.simulate_mujoco(tilted, lambda *_: 0.0)  # one of one's own knows where it goes


@pytest.mark.parametrize(("big", "expected"), [
    ((-9.0, 9.0), (0.2 * 9.81 - 0.25, 0.25)),  # of half of each 0.98 N m: beyond the small one
    ((-1.5, 1.5), (0.2 * 9.81 - 0.5, 0.5)),
    ((-1.4, 1.4), (0.1 * 9.81, 0.1 * 9.81)),  # nothing holds it
])  # fmt: skip
@pytest.mark.parametrize("kind", ["ctrl", "force"])
def test_inputs_that_share_a_load_share_it_as_they_can(kind, big, expected) -> None:
    """Limits below 1 cut off nothing of what an input does per unit."""
    names = {"coordinates": ("turn",), "inputs": ("big", "small"), "upright": (0.0,)}
    plant = afl.Plant(name="arm", model=ARM.format(*big, kind), **names)
    scenario = afl.Scenario(name="arm", plant=plant, duration=0.2)
    with pytest.raises(InvalidValueError, match=r"say its input \(big, small\) or its coordinate"):
        replace(scenario, disturbances=(afl.Impulse(momentum=1.0, time=0.1),))
    held, _ = bound(find_controller("lqr"), scenario).gains(np.empty(0))
    np.testing.assert_allclose(-held, expected, rtol=1e-9)
    (remarks,) = afl.compare(scenario, "lqr").remarks.values() or [()]
    said = "the drive of small is at its limit for 100 % of the run: the controller asks for "
    assert any(one.startswith(said) for one in remarks) == (big[1] < 9.0)
