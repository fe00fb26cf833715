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

    def __init__(self, file="cartpole.xml"):
        self.model = pin.buildModelFromMJCF(str(model_file(file)))
        self.data = self.model.createData()

    def set_parameters(self, p):
        box = pin.Inertia.FromBox(p.cart_mass, *(2.0 * half for half in CART_HALF_SIZE))
        rod = pin.Inertia.FromCylinder(p.pole_mass, 0.0, 2.0 * p.half_length)
        centre = np.array([0.0, 0.0, p.half_length])
        self.model.inertias[self.model.getJointId("z")] = box
        about = pin.Inertia(rod.mass, centre, rod.inertia)
        self.model.inertias[self.model.getJointId("phi")] = about
        self.model.gravity.linear = np.array([0.0, 0.0, -p.gravity])

    def acceleration(self, state, force):
        return pin.aba(self.model, self.data, state[:2], state[2:], np.array([force, 0.0])).copy()

    def mass_matrix(self, state):
        upper = np.triu(pin.crba(self.model, self.data, state[:2]))
        return upper + np.triu(upper, 1).T

    def energy(self, state):
        return pin.computeMechanicalEnergy(self.model, self.data, state[:2], state[2:])


class MuJoCo:
    def __init__(self):
        self.cart_pole = CartPoleModel(CartPoleParameters())
        self.set_parameters = self.cart_pole.set_parameters

    def acceleration(self, state, force):
        return self.cart_pole.accelerations(state, force)

    def mass_matrix(self, state):
        self.acceleration(state, 0.0)
        matrix = np.empty((2, 2))
        mujoco.mj_fullM(self.cart_pole.mj_model, self.cart_pole.mj_data, matrix)
        return matrix

    def energy(self, state):
        model, data = self.cart_pole.mj_model, self.cart_pole.mj_data
        self.acceleration(state, 0.0)
        mujoco.mj_energyPos(model, data)
        mujoco.mj_energyVel(model, data)
        return data.energy.sum()


class Paper:
    def set_parameters(self, p):
        self.p = p

    def acceleration(self, state, force):
        return acceleration(state, force, self.p)

    def mass_matrix(self, state):
        return mass_matrix(state, self.p)

    def energy(self, state):
        return total_energy(state, self.p)


@pytest.fixture
def second():
    return SecondEngine()


@pytest.mark.parametrize("side", [MuJoCo, Paper], ids=["MuJoCo", "the paper"])
def test_accelerations_mass_matrices_and_energies_are_the_second_engine_s(side, second, rng):
    judged = side()
    for _ in range(STATES):
        p = random_plant(rng)
        judged.set_parameters(p)
        second.set_parameters(p)
        state, force = rng.uniform(-1.0, 1.0, 4) * SCALE, rng.uniform(-200.0, 200.0)
        for values in (
            lambda one, x=state, f=force: one.acceleration(x, f),
            lambda one, x=state: one.mass_matrix(x),
            lambda one, x=state: one.energy(x),
        ):
            actual, expected = values(judged), values(second)
            assert np.max(np.abs(actual - expected) / (1.0 + np.abs(expected))) <= TOLERANCE


def test_the_mjcf_as_it_stands_moves_alike_in_both_engines(second, rng):
    model = mujoco.MjModel.from_xml_path(str(model_file("cartpole.xml")))
    data = mujoco.MjData(model)
    for _ in range(STATES):
        state, force = rng.uniform(-1.0, 1.0, 4) * SCALE, rng.uniform(-200.0, 200.0)
        data.qpos, data.qvel, data.ctrl = state[:2], state[2:], force
        mujoco.mj_forward(model, data)
        expected = second.acceleration(state, force)
        error = np.abs(data.qacc - expected) / (1.0 + np.abs(expected))
        assert error.max() <= TOLERANCE


def test_the_second_engine_sees_a_wrong_inertia(second, rng, odd_parameters):
    side = MuJoCo()
    for judge in (side, second):
        judge.set_parameters(odd_parameters)
    side.cart_pole.mj_model.body("pole").inertia[1] *= 1.0 + 1e-9
    state = rng.uniform(-1.0, 1.0, 4) * SCALE
    difference = side.acceleration(state, 1.0) - second.acceleration(state, 1.0)
    assert np.abs(difference).max() > TOLERANCE
