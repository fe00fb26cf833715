"""A law told by the estimator: the loop that a rig without a plate to read M and l from runs."""

from dataclasses import replace

import numpy as np
import pytest

from afl_mujoco import CONTROLLERS, CartPoleModel, simulate_mujoco, simulate_ode
from afl_mujoco.control.compiled_controller import law_force
from afl_mujoco.control.estimation import estimator
from afl_mujoco.control.estimation.estimated_controller import EstimatedController
from afl_mujoco.control.estimation.settings import EstimatorSettings
from afl_mujoco.control.own.python_controller import PythonController
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.imperfections import Imperfections
from afl_mujoco.simulation.sampled import loop
from afl_mujoco.simulation.sampled.estimated import simulate_estimated
from afl_mujoco.simulation.sampled.hardware import new_run, no_commands, sense
from afl_mujoco.simulation.sampled.rollouts import run_rollouts
from afl_mujoco.simulation.sampled.runs import prepare
from afl_mujoco.studies.films.replay import Deployment, record

REAL = Imperfections(
    noise_z=1e-4, noise_phi=5e-4, control_period=0.002, delay=0.003, actuator_lag=0.004,
    force_limit=8.0, seed=4,
)  # fmt: skip
SETTINGS = EstimatorSettings(initial_cart_mass=0.9, initial_half_length=0.45)


@pytest.fixture
def told(adaptive):
    return EstimatedController(name="told", law=adaptive, settings=SETTINGS)


def by_hand(scenario, law):
    """The same loop in Python: measure, estimate with the force, command, advance.

    Returns states and forces, and the last estimates.
    """
    run = prepare(scenario, law, timestep=1e-3)
    model = CartPoleModel(scenario.parameters_at(0.0), imperfections=scenario.imperfections)
    pending, rows = no_commands(run.actuator), np.empty((run.plan.steps + 1, 5))
    plant = (model.addresses, run.plan, run.profile, memory := new_run())
    filtering, settings = estimator.new_filter(), law.settings.record
    loop.start(*plant, rows, run.initial_state)
    tick, command = 0, 0.0
    while memory["status"] == loop.RUNNING:
        z, phi, _, _ = sense(model.addresses, run.sensors, memory, tick)
        if tick == 0:
            mass, length = estimator.start(filtering, settings, z, phi)
        else:
            k = int(memory["step"])
            force = max(min(command, 8.0), -8.0)
            if law.settings.force_sensed:
                force = float(rows[k - 1, 4] / 2 + rows[k - 2, 4] / 2)
            mass, length = estimator.update(filtering, settings, z, phi, force, 0.002)
        assumed_parameters = (mass, law.settings.pole_mass, length, law.settings.gravity)
        state = estimator.filtered_state(filtering)
        command = law_force(*law.law.compiled, *state, assumed_parameters)
        loop.advance(*plant[:2], run.actuator, *plant[2:], pending, rows, command)
        tick += 1
    count = int(memory["step"])
    return rows[: count + 1, :4], rows[: count + 1, 4], (mass, length)


@pytest.mark.parametrize("sensed", [False, True], ids=["commanded", "sensed"])
def test_the_compiled_loop_is_the_one_written_by_hand(odd_scenario, adaptive, sensed):
    """And what the estimator is told of the force is what a rig knows of it."""
    settings = replace(SETTINGS, force_sensed=sensed)
    told = EstimatedController(name="told", law=adaptive, settings=settings)
    scenario = replace(odd_scenario, imperfections=REAL)
    run = simulate_mujoco(scenario, told, "sampled")
    states, forces, (mass, length) = by_hand(scenario, told)
    assert run.state.tobytes() == states.tobytes()
    assert run.force.tobytes() == forces.tobytes()
    assert run.outcome.kind == "completed"
    truth = scenario.parameters_at(scenario.duration)
    assert mass == pytest.approx(truth.cart_mass, rel=0.5)  # that it learns is for its own tests
    assert length == pytest.approx(truth.half_length, rel=0.5)


def test_rollouts_tell_the_law_the_same(odd_scenario, told):
    scenarios = [replace(odd_scenario, imperfections=replace(REAL, seed=s)) for s in range(4)]
    one, two = (run_rollouts(scenarios, told, threads=threads) for threads in (1, 2))
    for i, scenario in enumerate(scenarios):
        run = simulate_mujoco(scenario, told, "sampled")
        assert one.peak_phi[i] == two.peak_phi[i] == np.abs(run.state[:, 1]).max()
        assert one.outcome(i) == two.outcome(i) == run.outcome
    assert len(set(one.iae_phi.tolist())) == 4


def test_an_ideal_scenario_is_estimated_as_well(odd_scenario, told, adaptive):
    estimated = simulate_mujoco(odd_scenario, told, "sampled")
    assert np.abs(estimated.state - simulate_mujoco(odd_scenario, adaptive, "sampled").state).any()
    assert estimated.provenance["controller"]["belief"] == "estimated"


def test_only_a_compiled_law_without_belief_can_be_told(told):
    stubborn = PythonController(name="mine", function=lambda time, state, belief: 0.0)
    for law in (stubborn, told, "no law"):
        with pytest.raises(InvalidValueError, match=r"^law of controller 'x' must be a compiled"):
            EstimatedController(name="x", law=law)
    with pytest.raises(InvalidValueError, match=r"must have no belief of its own, got adaptive-n"):
        EstimatedController(name="x", law=CONTROLLERS["adaptive-nominal"])


def test_what_others_are_told_wrongly_does_not_reach_it(odd_scenario, told):
    wrong = Imperfections(mass_error=20.0, length_error=-0.99, parameter_delay=0.5)
    one, two = (
        simulate_mujoco(replace(odd_scenario, imperfections=imperfections), told, "sampled")
        for imperfections in (Imperfections(), wrong)
    )
    assert one.state.tobytes() == two.state.tobytes()


def test_it_runs_nowhere_else(odd_scenario, told):
    rule = r"^controller 'told' is told by an estimator, which only sampled mode simulates$"
    for simulate in (simulate_ode, simulate_mujoco):
        with pytest.raises(InvalidValueError, match=rule):
            simulate(odd_scenario, told)


def test_what_is_believed_along_a_run_can_be_kept_and_changes_nothing(odd_scenario, told):
    scenario = replace(odd_scenario, imperfections=REAL)
    kept, run = simulate_estimated(scenario, told), simulate_mujoco(scenario, told, "sampled")
    assert kept.run.state.tobytes() == run.state.tobytes()
    np.testing.assert_allclose(kept.time, np.arange(400) * 0.002)
    _, _, last = by_hand(scenario, told)
    assert (kept.cart_mass[0], kept.half_length[0]) == pytest.approx((0.9, 0.45))
    assert (kept.cart_mass[-1], kept.half_length[-1]) == last


def test_its_ghost_in_a_film_is_told_the_truth(odd_scenario, told, adaptive):
    film = record(odd_scenario, told, Deployment(), 50)
    truth = record(odd_scenario, adaptive, Deployment(), 50)
    np.testing.assert_array_equal(film.ideal, truth.ideal)
    assert np.abs(film.state - truth.state).max() > 1e-6
