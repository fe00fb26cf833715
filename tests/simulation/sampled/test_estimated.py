from dataclasses import replace

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco import simulate_mujoco
from afl_mujoco.control import estimator
from afl_mujoco.control.controller import compiled_force
from afl_mujoco.control.estimator import EstimatedController, EstimatorSettings
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.time_steps import Deployed
from afl_mujoco.simulation.sampled import loop
from afl_mujoco.simulation.sampled.hardware import new_run, no_commands, sense
from afl_mujoco.simulation.sampled.runs import prepare, simulate_estimated, timing_of

REAL = afl.Imperfections(
    noise={"z": 1e-4, "phi": 5e-4}, control_period=0.002, delay=0.003, lag=0.004,
    input_limit=8.0, seed=4,
)  # fmt: skip
SETTINGS = EstimatorSettings(initial_cart_mass=0.9, initial_half_length=0.45)


@pytest.fixture
def estimating(adaptive):
    return EstimatedController(name="estimating", controller=adaptive, settings=SETTINGS)


def by_hand(scenario, controller):
    model = afl.CartPoleModel(scenario.parameters_at(0.0), imperfections=scenario.imperfections)
    run = prepare(model, scenario, controller, timing_of(scenario, model, Deployed(timestep=1e-3)))
    pending, rows = no_commands(run.actuators), np.empty((run.plan.steps + 1, 6))
    plant = (model.addresses, run.plan, run.profile, memory := new_run())
    filtering, start = estimator.new_filter(), scenario.parameters_at(0.0)
    settings = controller.settings.on(start)[0]
    loop.start(*plant, rows, run.initial_state)
    tick, command = 0, 0.0
    while memory.marks["status"] == loop.RUNNING:
        sense(model.addresses, run.sensors, memory, tick)
        z, phi = memory.measured[:2].tolist()
        if tick == 0:
            mass, length = estimator.start(filtering, settings, z, phi)
        else:
            force = max(min(command, 8.0), -8.0)
            if controller.settings.force_sensed:
                force = float(memory.drive["mean_force"][0])
            mass, length = estimator.update(filtering, settings, z, phi, force, 0.002)
        assumed_parameters = (mass, scenario.pole_mass, length, scenario.gravity)
        state = estimator.filtered_state(filtering)
        compiled = controller.estimator_for(start).compiled
        command = compiled_force(*compiled, *state, assumed_parameters)
        memory.command[0] = command
        loop.advance(*plant[:2], run.actuators, *plant[2:], pending, rows)
        tick += 1
    count = int(memory.marks["step"])
    return rows[: count + 1, :4], rows[: count + 1, 4], (mass, length)


@pytest.mark.parametrize("sensed", [False, True], ids=["commanded", "sensed"])
def test_the_compiled_loop_is_the_one_written_by_hand(odd_scenario, estimating, sensed):
    estimating = replace(estimating, settings=replace(SETTINGS, force_sensed=sensed))
    scenario = replace(odd_scenario, imperfections=REAL)
    run = simulate_mujoco(scenario, estimating, "sampled")
    states, forces, (mass, length) = by_hand(scenario, estimating)
    assert run.state.tobytes() == states.tobytes()
    assert run.force.tobytes() == forces.tobytes() and run.outcome.kind == "completed"
    truth = scenario.parameters_at(scenario.duration)
    assert mass == pytest.approx(truth.cart_mass, rel=0.5)  # that it learns is for its own tests
    assert length == pytest.approx(truth.half_length, rel=0.5)


def test_rollouts_estimate_the_same_and_estimates_along_a_run_can_be_kept(odd_scenario, estimating):
    scenario = replace(odd_scenario, imperfections=REAL)
    kept, run = simulate_estimated(scenario, estimating), simulate_mujoco(scenario, estimating)
    assert kept.run.state.tobytes() == run.state.tobytes()
    (row,) = afl.run_all(estimating, scenario)
    assert row.metrics["peak_phi"] == np.abs(run.state[:, 1]).max()
    np.testing.assert_allclose(kept.time, np.arange(400) * 0.002)
    _, _, last = by_hand(scenario, estimating)
    assert (kept.cart_mass[0], kept.half_length[0]) == pytest.approx((0.9, 0.45))
    assert (kept.cart_mass[-1], kept.half_length[-1]) == last


def test_assumed_parameters_do_not_reach_it_and_it_runs_nowhere_else(odd_scenario, estimating):
    errors = {"cart_mass": {"error": 20.0}, "half_length": {"error": -0.99}}
    late = afl.Imperfections(parameter_delay=0.5)
    wrong = replace(odd_scenario, imperfections=late, belief=errors)
    one, two = (simulate_mujoco(s, estimating, "sampled") for s in (odd_scenario, wrong))
    assert one.state.tobytes() == two.state.tobytes()
    for simulate in (afl.simulate_ode, lambda *of: simulate_mujoco(*of, "exact")):
        with pytest.raises(InvalidValueError, match=r'^controller .estimating. .*only mode "sampl'):
            simulate(odd_scenario, estimating)
