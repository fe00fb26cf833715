"""Gains, the gain function (G1), and what each controller assumes."""

import math
from dataclasses import replace

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.control import names
from afl_mujoco.control.names import INFORMED, subject_of
from afl_mujoco.errors import InvalidValueError, UnknownNameError
from afl_mujoco.scenario.parameters import PlantRange

# Table 2 of the paper, typed in by hand.
TABLE_2 = {
    "switching": (110.0305, -0.0920, 1.5786, -1.6003e-5, -3.9393),
    "slope": (5.3627, -6.2571, -0.0328, 1.8963, -0.2129),
    "boundary_layer": (95.1876, 3.4663, 1.1792, 0.3508, -1.6115),
}
# (G1) at M = 1, l = 1 is w1 + w2 + w4: sums done by hand.
NAMES = ("switching", "slope", "boundary_layer")


def test_the_names_that_help_shows_are_those_of_the_catalogue():
    assert tuple(afl.CONTROLLERS) == names.NAMES


def test_the_fixed_gains_are_the_paper_s_constants():
    assert afl.Gains(switching=109.9651, slope=1.2849, boundary_layer=100.0004) == afl.FIXED_GAINS


def test_the_published_gain_function_is_table_2():
    published = afl.GainFunction.published()
    assert {name: getattr(published, name) for name in NAMES} == TABLE_2
    np.testing.assert_array_equal(published.coefficients, list(TABLE_2.values()))


@pytest.mark.parametrize("mass", [0.1, 0.7, 2.0], ids=str)
@pytest.mark.parametrize("half_length", [0.05, 0.3, 1.0], ids=str)
@pytest.mark.parametrize("name", NAMES)
def test_the_gain_function_is_g1(name, mass, half_length):
    w1, w2, w3, w4, w5 = TABLE_2[name]
    expected = w1 + w2 * math.exp(w3 * math.log(mass)) + w4 * math.exp(w5 * math.log(half_length))
    gains = afl.GainFunction.published().gains(mass, half_length)
    assert getattr(gains, name) == pytest.approx(expected, rel=1e-12)  # rounding of a power


@pytest.mark.parametrize(
    "name", ["fixed", "adaptive", "lqr", "pole-placement", "partial-linearization"]
)
def test_a_nominal_belief_ignores_the_truth(name, odd_parameters):
    state, nominal = (0.2, -0.5, 0.1, 0.3), f"{name}-nominal"
    controller = afl.CONTROLLERS.get(nominal) or replace(
        afl.CONTROLLERS[name], belief=afl.CartPoleParameters()
    )
    seen = afl.CONTROLLERS[name].force(state, afl.CartPoleParameters())
    assert controller.force(state, odd_parameters) == seen
    assert afl.CONTROLLERS[name].force(state, odd_parameters) != seen
    inputs = controller.inputs_along_run([0.5, 2.0], [0.2, 1.0], 0.3, 5.0)
    np.testing.assert_array_equal(inputs[0], inputs[1])
    assert inputs[0, :4].tolist() == [1.0, 0.05, 0.5, 9.81]


def test_a_true_belief_passes_everything_on(adaptive):
    inputs = adaptive.inputs_along_run([[0.5, 2.0]], [[0.2, 1.0]], 0.3, 5.0)
    assert inputs.shape == (1, 2, 7)
    assert inputs[0, 1, :4].tolist() == [2.0, 0.3, 1.0, 5.0]
    gains = adaptive.gain_function.gains(0.5, 0.2)
    expected = [gains.switching, gains.slope, gains.boundary_layer]
    np.testing.assert_allclose(inputs[0, 0, 4:], expected, rtol=1e-14)  # two pow functions


def test_a_gain_function_that_turns_negative_is_refused_before_a_run():
    falling = afl.GainFunction(
        switching=(110, 0, 0, 0, 0), slope=(1.0, -1.0, 1.0, 0, 0), boundary_layer=(99, 0, 0, 0, 0)
    )
    controller = afl.AFLController(name="falling", gain_function=falling)
    with pytest.raises(InvalidValueError) as caught:
        controller.inputs_along_run([0.5, 2.0], [0.2, 0.3], 0.05, 9.81)
    assert str(caught.value) == (
        "slope of the gain function at M = 2 kg, l = 0.3 m must be positive, got -1"
    )
    with pytest.raises(InvalidValueError, match=r"^slope must be positive, got -1.0$"):
        falling.gains(2.0, 0.3)


def test_a_gain_function_needs_five_finite_coefficients():
    good = {name: (1, 0, 0, 0, 0) for name in NAMES}
    with pytest.raises(InvalidValueError, match=r"^slope coefficients must be five, got 4$"):
        afl.GainFunction(**{**good, "slope": (1, 2, 3, 4)})
    with pytest.raises(InvalidValueError, match=r"^slope coefficients must be finite, got nan$"):
        afl.GainFunction(**{**good, "slope": (1, 2, 3, 4, math.nan)})


def test_unknown_names_are_answered_with_the_valid_ones():
    with pytest.raises(UnknownNameError) as caught:
        afl.find_controller("adaptiv")
    estimable = "fixed, adaptive, fixed-retuned, adaptive-retuned, lqr, pole-placement, "
    names = (
        ", ".join(afl.CONTROLLERS)
        + f", ({estimable}partial-linearization)-estimated, module:attribute"
    )
    near = "did you mean adaptive or adaptive-held?"
    assert str(caught.value) == f"controller must be one of {names}, got 'adaptiv'; {near}"


@pytest.mark.parametrize("name", [n for n in afl.CONTROLLERS if n in INFORMED])
def test_every_controller_has_a_twin_with_the_estimator(name):
    twin = afl.find_controller(f"{name}-estimated")
    assert (twin.name, twin.controller) == (f"{name}-estimated", afl.CONTROLLERS[name])
    assert twin.name not in afl.CONTROLLERS


@pytest.mark.parametrize("name", ["adaptive-nominal-estimated", "pid-estimated", "-estimated"])
def test_a_controller_that_assumes_a_nominal_plant_or_is_none_has_no_such_twin(name):
    with pytest.raises(UnknownNameError, match=rf", got '{name}'"):
        afl.find_controller(name)


def test_the_saturation_ratio_is_s_over_phi(random_states, adaptive, odd_parameters):
    from afl_mujoco import sliding_variable

    p = odd_parameters
    gains = adaptive.gain_function.gains(p.cart_mass, p.half_length)
    inputs = adaptive.inputs_along_run(
        np.full(200, p.cart_mass), np.full(200, p.half_length), p.pole_mass, p.gravity
    )
    expected = sliding_variable(random_states, p, gains) / gains.boundary_layer
    np.testing.assert_allclose(
        adaptive.saturation_ratio(random_states, inputs), expected, rtol=1e-12, atol=1e-12
    )


def test_a_controller_named_as_results_show_it_is_told_how_it_is_given() -> None:
    with pytest.raises(
        InvalidValueError, match=r"did you mean my_pid:Observer\?\), got my_pid.Observer"
    ):
        afl.find_controller("my_pid.Observer")


def test_gains_beyond_the_plants_of_the_table_are_remarked_on_and_no_others():
    inside, heavy = PlantRange((0.1, 2.0), (0.05, 1.0), 0.05, 9.81), (0.2, 2.1)
    adaptive = afl.CONTROLLERS["adaptive"]
    assert adaptive.remarks(inside) == []
    (said,) = adaptive.remarks(inside._replace(cart_mass=heavy))
    assert "M 0.1 to 2 kg, and M reaches 2.1 kg" in said
    (said,) = adaptive.remarks(inside._replace(half_length=(0.04, 0.5)))
    assert "l 0.05 to 1 m, and l reaches 0.04 m" in said
    assert afl.CONTROLLERS["fixed"].remarks(inside._replace(cart_mass=heavy)) == []


@pytest.mark.parametrize(("names", "subject"), [
    (("lqr", "adaptive", "own.LQI"), "own.LQI"),
    (("lqr", "fixed", "adaptive"), "adaptive"),
    (("lqr", "adaptive-estimated"), "adaptive-estimated"),
    (("lqr", "fixed"), "fixed"),
    (("lqr",), "lqr"),
], ids=str)  # fmt: skip
def test_findings_are_about_the_users_own_controller_else_the_papers(names, subject) -> None:
    assert subject_of(names) == subject
