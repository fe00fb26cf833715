"""MuJoCo's cart-pole under one impulse, and the environment stepped by a policy."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.simulation.mujoco_model import SimulatedModel, impulse_jump, write_state


def jump(model: SimulatedModel, state: Sequence[float], impulse: float) -> NDArray[np.float64]:
    found = np.empty(2)
    write_state(model.addresses, np.array(state))
    impulse_jump(model.addresses, np.array([impulse, 0.0]), found)
    return found


def episode(environment, policy):
    """Return the true states of an episode, and its last step."""
    step, states = environment.reset(), [environment.physics.world.state]
    while not step.last():
        step = environment.step(policy(step))
        states.append(environment.physics.world.state)
    return np.array(states), step
