"""Suspects say what explains a difference, and stop where equations have no value."""

import math
from dataclasses import replace

import numpy as np
import pytest

import afl_mujoco as afl
from tests.plants.plants import known

pytestmark = pytest.mark.usefixtures("interpreted")

INERTIAL = '<inertial pos="0 0 -1" mass="1" diaginertia="1 1 1"/>'
ARM = f"""<mujoco><compiler angle="radian"/><worldbody><body name="arm">
<joint name="arm" axis="0 1 0" damping="0.1"/>{INERTIAL}</body></worldbody></mujoco>"""


def arm(terms, **parameters: afl.Parameter) -> afl.Plant:
    return afl.Plant(
        name="arm", model=ARM, coordinates=("arm",), terms=terms, parameters=parameters,
        write=lambda p: {"joint arm damping": p.damping} if parameters else {},
    )  # fmt: skip


DAMPING = afl.Parameter(0.1, low=0.05, high=0.3)


def swinging(weight=9.81, more=0.0):
    """Terms of that arm, its damping the parameter or as the MJCF has it."""

    def terms(q, v, p):
        damping = getattr(p, "damping", 0.1) + more
        return ((2.0,),), (weight * math.sin(q[0]) + damping * v[0],), ((),)

    return terms


def test_equations_that_cannot_be_read_otherwise_do_not_end_the_search() -> None:
    """A suspect gives them a negative parameter, of which there is no root."""

    def terms(q, v, p):
        from math import sin, sqrt  # not compiled

        return ((2.0,),), (9.81 * sin(q[0]) ** 3 + sqrt(p.damping) ** 2 * v[0],), ((),)

    result = afl.check(arm(terms, damping=DAMPING), 50)
    assert result.notes[-1].startswith("Equations: interpreted")
    assert "equations and MJCF differ by up to" in result.headline


def test_the_single_precision_of_a_mesh_is_named_and_numbers_that_have_it_agree() -> None:
    """A tetrahedron of 0.1 m: its inertia about an edge is m a^2 / 5, and a = 0.1f in MuJoCo."""
    mesh = '<asset><mesh name="t" vertex="0 0 0 .1 0 0 0 .1 0 0 0 .1" inertia="exact"/></asset>'
    geom = '<geom type="mesh" mesh="t" contype="0" conaffinity="0"/>'
    text = ARM.replace("<worldbody>", f"{mesh}<worldbody>").replace(' damping="0.1"', "")
    text = text.replace(INERTIAL, geom)
    for a, said in ((0.1, "keeps meshes in single precision"), (float(np.float32(0.1)), "obeys")):
        s = 1000.0 * a**4 / 6.0
        falling = arm(lambda q, v, p, s=s, a=a: (
            ((0.2 * s * a,),), (-9.81 * 0.25 * s * (math.cos(q[0]) + math.sin(q[0])),), ((),),
        ))  # fmt: skip
        assert said in afl.check(replace(falling, model=text), 50).headline
    falling = arm(swinging(9.81 * (1.0 + 1e-7), -0.1))
    drawn = replace(falling, model=text.replace(geom, geom + INERTIAL))
    assert "gravity is" in afl.check(drawn, 50).headline  # the mesh weighs nothing


def test_what_looks_alike_is_named_beside_another_and_round_numbers_first() -> None:
    """Nothing of the body varies: its armature could be its inertia, or its mass."""
    text = ARM.replace('damping="0.1"', 'damping="0.1" armature="0.7"')
    text = text.replace('body name="arm"', "body")
    said = afl.check(replace(arm(swinging(), damping=DAMPING), model=text), 50).headline
    first, *others = said.removeprefix("arm: mass matrix, arm: ").split(", or ")
    assert first == "armature of arm is 0 in the equations and 0.7 in MuJoCo"
    assert others[0] == "the inertia of body 1 is 0.3 times MuJoCo's in the equations"
    assert others[-1].endswith(" in the equations?")  # something varies, and does not tell


def test_an_angle_from_elsewhere_is_named_beside_the_sign_that_looks_alike() -> None:
    plant = arm(swinging(-9.81), damping=DAMPING)
    said = afl.check(plant, 50).headline.removeprefix("arm: bias, arm: ")
    assert said.startswith("gravity has the other sign in the equations, or ")
    assert said.endswith("arm is measured from 180 degrees further in the equations?")


def test_an_armature_that_is_forgotten_and_a_parameter_that_equations_do_not_read_are_named():
    rolling = arm(swinging(), mass=afl.Parameter(0.5, low=0.2, high=0.9))
    plant = replace(rolling, write=lambda p: {"joint arm armature": 0.4 * p.mass})
    said = "arm: mass matrix, arm: the armature of arm is missing in the equations?"
    assert afl.check(plant, 50).headline == said
    own = arm(swinging(), g=afl.Parameter(9.81))
    plant = replace(own, write=lambda p: {"option gravity 2": -p.g})
    assert afl.check(plant, 50).headline.endswith("do not read g: drawn at one value")


def test_no_body_has_a_negative_inertia() -> None:
    """As accelerations, motors that push the other way are its like."""
    plant = known("quadrotor_load.py:plant")

    def accelerations(q, v, u, p):
        mass, bias, inputs = map(np.array, plant.terms(q, v, p))
        inputs[2] *= -1.0
        return np.linalg.solve(mass, inputs @ u - bias)

    turned = replace(plant, terms=None, accelerations=accelerations)
    assert "inputs left and right are exchanged" in afl.check(turned, 50).headline


def test_a_body_without_mass_explains_no_accelerations_since_it_could_have_any() -> None:
    free = ARM.replace(' damping="0.1"', "")
    plant = replace(arm(None), model=free, accelerations=lambda q, v, u, p: (9.81 * q[0],))
    assert "equations and MJCF differ by up to" in afl.check(plant, 50).headline
    light = replace(plant, accelerations=lambda q, v, u, p: (-4.0 * math.sin(q[0]),))
    said = afl.check(light, 50).headline
    assert "gravity is 0.81549" in said and "slides" not in said


@pytest.mark.parametrize(("factors", "said"), [
    ((1.0, -1.0, 1.0), "the bias has the other sign in the equations"),
    ((2.0, 2.0, 2.0), "every term is doubled in the equations"),
])  # fmt: skip
def test_a_whole_term_has_a_name(factors: tuple[float, ...], said: str) -> None:
    plant = known("quadrotor_load.py:plant")

    def terms(q, v, p):
        return tuple(c * np.array(x) for c, x in zip(factors, plant.terms(q, v, p), strict=True))

    assert said in afl.check(replace(plant, terms=terms), 50).headline


def test_a_small_share_is_said_to_be_small_and_a_parameter_has_no_value_of_its_own() -> None:
    own = arm(swinging(9.81 * (1.0 + 1e-7)))
    assert "gravity is 1 + 1e-07 times MuJoCo's" in afl.check(own, 50).headline
    result = afl.check(arm(swinging(more=0.2), damping=DAMPING), 50)
    assert "damping of arm is 0.2 more in the equations" in result.headline
    tiny = '<inertial pos="0 0 -1e-3" mass="1e-3" diaginertia="1e-9 1e-9 1e-9"/>'
    text = ARM.replace(INERTIAL, tiny).replace('"0.1"', '"9.4e-10"')
    turns = arm(lambda q, v, p: (((2e-9,),), (9.81e-6 * math.sin(q[0]) + 8.5e-10 * v[0],), ((),)))
    said = "damping of arm is 8.5e-10 in the equations and 9.4e-10 in MuJoCo?"
    assert said in afl.check(replace(turns, model=text), 50).headline
