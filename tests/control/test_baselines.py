from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.linalg import solve_continuous_lyapunov
from scipy.signal import place_poles

import afl_mujoco as afl
from afl_mujoco.control import cartpole_feedback as design
from afl_mujoco.control.controller import LINEAR, interpolated_gains
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.parameters import PlantRange
from afl_mujoco.simulation import integrator
from afl_mujoco.studies.verify.cases import Settings, closed_loop_runs
from afl_mujoco.studies.verify.checks import closed_loop_checks
from tests.feedback import force_of

BASELINES = ("lqr", "pole-placement", "partial-linearization")
PAIRS = [(m, x) for m in (0.1, 0.73, 2.0) for x in (0.05, 0.41, 1.0)]
PLANTS = [afl.CartPoleParameters(cart_mass=m, half_length=x) for m, x in PAIRS]
LARGE = {"cart_mass": 8.0, "half_length": 1.5, "pole_mass": 0.2}
HEAVY = afl.Scenario(name="large", schedule=LARGE, initial_state=(0.0, 0.3, 0.0, 0.0))


def differences(rate, point, step=1e-4):
    """Central ones: their error is of the order of the square of the step."""
    steps = step * np.eye(len(point))
    return np.stack([(rate(point + d) - rate(point - d)) / (2.0 * step) for d in steps], axis=-1)


def analytic_rate(p):
    return lambda x: np.concatenate([x[2:4], afl.acceleration(x[:4], x[4], p)])


def mujoco_rate(p):
    model = afl.CartPoleModel(p)
    m, d = model.mj_model, model.mj_data

    def rate(x):
        d.qpos[:], d.qvel[:], d.ctrl[:] = x[:2], x[2:4], x[4]
        mujoco.mj_forward(m, d)
        return np.concatenate([x[2:4], d.qacc])

    return rate


@pytest.mark.parametrize("engine", [analytic_rate, mujoco_rate])
def test_the_linear_model_is_the_derivative_of_the_plant_at_upright(engine, odd_parameters):
    for p in (odd_parameters, *PLANTS):
        both = differences(engine(p), np.zeros(5))
        model = design.upright_model(p)
        scale = np.abs(both).max()
        np.testing.assert_allclose(model.a, both[:, :4], atol=1e-6 * scale)
        np.testing.assert_allclose(model.b, both[:, 4], atol=1e-6 * scale)
    # without weight, on a cart of one kilogram, it is the partly linearised one
    light = afl.CartPoleParameters(cart_mass=1.0, pole_mass=1e-13, half_length=0.37, gravity=9.65)
    partial = design.partially_linear_model(0.37, 9.65)
    for one, other in zip(design.upright_model(light), partial, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-11)


@pytest.mark.parametrize("poles", [(-1.0, -2.0, -3.5, -9.0), (-0.5 + 1j, -0.5 - 1j, -4.0, -20.0)])
def test_the_gains_place_the_poles_as_scipy_s_do(poles, odd_parameters):
    for model in (design.upright_model(odd_parameters), design.partially_linear_model(0.29, 9.65)):
        gains = design.pole_placing_gains(model, poles)
        theirs = place_poles(model.a, model.b[:, None], poles, rtol=1e-9, maxiter=100)
        np.testing.assert_allclose(gains, theirs.gain_matrix[0], rtol=1e-8)


def test_poles_not_in_pairs_are_refused_and_no_gains_near_the_lqr_s_cost_less(odd_parameters, rng):
    model = design.upright_model(odd_parameters)
    for poles in ((-1.0, -2.0, -3.0), (-1.0, -2.0, -3.0, -1.0 + 1j)):
        with pytest.raises(InvalidValueError, match="must be four, real or in conjugate pairs"):
            design.pole_placing_gains(model, poles)
    for p in PLANTS:
        best = design.lqr_gains(p)
        least = quadratic_cost(p, best)
        for _ in range(8):
            assert quadratic_cost(p, best * (1.0 + 1e-3 * rng.standard_normal(4))) > least
    paper, own = (afl.simulate_ode("nominal", name) for name in ("fixed", "lqr"))
    peaks = np.abs(paper.state).max(axis=0)
    np.testing.assert_allclose(peaks, design.LARGEST_STATE, rtol=5e-3)  # rounded to three digits
    most, papers = np.abs(own.force).max(), np.abs(paper.force).max()
    assert most == pytest.approx(papers, rel=1e-3)  # by the choice of LARGEST_ACCELERATION


def quadratic_cost(p, gains):
    a, b = design.upright_model(p)
    force = 1.0 / (design.LARGEST_ACCELERATION * (p.cart_mass + 0.25 * p.pole_mass)) ** 2
    running = np.diag(1.0 / np.square(design.LARGEST_STATE)) + force * np.outer(gains, gains)
    return np.trace(solve_continuous_lyapunov((a - np.outer(b, gains)).T, -running))


def test_the_placed_poles_are_those_of_the_paper_s_controller_with_its_fixed_gains():
    gains = afl.FIXED_GAINS
    for p in PLANTS:
        slope = gains.slope  # the controller's own linearisation: F = -k x
        found = -differences(lambda x, p=p: afl.control_force(x, p, gains), np.zeros(4), 1e-5)
        a, b = design.upright_model(p)
        fast = 0.75 * 9.81 / p.half_length * gains.switching / gains.boundary_layer
        expected = np.poly([-slope, -slope, -slope, -fast])
        np.testing.assert_allclose(np.poly(a - np.outer(b, found)), expected, rtol=1e-6)
        placed = np.poly(a - np.outer(b, design.placed_gains(p)))
        np.testing.assert_allclose(placed, expected, rtol=1e-9)


def window(name, plant):
    told = [plant.cart_mass, plant.pole_mass, plant.half_length, plant.gravity]
    return afl.CONTROLLERS[name].inputs_for(np.array([told]))[0, 4:8]


@pytest.mark.parametrize("name", BASELINES)
def test_between_the_nodes_the_gains_are_the_plant_s_whoever_else_was_asked_for(name, rng):
    kind, how = design.DESIGNS[name]
    names, low = ("cart_mass", "half_length", "pole_mass", "gravity"), [0.1, 0.05, 0.01, 9.0]
    for plant in rng.uniform(low, [10.0, 3.0, 1.0, 10.5], (6, 4)).tolist():
        p = afl.CartPoleParameters(**dict(zip(names, plant, strict=True)))
        found = window(name, p)
        np.testing.assert_allclose(found, how.method(p), rtol=2e-4)
        partial = design.partially_linear_model(p.half_length, p.gravity)
        model = design.upright_model(p) if kind == LINEAR else partial
        assert np.linalg.eigvals(model.a - np.outer(model.b, found)).real.max() < -0.2
    whole = how.over(PlantRange((0.5, 2.0), (0.25, 1.0), 0.05, 9.81))
    nodes = [2.0 ** (k / 4.0) for k in range(-4, 1)]  # at a node, and a hair off it
    pairs = [*rng.uniform([0.5, 0.25], [2.0, 1.0], (6, 2)), *((x, x * (1 - 1e-16)) for x in nodes)]
    pairs += [(np.nextafter(x, 0.0), np.nextafter(x, 9.0)) for x in nodes[:-1]]
    for mass, length in pairs:
        alone = window(name, afl.CartPoleParameters(cart_mass=mass, half_length=length))
        np.testing.assert_array_equal(alone, interpolated_gains(*whole, mass, length))


def test_a_plant_without_gains_is_refused_and_beyond_its_nodes_a_table_has_none():
    floating = afl.CartPoleParameters(gravity=1e-12)
    with pytest.raises(InvalidValueError, match=r"^controller 'lqr': the plant must be one that"):
        force_of(afl.CONTROLLERS["lqr"], (0.0, 0.1, 0.0, 0.0), floating)
    _, how = design.DESIGNS["lqr"]
    grid = how.over(PlantRange((1.0, 2.0), (0.1, 0.9), 0.05, 9.81))
    for mass, length in ((0.5, 0.5), (4.0, 0.5), (1.5, 0.05), (1.5, 2.0)):
        assert np.isnan(interpolated_gains(*grid, mass, length)).all()
    assert np.isfinite(interpolated_gains(*grid, 1.0, 0.9)).all()


@pytest.mark.parametrize("name", [*BASELINES, "fixed", "adaptive", "adaptive-angle"])
def test_every_simulator_agrees_on_a_baseline_as_on_the_paper_s_controller(name, odd_scenario):
    runs = closed_loop_runs(odd_scenario, afl.CONTROLLERS[name], Settings(control_period=1e-3))
    checks = closed_loop_checks(odd_scenario, afl.CONTROLLERS[name], runs)
    assert {check.id for check in checks} - {"B2"} == {"A5", "B1", "B2b", "B3"}
    assert [str(check) for check in checks if not check.passed] == []


@pytest.mark.parametrize("name", BASELINES)
def test_a_ramp_across_many_nodes_does_not_part_the_simulators(name, monkeypatch):
    """M and l pass every node at one time, or but for round-off."""
    scenario, controller = afl.SCENARIOS["trapezoid-trapezoid"], afl.CONTROLLERS[name]
    scenario = replace(scenario.with_schedule(half_length=scenario.cart_mass), duration=9.0)
    ode = afl.simulate_ode(scenario, controller)
    exact = afl.simulate_mujoco(scenario, controller, "exact")
    assert np.abs(ode.state - exact.state).max() < 1e-11  # of a limit of 1e-9
    monkeypatch.setattr(integrator, "MAX_STEP", 2e-4)
    assert np.abs(ode.state - afl.simulate_ode(scenario, controller).state).max() < 3e-10


@pytest.mark.parametrize("scenario", ["step-step-impulse", "trapezoid-trapezoid", HEAVY])
@pytest.mark.parametrize("name", BASELINES)
def test_every_baseline_balances_from_the_paper_s_start_and_beyond_its_box(name, scenario):
    run = afl.simulate_mujoco(scenario, name, "sampled")
    assert str(run.outcome) == "completed" and np.abs(run.state[-1]).max() < 0.02


def test_from_eighty_degrees_the_paper_s_controller_balances_and_the_baselines_do_not():
    steep = afl.Scenario(name="steep", initial_state=(0.0, -np.radians(80.0), 0.0, 0.0))
    ends = [afl.simulate_mujoco(steep, name).outcome.kind for name in ("fixed", *BASELINES)]
    assert ends == ["completed", "fell", "fell", "fell"]
