"""A mutated model equals a freshly compiled one bit for bit, and its sensors read the state."""

import mujoco
import numpy as np
import pytest

from afl_mujoco import CartPoleModel, CartPoleParameters

NAMES = ("cart_mass", "pole_mass", "half_length", "gravity")


def _friction_limits_and_contact(spec):
    """Add what the paper leaves out: a rail with friction and ends, and a floor for the pole."""
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
    rows = rng.uniform((0.1, 0.01, 0.05, 5.0), (2.0, 0.5, 1.0, 15.0), size=(6, 4)).tolist()
    return [CartPoleParameters(**dict(zip(NAMES, row, strict=True))) for row in rows]


def _arrays(model):
    every = {name: getattr(model, name) for name in dir(model) if not name.startswith("_")}
    return {name: value for name, value in every.items() if isinstance(value, np.ndarray)}


@pytest.mark.parametrize(
    ("file", "edit"), [("cartpole.xml", None), ("scene.xml", _friction_limits_and_contact)]
)
def test_a_mutated_model_equals_a_freshly_compiled_one_in_every_array(file, edit, plants):
    mutated = CartPoleModel(plants[0], file=file, edit=edit)
    for p in plants[1:]:
        mutated.set_parameters(p)
        fresh = _arrays(CartPoleModel(p, file=file, edit=edit).mj_model)
        changed = _arrays(mutated.mj_model)
        assert len(fresh) > 200
        unequal = [n for n in fresh if fresh[n].tobytes() != changed[n].tobytes()]
        assert unequal == [] and mutated.mj_model.opt.gravity.tolist() == [0.0, 0.0, -p.gravity]


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
