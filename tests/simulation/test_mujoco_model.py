"""A mutated model equals a freshly compiled one bit for bit, and an MJCF written independently."""

import mujoco
import numpy as np
import pytest

from afl_mujoco import CartPoleModel, CartPoleParameters

NAMES = ("cart_mass", "pole_mass", "half_length", "gravity")


def _friction_limits_and_contact(spec):
    slider = spec.joint("z")
    slider.frictionloss = 0.7
    slider.range = [-0.4, 0.4]
    slider.limited = mujoco.mjtLimited.mjLIMITED_TRUE
    spec.joint("phi").frictionloss = 0.01
    pole = spec.geom("pole")
    pole.contype = pole.conaffinity = 1
    spec.worldbody.add_geom(
        name="ground", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 0.1], pos=[0, 0, -0.1],
        contype=1, conaffinity=1,
    )  # fmt: skip


@pytest.fixture
def plants(rng):
    rows = rng.uniform((0.1, 0.01, 0.05, 5.0), (2.0, 0.5, 1.0, 15.0), size=(12, 4)).tolist()
    return [CartPoleParameters(**dict(zip(NAMES, row, strict=True))) for row in rows]


def _arrays(model):
    every = {name: getattr(model, name) for name in dir(model) if not name.startswith("_")}
    return {name: value for name, value in every.items() if isinstance(value, np.ndarray)}


def _accelerations(model, states, forces):
    data = mujoco.MjData(model)
    result = []
    for state, force in zip(states, forces, strict=True):
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.ctrl[:] = state[:2], state[2:], force
        mujoco.mj_forward(model, data)
        result.append([*data.qacc, data.ncon, data.nefc])
    return np.array(result)


@pytest.mark.parametrize("file", ["cartpole.xml", "scene.xml"])
@pytest.mark.parametrize("edit", [None, _friction_limits_and_contact])
def test_a_mutated_model_equals_a_freshly_compiled_one_in_every_array(file, edit, plants):
    mutated = CartPoleModel(plants[0], file=file, edit=edit)
    for p in plants[1:]:
        mutated.set_parameters(p)
        fresh = _arrays(CartPoleModel(p, file=file, edit=edit).mj_model)
        changed = _arrays(mutated.mj_model)
        assert len(fresh) > 200
        unequal = [n for n in fresh if fresh[n].tobytes() != changed[n].tobytes()]
        assert unequal == [] and mutated.mj_model.opt.gravity.tolist() == [0.0, 0.0, -p.gravity]


def _by_hand(p):
    rod, about_itself = p.pole_mass * p.half_length**2 / 3, p.pole_mass * 0.02**2 / 2
    return f"""<mujoco><compiler angle="radian" inertiafromgeom="false"/>
      <option gravity="0 0 {-p.gravity!r}" timestep="0.001" integrator="RK4"/><worldbody>
        <body><joint name="z" type="slide" axis="1 0 0"
                     frictionloss="0.7" limited="true" range="-0.4 0.4"/>
          <inertial pos="0 0 0" mass="{p.cart_mass!r}" diaginertia="1 1 1"/>
          <body><joint type="hinge" axis="0 -1 0" frictionloss="0.01"/>
            <inertial pos="0 0 {p.half_length!r}" mass="{p.pole_mass!r}"
                      diaginertia="{rod!r} {rod!r} {about_itself!r}"/>
            <geom type="capsule" size="0.02 {p.half_length!r}" pos="0 0 {p.half_length!r}"/>
          </body></body><geom type="plane" size="5 5 0.1" pos="0 0 -0.1"/></worldbody>
      <actuator><motor joint="z"/></actuator></mujoco>"""


def test_a_mutated_model_moves_like_an_mjcf_written_by_hand(plants, rng):
    low, high = (-0.5, -2.5, -3.0, -5.0), (0.5, 2.5, 3.0, 5.0)
    states, forces = rng.uniform(low, high, size=(100, 4)), rng.uniform(-20, 20, 100)
    mutated = CartPoleModel(plants[0], edit=_friction_limits_and_contact)
    for p in plants[1:6]:
        mutated.set_parameters(p)
        expected = _accelerations(mujoco.MjModel.from_xml_string(_by_hand(p)), states, forces)
        assert (expected[:, 2] > 0).any()  # contacts happen
        assert (expected[:, 2] == 0).any()
        actual = _accelerations(mutated.mj_model, states, forces)
        np.testing.assert_array_equal(actual[:, 2:], expected[:, 2:])
        # only the arrangement of bodies and constraints differs: roundings, amplified by the solver
        np.testing.assert_allclose(actual[:, :2], expected[:, :2], rtol=1e-9, atol=1e-9)


def test_the_sensors_read_the_state(odd_parameters):
    model = CartPoleModel(odd_parameters)
    data = model.mj_data
    data.qpos[:], data.qvel[:] = (0.3, -0.4), (0.5, 0.6)
    mujoco.mj_forward(model.mj_model, data)
    read = [data.sensor(n).data[0] for n in ("z", "phi", "z_dot", "phi_dot")]
    assert read == [0.3, -0.4, 0.5, 0.6]
    l2 = 2 * odd_parameters.half_length
    tip = [0.3 - l2 * np.sin(-0.4), 0.0, l2 * np.cos(-0.4)]  # positive phi leans toward -z
    np.testing.assert_allclose(data.sensor("tip").data, tip, atol=1e-15)


def test_the_cart_has_the_inertia_of_its_box_as_mujoco_s_compiler_makes_it():
    box = '<body><freejoint/><geom type="box" size=".2 .15 .1" mass="1.7"/></body>'
    made = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{box}</worldbody></mujoco>")
    p = CartPoleParameters(cart_mass=1.7, pole_mass=0.05, half_length=0.5)
    found = CartPoleModel(p).mj_model.body("cart").inertia
    np.testing.assert_allclose(np.sort(found), np.sort(made.body_inertia[1]), rtol=1e-12)
