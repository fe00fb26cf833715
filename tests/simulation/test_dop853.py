"""The compiled DOP853 is SciPy's: the same states, falls and refusals, from the same equations."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate._ivp.common import select_initial_step

import afl_mujoco as afl
from afl_mujoco.control.controller import LINEAR
from afl_mujoco.scenario.parameters import MOMENTA, STRETCHING_ROD, ParameterChange
from afl_mujoco.scenario.sampling import time_grid
from afl_mujoco.simulation import integrator as dop853
from afl_mujoco.simulation import mujoco_rollout as mujoco_dynamics
from afl_mujoco.simulation import ode
from afl_mujoco.simulation.integrator import integrate, scipy_solver
from afl_mujoco.simulation.trajectory import criterion_of

SCENARIO = replace(
    afl.SCENARIOS["step-trapezoid"],
    disturbances=(
        afl.ForcePulse(force=-10.0, start=1.5, duration=0.1),
        afl.Impulse(momentum=0.3, time=2.5),
    ),
    duration=4.0,
)
PAPER = ParameterChange()
WHOLE = ParameterChange(dynamics=STRETCHING_ROD, jumps=MOMENTA)


def by_scipy(scenario, controller, change=PAPER, period=1e-2, **tolerances):
    loop = ode.Loop(scenario, change, None, controller)
    times = time_grid(scenario, period)
    criterion = criterion_of(scenario)
    solver = scipy_solver(loop.derivative, criterion, **tolerances)
    nodes = controller.nodes_within(scenario.spans)
    return integrate(scenario, solver, loop.arrive, times, nodes=nodes)


@pytest.mark.parametrize("change", [PAPER, WHOLE], ids=["paper", "stretching rod"])
@pytest.mark.parametrize("name", ["adaptive", "adaptive-nominal", "lqr"])
def test_the_reference_is_scipys_to_its_tolerance(name, change):
    controller = afl.CONTROLLERS[name]
    run = afl.simulate_ode(SCENARIO, controller, sample_period=1e-2, **change.describe())
    states, outcome = by_scipy(SCENARIO, controller, change)
    assert run.outcome == outcome
    assert run.state.shape == states.shape
    assert np.abs(run.state - states).max() < 1e-11


def test_steps_are_scipys_at_a_loose_tolerance_too():
    # where the error control decides: another step size would be seen
    controller, tolerances = afl.CONTROLLERS["adaptive"], {"rtol": 1e-5, "atol": 1e-7}
    run = afl.simulate_ode(SCENARIO, controller, sample_period=1e-2, **tolerances)
    states, _ = by_scipy(SCENARIO, controller, **tolerances)
    assert np.abs(run.state - states).max() < 1e-9


def test_exact_mode_is_scipys_on_mujocos_dynamics():
    controller = afl.CONTROLLERS["adaptive"]
    run = afl.simulate_mujoco(SCENARIO, controller, "exact", timestep=1e-2)
    model = afl.CartPoleModel(SCENARIO.parameters_at(0.0))
    loop = mujoco_dynamics.closed_loop(model, SCENARIO, controller, PAPER)
    solver = scipy_solver(loop, criterion_of(SCENARIO))
    arrive = mujoco_dynamics.transition(model, SCENARIO, PAPER)
    states, _ = integrate(SCENARIO, solver, arrive, time_grid(SCENARIO, 1e-2))
    assert np.abs(run.state - states).max() < 1e-11


@pytest.mark.parametrize("start", [(0, 1.2, 0, 3.0), (0, -1.56, 0, -0.01), (0, 0.3, 0, 9.0)])
def test_a_fall_is_found_when_scipy_finds_it(start):
    scenario = replace(afl.SCENARIOS["nominal"], initial_state=start)
    controller = afl.StateFeedback(
        name="none", kind=LINEAR, gains=afl.GainGrid.constant((0.0, 0.0, 0.0, 0.0))
    )
    run = afl.simulate_ode(scenario, controller)
    states, outcome = by_scipy(scenario, controller, period=1e-3)
    assert run.outcome.kind == outcome.kind == "fell"
    assert run.outcome.time == pytest.approx(outcome.time, abs=1e-11)
    assert np.abs(run.state - states).max() < 1e-9


def test_a_state_at_rest_has_no_error_and_no_number_that_is_none():
    at_rest = np.zeros((dop853.ROWS, 4))
    state = np.array([1.0, 0.0, 0.0, 0.0])
    assert dop853.error_of(0.1, at_rest, state, state, 1e-9, 1e-9) == 0.0


@pytest.mark.parametrize("size", [0.0, 1e-9, 1.0, 1e3])
@pytest.mark.parametrize("rate", [0.0, 1e-9, 1.0, 1e3])
def test_the_first_step_is_scipys(size, rate):
    state = size * np.array([1.0, -0.3, 0.5, 0.2])
    rtol, atol, longest = 1e-9, 1e-11, 0.5

    def rates(_, time, x, out):
        out[:] = rate * np.array([0.5, np.cos(x[0] + time), -x[1], 1.0])

    slopes, point = np.zeros((dop853.ROWS, 4)), np.zeros(4)
    rates(None, 0.0, state, slopes[0])

    def rate_of(time, x):
        rates(None, time, x, out := np.zeros(4))
        return out

    asked = (rate_of, 0.0, state, 1e9, longest, slopes[0].copy(), 1, 7, rtol, atol)
    ours = dop853.first_step(rates, None, 0.0, state, longest, slopes, point, rtol, atol)
    assert ours == pytest.approx(select_initial_step(*asked), rel=1e-12)


@pytest.mark.parametrize("which", range(4))
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_where_a_slope_has_no_value_no_step_is_tried(which, value):
    asked = []

    def rates(_, time, x, out):
        asked.append(time)
        out[:] = 1.0
        out[which] = value

    work, found = np.full_like(dop853.work_space(4), np.nan), np.empty((1, 4))
    limits, options = criterion_of(SCENARIO), (1e-9, 1e-9, 1.0)
    ended = dop853.solve(
        rates, None, limits, 0.0, 1.0, np.ones(4), np.ones(1), options, work, found
    )
    assert ended == (0, 0.0, dop853.STUCK)
    assert asked == [0.0]
