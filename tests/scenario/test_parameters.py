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
    (-0.1, "positive, got -0.1"), (0, "positive, got 0.0"), (float("nan"), "finite, got nan"),
    (float("inf"), "finite, got inf"), ("1.0", "a number, got '1.0'"),
    (b"1.0", "a number, got b'1.0'"), (True, "a number, got True"), (None, "a number, got None"),
    (1j, "a number, got 1j"), ([1.0], "a number, got [1.0]"),
], ids=str)  # fmt: skip
def test_a_value_that_breaks_a_rule_is_refused_by_name(name, value, message):
    with pytest.raises(InvalidValueError, match=line(f"{name} must be {message}")) as caught:
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
