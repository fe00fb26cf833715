"""Many loops on schedules: their terms of (O1) are those of the equations as the paper has them."""

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.control.gains import GAIN_NAMES, GainFunction
from research.batch import closed_loop_terms
from research.random_schedules import random_scenario
from research.scheduled import scheduled_terms

PUBLISHED = GainFunction.published().coefficients


def knots(scenarios: list[afl.Scenario]) -> tuple[np.ndarray, np.ndarray]:
    return tuple(  # type: ignore[return-value]
        np.array([getattr(s, n).knots for s in scenarios]) for n in ("cart_mass", "half_length")
    )


@pytest.mark.parametrize("name", ["fixed", "adaptive"])
def test_the_terms_are_those_of_the_reference(name: str) -> None:
    scenarios = [random_scenario(3, index) for index in range(6)]
    controller = afl.CONTROLLERS[name]
    found = scheduled_terms(*knots(scenarios), controller.gain_function.coefficients, 20.0)
    here = np.transpose([found.iae_z, found.iae_phi, found.peak_force, found.max_force])
    for k, scenario in enumerate(scenarios):
        run = afl.simulate_ode(scenario, controller, sample_period=1e-3)
        assert run.outcome.kind == "completed"
        integrals = [np.trapezoid(np.abs(run.state[:, i]), run.time) for i in (0, 1)]
        expected = [*integrals, np.abs(run.force).max(), run.force.max()]
        assert here[k] == pytest.approx(expected, rel=5e-5)


@pytest.mark.parametrize("index", [1, 4, 7, 9])  # the first with steps, the others with ramps
def test_held_gains_are_those_of_the_start(index: int) -> None:
    scenario = random_scenario(3, index)
    gains = GainFunction.published().gains(scenario.cart_mass.at(0.0), scenario.half_length.at(0.0))
    constant_gains = GainFunction.constant(gains)
    held = scheduled_terms(*knots([scenario]), PUBLISHED, 20.0, held=True)
    same = scheduled_terms(*knots([scenario]), constant_gains.coefficients, 20.0)
    following = scheduled_terms(*knots([scenario]), PUBLISHED, 20.0)
    assert held.iae_z == pytest.approx(same.iae_z, rel=1e-12)
    assert held.iae_z != pytest.approx(following.iae_z, rel=1e-3)


def test_on_a_constant_plant_it_is_the_other_batch_and_threads_change_no_bit() -> None:
    plants = np.array([[0.1, 0.05], [2.0, 0.05], [0.5, 1.0]])
    gains = GainFunction.published()
    rows = [[getattr(gains.gains(*plant), name) for name in GAIN_NAMES] for plant in plants]
    expected = closed_loop_terms(rows, plants, duration=15.0)
    schedules = [np.stack([np.zeros(3), plants[:, k]], axis=1)[:, None] for k in (0, 1)]
    found = scheduled_terms(*schedules, PUBLISHED, 15.0)
    for name in ("iae_z", "iae_phi"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=5e-5)
    np.testing.assert_allclose(found.peak_force, expected.max_force, rtol=5e-5)
    schedules = knots([random_scenario(5, index) for index in range(37)])
    one, three = (scheduled_terms(*schedules, PUBLISHED, 20.0, threads=n) for n in (1, 3))
    for name in ("iae_z", "iae_phi", "peak_force", "max_force", "lost"):
        np.testing.assert_array_equal(getattr(one, name), getattr(three, name))
