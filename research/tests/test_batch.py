"""The batch against the readable path: `simulate_ode` at rtol 1e-12, one loop at a time."""

import dataclasses
import math

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.control.gains import GainFunction
from afl_mujoco.studies.verify.claims import ObjectiveScales, objective
from research.batch import LANES, PENALTY, Terms, closed_loop_terms, penalised_objective
from research.random_schedules import random_scenario
from research.scheduled import scheduled_terms

OBJECTIVE_LIMIT = 1e-5
PUBLISHED = GainFunction.published().coefficients
SCALES = ObjectiveScales(iae_z=20.9, iae_phi=1.53, max_force=96.1)
CORNERS = {
    "light and short": (0.1, 0.05, 100.0, 1.0, 110.0),
    "short, fast slope": (2.0, 0.05, 200.0, 5.0, 90.0),
    "long, slow slope": (0.1, 1.0, 200.0, 1.0, 90.0),
    "crosses the edge of the layer twice": (1.4, 1.0, 150.0, 4.9, 90.0),
}


def drawn(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    gains = rng.uniform((100.0, 1.0, 90.0), (200.0, 5.0, 110.0), (count, 3))
    return gains, rng.uniform((0.1, 0.05), (2.0, 1.0), (count, 2))


def of(terms: Terms) -> np.ndarray:
    return objective(terms.iae_z, terms.iae_phi, terms.max_force, SCALES)


def readable(loop: tuple[float, ...], duration: float = 20.0) -> float:
    mass, length, k, slope, layer = loop
    gains = afl.Gains(switching=k, slope=slope, boundary_layer=layer)
    controller = afl.AFLController(name="one", gain_function=afl.GainFunction.constant(gains))
    what = {"schedule": {"cart_mass": mass, "half_length": length}, "duration": duration}
    scenario = afl.Scenario(name="one", initial_state=(0.0, -math.pi / 3, 0.0, 0.0), **what)
    run = afl.simulate_ode(scenario, controller, sample_period=5e-4)
    peak_time = float(run.time[np.abs(run.force).argmax()]) + 5e-4
    closer = dataclasses.replace(scenario, duration=min(duration, peak_time))
    peak = np.abs(afl.simulate_ode(closer, controller, sample_period=2e-6).force).max()
    integrals = [absolute_integral(run.time, run.state[:, i], run.state[:, i + 2]) for i in (0, 1)]
    return float(objective(*integrals, peak, SCALES))


def absolute_integral(time: np.ndarray, x: np.ndarray, rate: np.ndarray) -> float:
    """Corrected trapezoidal rule on each half-millisecond; one that crosses 0 is split there."""
    h, a, b = np.diff(time), x[:-1], x[1:]
    whole = h * (a + b) / 2 + h**2 * (rate[:-1] - rate[1:]) / 12
    split = h * (a**2 + b**2) / (2 * np.maximum(np.abs(a - b), 1e-300))
    return float(np.where(a * b < 0, split, np.abs(whole)).sum())


@pytest.mark.parametrize("loop", CORNERS.values(), ids=CORNERS.keys())
@pytest.mark.parametrize("duration", [20.0, 0.4])
def test_the_objective_is_that_of_the_readable_path_also_until_a_short_horizon(loop, duration):
    terms = closed_loop_terms([loop[2:]], [loop[:2]], duration=duration)
    assert of(terms)[0] == pytest.approx(readable(loop, duration), rel=OBJECTIVE_LIMIT)


def test_the_tolerance_controls_the_error_over_the_whole_box() -> None:
    gains, plants = drawn(2000, seed=2)
    exact = of(closed_loop_terms(gains, plants, tolerance=1e-10))
    found = [of(closed_loop_terms(gains, plants, tolerance=t)) for t in (1e-4, 1e-5, 2e-6)]
    worst = [np.abs(one / exact - 1).max() for one in found]
    assert worst == sorted(worst, reverse=True) and worst[-1] < OBJECTIVE_LIMIT


def test_a_loop_does_not_depend_on_its_neighbours() -> None:
    gains, plants = drawn(3 * LANES + 5, seed=3)
    settings = {"duration": 5.0, "initial_state": (0.3, 1.0, -0.5, 2.0)}
    together = closed_loop_terms(gains, plants, **settings)
    for k in (0, LANES, 3 * LANES + 4):
        alone = closed_loop_terms(gains[k : k + 1], plants[k : k + 1], **settings)
        assert alone.iae_z[0] == together.iae_z[k] and alone.max_force[0] == together.max_force[k]


def test_lost_loops_cost_more_than_any_other_and_the_earlier_the_more() -> None:
    gains = np.random.default_rng(6).uniform((0.5, 0.5, 90.0), (60.0, 5.0, 110.0), (200, 3))
    terms = closed_loop_terms(gains, (1.0, 1.0), initial_state=(5.0, 1.5, 10.0, 5.0))
    costs = penalised_objective(terms, SCALES, 20.0)
    assert np.isfinite(costs).all() and 20 < terms.lost.sum() < 195
    assert costs[terms.lost].min() >= PENALTY > costs[~terms.lost].max()
    ended, order = terms.end_time[terms.lost], np.argsort(costs[terms.lost])
    assert (np.diff(ended[order]) <= 0.0).all()


def knots(scenarios: list[afl.Scenario]) -> list[np.ndarray]:
    both = ([s.cart_mass for s in scenarios], [s.half_length for s in scenarios])
    return [np.array([schedule.knots for schedule in those]) for those in both]


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


@pytest.mark.parametrize("index", [1, 4])  # with steps, with ramps
def test_held_gains_are_those_of_the_start(index: int) -> None:
    scenario = random_scenario(3, index)
    gains = GainFunction.published().gains(scenario.cart_mass.at(0.0), scenario.half_length.at(0.0))
    held = scheduled_terms(*knots([scenario]), PUBLISHED, 20.0, held=True)
    same = scheduled_terms(*knots([scenario]), GainFunction.constant(gains).coefficients, 20.0)
    following = scheduled_terms(*knots([scenario]), PUBLISHED, 20.0)
    assert held.iae_z == pytest.approx(same.iae_z, rel=1e-12)
    assert held.iae_z != pytest.approx(following.iae_z, rel=1e-3)


def test_threads_change_no_bit() -> None:
    schedules = knots([random_scenario(5, index) for index in range(37)])
    one, three = (scheduled_terms(*schedules, PUBLISHED, 20.0, threads=n) for n in (1, 3))
    for name in ("iae_z", "iae_phi", "peak_force", "max_force", "lost"):
        np.testing.assert_array_equal(getattr(one, name), getattr(three, name))
