"""A controller along a segment is the controller at each of its instants."""

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.control import controller as form
from afl_mujoco.control.own import PythonController
from afl_mujoco.simulation.bound_controllers import bound
from tests.plants.plants import known

RAMPS = {
    "load": afl.piecewise_linear((0.1, 1.3), (0.01, 0.09)),
    "length": afl.piecewise_linear((0.2, 1.1), (0.45, 0.8)),
}


def test_gains_along_ramps_are_those_of_the_parameters_of_each_instant() -> None:
    plant, asked = known("quadrotor_load.py:plant"), afl.Requirements(target={"z": 1.0})
    what = {"plant": plant, "schedule": RAMPS, "requirements": asked, "duration": 2.0}
    scenario = afl.Scenario(name="ramps", **what)
    controller = bound(afl.CONTROLLERS["lqr"], scenario)
    state, found = np.linspace(-0.3, 0.4, 8), np.empty(2)
    pieces = []
    for segment in scenario.segments:
        law = form.Laws(controller, scenario).along(segment)
        pieces.append(len(law.rows))
        for time in np.linspace(segment.start, segment.end, 23):
            values = segment.values_at(time)
            form.command(law, time, state, values.copy(), found)
            np.testing.assert_allclose(found, controller.command(time, state, values), rtol=1e-12)
    assert min(pieces) == 1 < max(pieces)  # both constant and cut at nodes


def test_what_a_controller_raises_in_a_compiled_loop_is_raised_and_a_ctrl_c_ends_it() -> None:
    called = []

    def fails(time, state, belief):
        called.append(time)
        raise raised

    raised = LookupError("no gains")
    with pytest.raises(afl.AflMujocoError, match=r"raised LookupError at t = 0.1.* no gains"):
        afl.simulate_ode("nominal", lambda t, x, b: fails(t, x, b) if t > 0.1 else 0.0)
    called, raised = [], KeyboardInterrupt()
    controller = PythonController(name="interrupted", function=fails, stateful=False)
    with pytest.raises(KeyboardInterrupt):
        afl.simulate_ode_rk4("nominal", controller)
    assert len(called) == 1


def test_partial_feedback_gives_the_cart_what_it_asks_for(random_states, rng, odd_parameters):
    p, masses, lengths = odd_parameters, np.array([0.2, 0.5, 0.9]), np.array([0.1, 0.3, 0.8, 1.1])
    table = rng.uniform(-9.0, 9.0, (len(masses), len(lengths), 4))
    told = (p.cart_mass, p.pole_mass, p.half_length, p.gravity)
    law = (form.PARTIAL, table, masses, lengths, 0.0)
    force = [form.compiled_force(*law, *state, told) for state in random_states.tolist()]
    gains = form.interpolated_gains(table, masses, lengths, p.cart_mass, p.half_length)
    asked, phi = -random_states @ np.array(gains), random_states[:, 1]
    cart, pole = afl.acceleration(random_states, np.array(force), p).T
    np.testing.assert_allclose(cart, asked, rtol=1e-12, atol=1e-10)
    expected = 0.75 / p.half_length * (p.gravity * np.sin(phi) + asked * np.cos(phi))
    np.testing.assert_allclose(pole, expected, rtol=1e-12, atol=1e-9)


def test_a_quadratic_table_is_met_exactly():
    masses, lengths = np.linspace(0.1, 2.0, 9), np.linspace(0.05, 1.0, 7)

    def true(m, x):
        return np.array([1.0, -2.0, 0.5, 3.0]) * (1.0 + m - 0.3 * m * m) * (2.0 - x + 4.0 * x * x)

    table = np.array([[true(m, x) for x in lengths] for m in masses])
    for m, x in ((0.4, 0.3), (1.1, 0.66), (1.7, 0.8)):  # not in a cell at the edge
        gains = form.interpolated_gains(table, masses, lengths, m, x)
        np.testing.assert_allclose(gains, true(m, x), rtol=1e-13)
