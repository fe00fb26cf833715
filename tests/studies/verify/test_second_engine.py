"""A second engine as outside truth: Pinocchio reads the same MJCF and must move it alike.

Optional: `make pinocchio` installs Pinocchio and runs this. Without it the tests are skipped, or
fail where AFL_MUJOCO_REQUIRE_PINOCCHIO is set.
"""

import os

import mujoco
import numpy as np
import pytest

from afl_mujoco import CartPoleModel, CartPoleParameters, acceleration
from afl_mujoco.plants.cartpole import CART_HALF_SIZE, model_file
from afl_mujoco.plants.cartpole_equations import mass_matrix, total_energy
from afl_mujoco.studies.verify.checks import random_plant

try:
    import pinocchio as pin
except ImportError as error:
    reason = f"Pinocchio, the second engine, is not installed ({error}): run `make pinocchio`"
    if os.environ.get("AFL_MUJOCO_REQUIRE_PINOCCHIO"):
        pytest.fail(f"AFL_MUJOCO_REQUIRE_PINOCCHIO is set, but {reason}", pytrace=False)
    pytest.skip(reason, allow_module_level=True)

STATES = 2000
TOLERANCE = 1e-12  # of 1 + |value|: round-off, the two engines add the same terms in other orders
SCALE = (10.0, np.pi, 10.0, 10.0)


class SecondEngine:
    """Pinocchio's cart-pole: structure from the MJCF, inertias from Pinocchio's own formulas.

    The inertias are set as numbers, because MJCF text would round them to six digits.
    """

    def __init__(self):
        self.model = pin.buildModelFromMJCF(str(model_file("cartpole.xml")))
        self.data = self.model.createData()

    def set_parameters(self, p):
        box = pin.Inertia.FromBox(p.cart_mass, *(2.0 * half for half in CART_HALF_SIZE))
        rod = pin.Inertia.FromCylinder(p.pole_mass, 0.0, 2.0 * p.half_length)
        self.model.inertias[self.model.getJointId("z")] = box
        about = pin.Inertia(rod.mass, np.array([0.0, 0.0, p.half_length]), rod.inertia)
        self.model.inertias[self.model.getJointId("phi")] = about
        self.model.gravity.linear = np.array([0.0, 0.0, -p.gravity])

    def acceleration(self, state, force):
        return pin.aba(self.model, self.data, state[:2], state[2:], np.array([force, 0.0])).copy()

    def mass_matrix(self, state):
        upper = np.triu(pin.crba(self.model, self.data, state[:2]))
        return upper + np.triu(upper, 1).T

    def energy(self, state):
        return pin.computeMechanicalEnergy(self.model, self.data, state[:2], state[2:])


def assert_near(actual, expected) -> None:
    assert np.max(np.abs(actual - expected) / (1.0 + np.abs(expected))) <= TOLERANCE


def test_mujoco_and_the_paper_move_as_the_second_engine_does(rng):
    second = SecondEngine()
    cart_pole, matrix = CartPoleModel(CartPoleParameters()), np.empty((2, 2))
    model, data = cart_pole.mj_model, cart_pole.mj_data
    for _ in range(STATES):
        p = random_plant(rng)
        cart_pole.set_parameters(p)
        second.set_parameters(p)
        state, force = rng.uniform(-1.0, 1.0, 4) * SCALE, rng.uniform(-200.0, 200.0)
        expected = second.acceleration(state, force)
        assert_near(cart_pole.accelerations(state, force), expected)
        assert_near(acceleration(state, force, p), expected)
        mujoco.mj_fullM(model, data, matrix)
        assert_near(matrix, second.mass_matrix(state))
        assert_near(mass_matrix(state, p), matrix)
        mujoco.mj_energyPos(model, data)
        mujoco.mj_energyVel(model, data)
        assert_near(data.energy.sum(), second.energy(state))
        assert_near(total_energy(state, p), second.energy(state))


def test_the_mjcf_as_it_stands_moves_alike_in_both_engines(rng):
    model = mujoco.MjModel.from_xml_path(str(model_file("cartpole.xml")))
    data, second = mujoco.MjData(model), SecondEngine()
    for _ in range(STATES):
        state, force = rng.uniform(-1.0, 1.0, 4) * SCALE, rng.uniform(-200.0, 200.0)
        data.qpos, data.qvel, data.ctrl = state[:2], state[2:], force
        mujoco.mj_forward(model, data)
        assert_near(data.qacc, second.acceleration(state, force))
