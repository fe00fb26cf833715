"""Checks of the equations themselves, without a closed loop: A1, A2, A3 and A7."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from afl_mujoco.control.gains import FIXED_GAINS
from afl_mujoco.control.law import control_force
from afl_mujoco.plant.dynamics import (
    cart_acceleration,
    mass_matrix,
    pole_acceleration,
    velocity_jump,
)
from afl_mujoco.scenario.parameters import NOMINAL, CartPoleParameters
from afl_mujoco.simulation.mujoco_model import CartPoleModel, forward, impulse_jump
from afl_mujoco.simulation.mujoco_rollout import momenta
from afl_mujoco.studies.verification.check import Check
from afl_mujoco.studies.verification.criteria import CRITERIA

STATES = 10_000
PLANTS = 100
_LOW = {"cart_mass": 0.1, "pole_mass": 0.01, "half_length": 0.05, "gravity": 1.0}
_HIGH = {"cart_mass": 2.0, "pole_mass": 0.5, "half_length": 1.0, "gravity": 20.0}


def equation_checks(seed: int = 0) -> tuple[Check, ...]:
    """Run A1, A2, A3 and A7."""
    return (
        CRITERIA["A1"].judge(acceleration_error(np.random.default_rng([seed, 1]))),
        CRITERIA["A2"].judge(mass_matrix_error(np.random.default_rng([seed, 2]))),
        CRITERIA["A3"].judge(stale_numbers(np.random.default_rng([seed, 3]))),
        *_symmetry_checks(np.random.default_rng([seed, 7])),
    )


def random_plant(rng: np.random.Generator) -> CartPoleParameters:
    """Return a plant drawn from the whole box of parameters."""
    return CartPoleParameters(**{key: rng.uniform(_LOW[key], _HIGH[key]) for key in _LOW})


def acceleration_error(rng: np.random.Generator, states: int = STATES) -> float:
    """Return the largest scaled difference between MuJoCo's qacc and (P3), (P4)."""
    model = CartPoleModel(NOMINAL)
    worst = 0.0
    for _ in range(states):
        p = random_plant(rng)
        z, phi, z_dot, phi_dot = rng.uniform(-1.0, 1.0, 4) * (10.0, np.pi, 10.0, 10.0)
        force = rng.uniform(-200.0, 200.0)
        model.set_parameters(p)
        measured = np.array(forward(model.addresses, z, phi, z_dot, phi_dot, force, 0.0))
        plant = (p.cart_mass, p.pole_mass, p.half_length, p.gravity)
        expected = np.array(
            [
                cart_acceleration(phi, phi_dot, force, *plant),
                pole_acceleration(phi, phi_dot, force, *plant),
            ]
        )
        error = np.abs(measured - expected) / (1.0 + np.abs(expected))
        worst = max(worst, float(error.max())) if np.isfinite(error).all() else np.inf
    return worst


def mass_matrix_error(rng: np.random.Generator, states: int = 1000) -> float:
    """Return the largest relative difference between MuJoCo's mass matrix and the analytic one.

    The velocity jump under an ideal impulse, which follows from its inverse, counts as well.
    """
    model = CartPoleModel(NOMINAL)
    worst = 0.0
    for _ in range(states):
        p = random_plant(rng)
        state = np.array([0.0, rng.uniform(-np.pi, np.pi), 0.0, 0.0])
        model.set_parameters(p)
        columns = [momenta(model, np.array([*state[:2], *unit])) for unit in np.eye(2)]
        expected = mass_matrix(state, p)
        error = np.abs(np.stack(columns, axis=1) - expected) / np.abs(expected).max()
        jumped = np.array(impulse_jump(model.addresses, *state.tolist(), 1.0))
        jump = velocity_jump(state, 1.0, p)
        jump_error = np.abs(jumped - jump).max() / np.abs(jump).max()
        worst = max(worst, float(error.max()), float(jump_error))
    return worst


def _symmetry_checks(rng: np.random.Generator) -> tuple[Check, ...]:
    """Run A7."""
    exact, shifted = asymmetry(rng)
    return CRITERIA["A7"].judge(exact), CRITERIA["A7z"].judge(shifted)


def asymmetry(rng: np.random.Generator, states: int = 1000) -> tuple[float, float]:
    """Return how far MuJoCo's accelerations and the controller's force are from the symmetries.

    Mirrored states and forces give mirrored accelerations and controller forces; a shift along z
    changes no acceleration, and neither do twice the masses under twice the force.
    """
    model = CartPoleModel(NOMINAL)
    exact = shift = 0.0
    for _ in range(states):
        p = random_plant(rng)
        state = rng.uniform(-1.0, 1.0, 4) * (10.0, 1.5, 10.0, 10.0)
        force = rng.uniform(-200.0, 200.0)
        at = model.addresses
        model.set_parameters(p)
        here = np.array(forward(at, *state.tolist(), force, 0.0))
        mirrored = np.array(forward(at, *(-state).tolist(), -force, 0.0))
        shifted = np.array(forward(at, float(state[0]) + 1.0, *state[1:].tolist(), force, 0.0))
        model.set_parameters(replace(p, cart_mass=2 * p.cart_mass, pole_mass=2 * p.pole_mass))
        scaled = np.array(forward(at, *state.tolist(), 2.0 * force, 0.0))
        odd = control_force(state, p, FIXED_GAINS) + control_force(-state, p, FIXED_GAINS)
        exact = max(exact, float(np.abs([here + mirrored, here - scaled]).max()), float(abs(odd)))
        shift = max(shift, float((np.abs(here - shifted) / (1.0 + np.abs(here))).max()))
    return exact, shift


def stale_numbers(rng: np.random.Generator, plants: int = PLANTS) -> int:
    """Count the numbers in which a mutated model, or its qacc, differs from a fresh compile.

    Parameters
    ----------
    plants
        Number of random plants; one model takes all of them in turn.
    """
    mutated = CartPoleModel(NOMINAL, edit=add_passive_physics)
    stale = 0
    for _ in range(plants):
        p = random_plant(rng)
        mutated.set_parameters(p)
        fresh = CartPoleModel(p, edit=add_passive_physics)
        stale += differing_numbers(mutated.mj_model, fresh.mj_model)
        state = rng.uniform(-1.0, 1.0, 4) * (1.2, np.pi, 5.0, 5.0)
        stale += int(np.sum(_qacc(mutated, state) != _qacc(fresh, state)))
    return stale


def differing_numbers(one: mujoco.MjModel, other: mujoco.MjModel) -> int:
    """Count the elements in which the arrays of two models differ; `stat` is left out."""
    count = 0
    for owner, twin in ((one, other), (one.opt, other.opt)):
        for name in dir(owner):
            array = getattr(owner, name)
            if not name.startswith("_") and isinstance(array, np.ndarray):
                count += int(np.sum(array != getattr(twin, name)))
    return count


def add_passive_physics(spec: mujoco.MjSpec) -> None:
    """Add friction, limits and contact, which reveal stale derived constants."""
    for name, reach in (("slider", 1.0), ("hinge", 2.5)):
        joint = spec.joint(name)
        joint.frictionloss, joint.damping, joint.armature = 0.05, [0.02, 0.0, 0.0], 0.001
        joint.limited, joint.range = mujoco.mjtLimited.mjLIMITED_TRUE, [-reach, reach]
    pole = spec.geom("pole")
    pole.contype = pole.conaffinity = 1
    spec.worldbody.add_geom(
        name="ground",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[10, 10, 0.1],
        pos=[0, 0, -0.3],
        contype=1,
        conaffinity=1,
    )


def _qacc(model: CartPoleModel, state: np.ndarray) -> np.ndarray:
    """Return MuJoCo's accelerations at a state, solved from a cold start."""
    mujoco.mj_resetData(model.mj_model, model.mj_data)
    return np.array(forward(model.addresses, *state.tolist(), 3.0, 0.0))
