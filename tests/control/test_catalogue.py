import dataclasses
import sys

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.control import names
from afl_mujoco.control.catalogue import digests
from afl_mujoco.control.names import INFORMED
from afl_mujoco.errors import InvalidValueError, UnknownNameError
from tests.feedback import force_of
from tests.messages import line

# Table 2 of the paper, typed in by hand.
TABLE_2 = {
    "switching": (110.0305, -0.0920, 1.5786, -1.6003e-5, -3.9393),
    "slope": (5.3627, -6.2571, -0.0328, 1.8963, -0.2129),
    "boundary_layer": (95.1876, 3.4663, 1.1792, 0.3508, -1.6115),
}
NAMES = ("switching", "slope", "boundary_layer")


def test_the_catalogue_has_the_paper_s_gains_and_the_names_that_help_shows():
    assert tuple(afl.CONTROLLERS) == names.NAMES
    assert afl.Gains(switching=109.9651, slope=1.2849, boundary_layer=100.0004) == afl.FIXED_GAINS
    published = afl.GainFunction.published()
    assert {name: getattr(published, name) for name in NAMES} == TABLE_2
    np.testing.assert_array_equal(published.coefficients, list(TABLE_2.values()))
    for mass, half_length in ((0.1, 1.0), (0.7, 0.3), (2.0, 0.05)):  # (G1)
        gains = published.gains(mass, half_length)
        for name, (w1, w2, w3, w4, w5) in TABLE_2.items():
            expected = w1 + w2 * mass**w3 + w4 * half_length**w5
            assert getattr(gains, name) == pytest.approx(expected, rel=1e-12)  # rounding of a power


@pytest.mark.parametrize("name", names.PAPER)
def test_a_nominal_belief_ignores_the_truth(name, odd_parameters):
    state, p = (0.2, -0.5, 0.1, 0.3), afl.CartPoleParameters()
    told, controller = afl.CONTROLLERS[name], afl.CONTROLLERS[f"{name}-nominal"]
    assert force_of(controller, state, odd_parameters) == force_of(told, state, p)
    assert force_of(told, state, odd_parameters) != force_of(told, state, p)
    inputs = controller.inputs_for(np.array([[0.5, 0.3, 0.2, 5.0], [2.0, 0.3, 1.0, 5.0]]))
    np.testing.assert_array_equal(inputs[0], inputs[1])
    assert inputs[0, :4].tolist() == [1.0, 0.05, 0.5, 9.81]


def test_a_gain_function_needs_five_coefficients_and_stays_positive():
    rows = ((110, 0, 0, 0, 0), (1.0, -1.0, 1.0, 0, 0), (99, 0, 0, 0, 0))
    falling = afl.GainFunction(**dict(zip(NAMES, rows, strict=True)))
    controller = afl.AFLController(name="falling", gain_function=falling)
    said = line("slope of the gain function at M = 2 kg, l = 0.3 m must be positive, got -1")
    with pytest.raises(InvalidValueError, match=said):
        controller.inputs_for(np.array([[0.5, 0.05, 0.2, 9.81], [2.0, 0.05, 0.3, 9.81]]))
    with pytest.raises(InvalidValueError, match=r"^slope coefficients must be five, got 4$"):
        afl.GainFunction(**{**dict.fromkeys(NAMES, (1, 0, 0, 0, 0)), "slope": (1, 2, 3, 4)})


def test_unknown_names_are_answered_and_the_informed_alone_have_an_estimated_twin():
    estimable = "fixed, adaptive, fixed-retuned, adaptive-retuned, lqr, pole-placement, "
    named = (*afl.CONTROLLERS, f"({estimable}partial-linearization)-estimated, module:attribute")
    said = f"{', '.join(named)}, got 'adaptiv'; did you mean adaptive or adaptive-angle?"
    with pytest.raises(UnknownNameError, match=line(f"controller must be one of {said}")):
        afl.find_controller("adaptiv")
    for name in INFORMED:
        twin = afl.find_controller(f"{name}-estimated")
        assert (twin.name, twin.controller) == (f"{name}-estimated", afl.CONTROLLERS[name])
        assert twin.name not in afl.CONTROLLERS
    for name in ("adaptive-nominal-estimated", "-estimated"):
        with pytest.raises(UnknownNameError, match=rf", got '{name}'"):
            afl.find_controller(name)


def test_a_digest_changes_with_any_value_or_file_and_nothing_else(tmp_path, monkeypatch) -> None:
    one = afl.Scenario(name="rig", initial_state=(0.0, 0.1, 0.0, 0.0))
    changes = ({}, {"duration": 9.0}, {"imperfections": afl.Imperfections(delay=0.01)})
    found = [digests([dataclasses.replace(one, **change)], []) for change in changes]
    assert len({digest["scenario rig"] for digest in found}) == 3 and digests([one], []) == found[0]
    monkeypatch.chdir(tmp_path)
    found = []
    for gain in (-40, -40, -50):
        (tmp_path / "law.py").write_text(f"def mine(t, x, b):\n    return {gain} * x[1]\n")
        sys.modules.pop("law", None)
        own, lqr = afl.find_controller("law:mine"), afl.find_controller("lqr")
        found.append(digests([], [own, lqr]))
    first, again, edited = found
    assert [*first] == ["controller law.mine", "controller lqr"] and again == first
    assert [name for name in first if edited[name] != first[name]] == ["controller law.mine"]
