"""Every controller as one compiled function: its values, its interpolation, where it has none."""

import math

import numpy as np
import pytest

from afl_mujoco import CONTROLLERS, acceleration, control_force
from afl_mujoco.control import controller as form
from afl_mujoco.scenario.parameters import NOMINAL, PlantRange

MASSES, LENGTHS = np.array([0.2, 0.5, 0.9, 1.0]), np.array([0.1, 0.3, 0.4, 0.8, 1.1])
ASSUMED = (0.61, 0.083, 0.37, 9.65)
NODE = (0.9, 0.083, 0.4, 9.65)
KINDS = {"afl": form.AFL, "linear": form.LINEAR, "partial": form.PARTIAL}


@pytest.fixture
def table(rng):
    return rng.uniform(-9.0, 9.0, (len(MASSES), len(LENGTHS), 4))


def compiled(kind, table):
    if kind == form.AFL:
        return tuple(CONTROLLERS["adaptive"].compiled_for(PlantRange.of(NOMINAL)))
    return kind, table, MASSES, LENGTHS


def values_of(p):
    return p.cart_mass, p.pole_mass, p.half_length, p.gravity


def along(controller, states, assumed):
    return np.array([form.compiled_force(*controller, *s, assumed) for s in states.tolist()])


def test_the_paper_s_controller_is_its_numpy_form(random_states, odd_parameters, controller):
    p = odd_parameters
    gains = controller.gain_function.gains(p.cart_mass, p.half_length)
    plain = control_force(random_states, p, gains)
    mine = along(controller.compiled_for(PlantRange.of(NOMINAL)), random_states, values_of(p))
    np.testing.assert_allclose(mine, plain, rtol=1e-13, atol=1e-10)  # rounding of forces of 1e3 N


def test_linear_feedback_is_minus_the_gains_times_the_state(random_states, table):
    mine = along((form.LINEAR, table, MASSES, LENGTHS), random_states, NODE)
    np.testing.assert_allclose(mine, -random_states @ table[2, 2], rtol=1e-12, atol=1e-12)


def test_partial_feedback_gives_the_cart_what_it_asks_for(random_states, table, odd_parameters):
    p = odd_parameters
    force = along((form.PARTIAL, table, MASSES, LENGTHS), random_states, values_of(p))
    gains = form.interpolated_gains(table, MASSES, LENGTHS, p.cart_mass, p.half_length)
    asked = -random_states @ np.array(gains)
    cart, pole = acceleration(random_states, force, p).T
    _, phi, _, _ = random_states.T
    np.testing.assert_allclose(cart, asked, rtol=1e-12, atol=1e-10)
    expected = 0.75 / p.half_length * (p.gravity * np.sin(phi) + asked * np.cos(phi))
    np.testing.assert_allclose(pole, expected, rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_looking_the_gains_up_beforehand_changes_no_bit(kind, random_states, table):
    controller = compiled(kind, table)
    plants = np.linspace((0.1, 1.3), (2.0, 0.02), len(random_states))
    assumed_parameters = np.array([[m, 0.083, x, 9.65] for m, x in plants])
    inputs = form.inputs_along(*controller, assumed_parameters)
    assert inputs.shape == (200, 7 if kind == form.AFL else 8)
    direct = [
        form.compiled_force(*controller, *s, tuple(b))
        for s, b in zip(random_states.tolist(), assumed_parameters, strict=True)
    ]
    found = np.empty((200, 1))
    form.forces_along(kind, random_states, inputs, found)
    np.testing.assert_array_equal(found[:, 0], direct)


@pytest.mark.parametrize("phi", [0.5 * math.pi, -1.6, 3.0, math.nan], ids=str)
def test_only_the_paper_s_controller_has_no_value_at_a_pole_that_lies(phi, table):
    state = (0.1, phi, 0.2, 0.3)
    assert math.isnan(form.compiled_force(*compiled(form.AFL, table), *state, ASSUMED))
    for kind in (form.LINEAR, form.PARTIAL):
        force = form.compiled_force(*compiled(kind, table), *state, ASSUMED)
        assert math.isfinite(force) == math.isfinite(phi)


def test_at_a_node_and_where_there_is_but_one_the_gains_are_the_table_s_to_the_bit(table):
    for i, mass in enumerate(MASSES.tolist()):
        for j, length in enumerate(LENGTHS.tolist()):
            gains = form.interpolated_gains(table, MASSES, LENGTHS, mass, length)
            np.testing.assert_array_equal(gains, table[i, j])
    for end, beyond in ((0, 1.0 - 5e-10), (-1, 1.0 + 5e-10)):  # by round-off
        gains = form.interpolated_gains(table, MASSES, LENGTHS, MASSES[end] * beyond, LENGTHS[end])
        np.testing.assert_array_equal(gains, table[end, end])
    only, one = np.array([[[1.0, 2.0, 3.0, 4.0]]]), np.ones(1)
    for plant in ((0.1, 0.05), (1.0, 1.0), (9.0, 9.0)):
        assert form.interpolated_gains(only, one, one, *plant) == (1.0, 2.0, 3.0, 4.0)


def test_slopes_are_continuous_across_nodes_and_a_quadratic_table_is_met_exactly(table):
    step = 1e-6

    def gains(m, x):
        return np.array(form.interpolated_gains(table, MASSES, LENGTHS, m, x))

    across_masses = [(m, x, step, 0.0) for m, x in ((0.5, 0.35), (0.9, 0.6))]
    across_lengths = [(m, x, 0.0, step) for m, x in ((0.6, 0.3), (0.95, 0.4), (0.3, 0.8))]
    for m, x, dm, dx in (*across_masses, *across_lengths):
        before = (gains(m, x) - gains(m - dm, x - dx)) / step
        after = (gains(m + dm, x + dx) - gains(m, x)) / step
        np.testing.assert_allclose(after, before, atol=1e-2)  # curvature times the step
    masses, lengths = np.linspace(0.1, 2.0, 9), np.linspace(0.05, 1.0, 7)
    factors = np.array([1.0, -2.0, 0.5, 3.0])

    def true(m, x):
        return factors * (1.0 + m - 0.3 * m * m) * (2.0 - x + 4.0 * x * x)

    table = np.array([[true(m, x) for x in lengths] for m in masses])
    for m, x in ((0.4, 0.3), (1.1, 0.66), (1.7, 0.8)):  # not in a cell at the edge
        gains = form.interpolated_gains(table, masses, lengths, m, x)
        np.testing.assert_allclose(gains, true(m, x), rtol=1e-13)


@pytest.mark.parametrize("asked", [(0.05, 0.3), (7.0, 0.35), (0.6, 5.0), (math.nan, 0.3)], ids=str)
def test_beyond_the_grid_nothing_is_known(asked, table):
    assert np.isnan(form.interpolated_gains(table, MASSES, LENGTHS, *asked)).all()
