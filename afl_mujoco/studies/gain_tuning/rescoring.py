"""Tuned gains scored again in MuJoCo, to confirm their scores in the ideal ODE."""

from __future__ import annotations

from afl_mujoco.control.catalogue import AFLController
from afl_mujoco.control.gain_function import GAIN_NAMES, GainFunction
from afl_mujoco.control.gains import Gains
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.schedules import constant
from afl_mujoco.simulation.batch import ObjectiveScales
from afl_mujoco.simulation.metrics import metrics
from afl_mujoco.simulation.mujoco_rollout import simulate_mujoco
from afl_mujoco.simulation.scoring import with_objective

TIMESTEP = 1e-3
"""Step of MuJoCo's RK4, with the controller in every stage [s]."""

Unit = tuple[list[float], ObjectiveScales]


def mujoco_objective(unit: Unit) -> float | None:
    """Return the objective (O1) of a row of the gain table in MuJoCo; None if the pole fell.

    Parameters
    ----------
    unit
        The row, (M, l, K, lambda, Phi, ...), and the scales of the objective.
    """
    (mass, length, *gains), scales = unit
    found = Gains(**dict(zip(GAIN_NAMES, gains[:3], strict=True)))
    controller = AFLController(name="row", gain_function=GainFunction.constant(found))
    scenario = Scenario(name="row", cart_mass=constant(mass), half_length=constant(length))
    run = simulate_mujoco(scenario, controller, "continuous", timestep=TIMESTEP)
    return with_objective(metrics(scenario, controller, run), scales)["objective"]
