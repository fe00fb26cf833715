"""The integrator restarts at breakpoints and records how a run ends; compiled, it is SciPy's."""

import math
from dataclasses import replace

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.plants.cartpole import FALL_ANGLE
from afl_mujoco.plants.cartpole_equations import plant as cart_pole
from afl_mujoco.plants.cartpole_equations import terms
from afl_mujoco.scenario.time_steps import time_grid
from afl_mujoco.simulation import mujoco_rollout as mujoco_dynamics
from afl_mujoco.simulation import ode
from afl_mujoco.simulation.integrator import integrate, scipy_solver
from afl_mujoco.simulation.simulate import MovingTrees
from afl_mujoco.simulation.trajectory import criterion_of
from tests.feedback import feedback

TIGHT = 1e-11  # ten times the integrator's rtol, accumulated over a run of order 1
REST = afl.Scenario(name="rest", initial_state=(0, 0, 0, 0), duration=20.0)
PUSHES = (afl.ForcePulse(force=-10, start=1.5, duration=0.1), afl.Impulse(momentum=0.3, time=2.5))
SCENARIO = replace(afl.SCENARIOS["step-trapezoid"], disturbances=PUSHES, duration=2.7)
OWN = {name: replace(one, jump="momenta") for name, one in cart_pole.parameters.items()}
OWN["half_length"] = replace(OWN["half_length"], rate="enters")
STRETCHING = replace(cart_pole, name="own", parameters=OWN, accelerations=None, terms=terms)


def _run(scenario, derivative=lambda s, mass, push: (s[2], s[3], push / mass, 0.0)):
    times = time_grid(scenario, 0.25)

    def rate(time, state, segment):
        return derivative(state, segment.values_at(time)[0], segment.push[0])

    def arrive(state, before, after):
        return state + np.array([0.0, 0.0, after.impulse[0] / after.values_at(after.start)[0], 0.0])

    states, outcome = integrate(scenario, scipy_solver(rate, criterion_of(scenario)), arrive, times)
    return times, states, outcome


def test_a_pulse_is_not_missed_and_an_impulse_jumps_with_the_mass_after_the_jump():
    pulse = afl.ForcePulse(force=100.0, start=10.0003, duration=0.01)
    times, states, outcome = _run(replace(REST, disturbances=(pulse,)))
    assert (str(outcome), len(states)) == ("completed", len(times))
    # M = 1 kg: 1 m/s after the pulse, and 5 mm gained within it
    assert states[-1, 2] == pytest.approx(1.0, rel=TIGHT)
    assert states[-1, 0] == pytest.approx(0.005 + 20.0 - 10.0103, rel=TIGHT)
    assert (states[times <= 10.0003] == 0.0).all()
    heavier = REST.with_schedule(cart_mass=afl.staircase((5.0,), (1.0, 2.0)))
    times, states, _ = _run(replace(heavier, disturbances=(afl.Impulse(momentum=3.0, time=5.0),)))
    assert (states[times < 5.0] == 0.0).all() and states[-1, 2] == pytest.approx(1.5, rel=TIGHT)
    assert states[-1, 0] == pytest.approx(1.5 * 15.0, rel=TIGHT)


def test_a_fall_a_divergence_and_no_value_at_the_start_end_the_run_when_they_happen():
    scenario = replace(REST, initial_state=(0, 0, 0, 2.0))
    times, states, outcome = _run(scenario)
    assert outcome.kind == "fell" and outcome.time == pytest.approx(FALL_ANGLE / 2.0, rel=TIGHT)
    assert len(states) == (times <= outcome.time).sum() and np.isfinite(states).all()
    scenario = replace(REST, initial_state=(1.0, 0, 0, 0))
    times, states, outcome = _run(scenario, lambda s, *_: (3.0 * s[0], 0.0, 0.0, 0.0))
    assert outcome.kind == "diverged"
    assert outcome.time == pytest.approx(math.log(1e6) / 3.0, rel=1e-9)  # STATE_LIMIT
    assert len(states) == (times <= outcome.time).sum() and np.isfinite(states).all()
    calls = iter([(math.nan,) * 4] * 10_000)  # else the integrator would go on forever
    _, _, outcome = _run(REST, lambda *_: next(calls))
    assert outcome.kind != "completed" and outcome.time == 0.0


def by_scipy(scenario, controller, period=1e-2, **tolerances):
    loop = ode.Loop(scenario, MovingTrees(scenario.plant), controller)
    solver = scipy_solver(loop.derivative, criterion_of(scenario), **tolerances)
    nodes = controller.nodes_within(scenario.spans)
    return integrate(scenario, solver, loop.arrive, time_grid(scenario, period), nodes=nodes)


@pytest.mark.parametrize("name", ["adaptive-nominal", "lqr", "stretching rod"])
def test_the_reference_is_scipys_to_its_tolerance(name):
    scenario = replace(SCENARIO, plant=SCENARIO.plant if name in afl.CONTROLLERS else STRETCHING)
    controller = afl.CONTROLLERS.get(name, afl.CONTROLLERS["adaptive"])
    run = afl.simulate_ode(scenario, controller, sample_period=1e-2)
    states, outcome = by_scipy(scenario, controller)
    assert run.outcome == outcome and run.state.shape == states.shape
    assert np.abs(run.state - states).max() < 1e-11


@pytest.mark.parametrize("method", ["LSODA", "DOP853"])
@pytest.mark.filterwarnings("ignore:lsoda")
def test_a_loop_that_ends_in_no_number_has_diverged_before(method):
    asked = afl.Requirements(ends_at={})
    down = afl.Scenario(name="down", initial_state={"phi": 3.1}, duration=0.5, requirements=asked)
    run = afl.simulate_ode(down, lambda t, x, b: 5e6 if t > 0.1 else 0.0, method=method)
    assert run.outcome.kind == "diverged" and 0.09 < run.outcome.time <= 0.11
    assert np.isfinite(run.state).all()
    lean = afl.Scenario(name="lean", initial_state={"phi": 0.1}, duration=0.5)
    with pytest.raises(afl.AflMujocoError, match=r"^method must be DOP853, RK45 or LSODA where"):
        afl.simulate_ode(lean, lambda t, x, b: np.nan if x[1] > 0.2 else 0.0, method="Radau")


def test_steps_are_scipys_at_a_loose_tolerance_and_on_mujocos_dynamics():
    # where the error control decides: another step size would be seen
    controller, tolerances = afl.CONTROLLERS["adaptive"], {"rtol": 1e-5, "atol": 1e-7}
    run = afl.simulate_ode(SCENARIO, controller, sample_period=1e-2, **tolerances)
    states, _ = by_scipy(SCENARIO, controller, **tolerances)
    assert np.abs(run.state - states).max() < 1e-9
    run = afl.simulate_mujoco(SCENARIO, controller, "exact", timestep=1e-2)
    model = afl.CartPoleModel(SCENARIO.parameters_at(0.0))
    loop = mujoco_dynamics.closed_loop(model, SCENARIO, controller)
    solver, arrive = scipy_solver(loop, criterion_of(SCENARIO)), mujoco_dynamics.transition
    states, _ = integrate(SCENARIO, solver, arrive(model, SCENARIO), time_grid(SCENARIO, 1e-2))
    assert np.abs(run.state - states).max() < 1e-11


@pytest.mark.parametrize("start", [(0, 1.2, 0, 3.0), (0, -1.56, 0, -0.01), (0, 0.3, 0, 9.0)])
def test_a_fall_is_found_when_scipy_finds_it(start):
    scenario = replace(afl.SCENARIOS["nominal"], initial_state=start)
    controller = feedback(0.0, 0.0, 0.0, 0.0)
    run = afl.simulate_ode(scenario, controller)
    states, outcome = by_scipy(scenario, controller, period=1e-3)
    assert run.outcome.kind == outcome.kind == "fell"
    assert run.outcome.time == pytest.approx(outcome.time, abs=1e-11)
    assert np.abs(run.state - states).max() < 1e-9
