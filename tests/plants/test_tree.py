"""The tree reference against MuJoCo, in any frame."""

import mujoco
import numpy as np
import pytest

from afl_mujoco.plants.plant import Plant
from afl_mujoco.plants.tree import Tree, terms_of
from afl_mujoco.plants.writer import PlantModel

SPATIAL = """<mujoco><compiler angle="radian"/><option gravity="0.3 -0.2 -9.7"/><worldbody>
<body name="base" pos=".1 .2 .3" quat=".8 .2 -.4 .4">
 <joint name="a" axis="1 2 3" pos=".1 -.2 .3" damping=".3" stiffness="2" springref=".4" ref=".2"/>
 <joint name="b" type="slide" axis="-1 .3 .5" pos=".1 .1 .1" armature=".2" ref="-.1"/>
 <inertial pos=".1 .05 -.2" quat=".9 .1 .3 -.2" mass="1.2" diaginertia=".05 .04 .03"/>
 <body name="fixed" pos=".2 .1 0" quat=".7 .7 0 .1">
  <inertial pos="0 .1 0" mass=".4" diaginertia=".01 .02 .015"/>
  <body name="arm" pos="0 .3 .1" quat="1 0 .5 0"><joint name="c" axis="0 1 0"/>
   <inertial pos="0 0 .3" quat="1 1 0 0" mass=".7" diaginertia=".02 .02 .01"/>
   <site name="jet" pos=".1 .2 .3" quat=".5 .5 .1 -.5"/></body></body>
 <body name="leaf" pos="-.2 0 .4"><joint name="d" axis=".2 .9 0" damping=".1"/>
  <inertial pos=".2 0 .1" mass=".3" diaginertia=".004 .005 .006"/></body>
</body></worldbody><actuator>
<motor name="torque" joint="c" gear="3"/><motor name="jet" site="jet" gear="1 2 3 .4 .5 .6"/>
</actuator></mujoco>"""


def made(xml: str) -> PlantModel:
    spec = mujoco.MjSpec.from_string(xml)
    names = (tuple(x.name for x in some) for some in (spec.joints, spec.actuators))
    coordinates, inputs = names
    plant = Plant(name="spatial", model=xml, coordinates=coordinates, inputs=inputs)
    return PlantModel(plant, compared=True)


def test_terms_are_mujocos_in_any_frame_and_far_from_the_origin() -> None:
    model, rng = made(SPATIAL), np.random.default_rng(0)
    tree = Tree(**model.tree(np.empty(0)))
    for _ in range(100):
        q, v, u = rng.uniform(-3, 3, 4), rng.uniform(-5, 5, 4), rng.uniform(-5, 5, 2)
        engine, own = model.at(q, v, u), terms_of(tree, q, v)
        for its, mine in zip(engine[:3], own[:3], strict=True):
            np.testing.assert_allclose(mine, its, rtol=0, atol=1e-12 * np.abs(its).max())
    near = Tree(**made(SPATIAL).tree(np.empty(0)))
    far = Tree(**made(SPATIAL.replace('pos=".1 .2 .3"', 'pos="1e4 .2 .3"', 1)).tree(np.empty(0)))
    rng = np.random.default_rng(0)
    for _ in range(10):
        q, v = rng.uniform(-3, 3, 4), rng.uniform(-5, 5, 4)
        here, there = terms_of(near, q, v), terms_of(far, q, v)
        for one, other in zip(here[:3], there[:3], strict=True):
            np.testing.assert_allclose(other, one, rtol=0, atol=1e-10 * np.abs(one).max())
        lift = -near.gravity[0] * near.body_mass[1:].sum() * (1e4 - 0.1)
        assert there.energy - here.energy == pytest.approx([0.0, lift], abs=1e-8 * abs(lift))
