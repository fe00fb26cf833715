"""State feedback with the same gains for every plant, and the force of any controller."""

import numpy as np

import afl_mujoco as afl
from afl_mujoco.control.cartpole_feedback import Design, StateFeedback
from afl_mujoco.control.controller import LINEAR


def feedback(*gains: float) -> StateFeedback:
    design = Design(lambda plant: np.array(gains), {})
    return StateFeedback(name="feedback", kind=LINEAR, design=design)


def force_of(controller, state, p: afl.CartPoleParameters) -> float:
    told = np.array([p.cart_mass, p.pole_mass, p.half_length, p.gravity])
    return float(controller.command(0.0, state, controller.assumed(told)))
