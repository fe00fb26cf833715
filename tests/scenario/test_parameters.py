"""Parameters are positive finite numbers, and frozen."""

import dataclasses

import numpy as np
import pytest

from afl_mujoco import CartPoleParameters
from afl_mujoco.errors import AflMujocoError, InvalidValueError
from tests.messages import line

FIELDS = ("cart_mass", "pole_mass", "half_length", "gravity")


def test_the_defaults_are_the_nominal_plant_of_the_paper():
    p = CartPoleParameters()
    assert (p.cart_mass, p.pole_mass, p.half_length, p.gravity) == (1.0, 0.05, 0.5, 9.81)


@pytest.mark.parametrize("name", FIELDS)
@pytest.mark.parametrize(("value", "message"), [
    pytest.param(-0.1, "must be positive, got -0.1", id="negative"),
    pytest.param(0, "must be positive, got 0.0", id="zero"),
    pytest.param(float("nan"), "must be finite, got nan", id="nan"),
    pytest.param(float("inf"), "must be finite, got inf", id="inf"),
    pytest.param("1.0", "must be a number, got '1.0'", id="text"),
    pytest.param(b"1.0", "must be a number, got b'1.0'", id="bytes"),
    pytest.param(True, "must be a number, got True", id="bool"),
    pytest.param(None, "must be a number, got None", id="none"),
    pytest.param(1j, "must be a number, got 1j", id="complex"),
    pytest.param([1.0], "must be a number, got [1.0]", id="list"),
])  # fmt: skip
def test_a_value_that_breaks_a_rule_is_refused_by_name(name, value, message):
    with pytest.raises(InvalidValueError, match=line(f"{name} {message}")) as caught:
        CartPoleParameters(**{name: value})
    assert caught.value.thing == name


@pytest.mark.parametrize("value", [np.True_, 10**400], ids=["numpy bool", "integer beyond float"])
def test_a_number_that_is_none_in_disguise_is_refused(value):
    with pytest.raises(AflMujocoError, match=r"^cart_mass must be"):
        CartPoleParameters(cart_mass=value)


def test_parameters_are_keyword_only_and_frozen(odd_parameters):
    with pytest.raises(TypeError):
        CartPoleParameters(1.0)
    with pytest.raises(dataclasses.FrozenInstanceError):
        odd_parameters.cart_mass = 2.0
