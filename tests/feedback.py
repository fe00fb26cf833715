"""State feedback with the same gains for every plant."""

import numpy as np

from afl_mujoco.control.cartpole_feedback import Design, StateFeedback
from afl_mujoco.control.controller import LINEAR


def feedback(*gains: float) -> StateFeedback:
    design = Design(lambda plant: np.array(gains), {})
    return StateFeedback(name="feedback", kind=LINEAR, design=design)
