"""Validation of nonlinear controllers in MuJoCo, of a cart-pole and of any hinges and slides.

The public names; each is imported on first use, so that importing the package and
``afl-mujoco --help`` take next to no time.
"""

from __future__ import annotations

import sys

if sys.argv[:1] == ["-m"] and not sys.flags.safe_path:
    # python -m has put the working directory first, where any mujoco.py or typing.py would be taken
    # for the real one; last, it still has a user's own controllers.
    sys.path.append(sys.path.pop(0))

from importlib import import_module
from time import time
from typing import TYPE_CHECKING

STARTED = time()  # when the package was imported [s]

if TYPE_CHECKING:
    from afl_mujoco.control.catalogue import CONTROLLERS, AFLController, find_controller
    from afl_mujoco.control.controller import Controller
    from afl_mujoco.control.gains import FIXED_GAINS, GainFunction, Gains
    from afl_mujoco.control.law import control_force, sliding_variable
    from afl_mujoco.errors import AflMujocoError
    from afl_mujoco.plants.cartpole_equations import (
        acceleration,
        linear_momentum,
        mass_matrix,
        total_energy,
    )
    from afl_mujoco.plants.equations import from_sympy
    from afl_mujoco.plants.plant import Parameter, Plant, ball, box, rod
    from afl_mujoco.scenario.catalogue import SCENARIOS
    from afl_mujoco.scenario.files import find_scenario, load_scenario, save_scenario
    from afl_mujoco.scenario.imperfections import Imperfections
    from afl_mujoco.scenario.parameters import CartPoleParameters
    from afl_mujoco.scenario.requirements import Requirements
    from afl_mujoco.scenario.scenario import Scenario
    from afl_mujoco.scenario.schedules import (
        ForcePulse,
        Impulse,
        Schedule,
        constant,
        joined,
        piecewise_linear,
        staircase,
        trapezoid,
    )
    from afl_mujoco.scenario.time_steps import Deployed
    from afl_mujoco.simulation.mujoco_model import CartPoleModel
    from afl_mujoco.simulation.mujoco_rollout import simulate_mujoco
    from afl_mujoco.simulation.ode import simulate_ode
    from afl_mujoco.simulation.ode_fixed_step import simulate_ode_held, simulate_ode_rk4
    from afl_mujoco.simulation.task import load
    from afl_mujoco.simulation.trajectory import Outcome, Trajectory
    from afl_mujoco.studies.check import check
    from afl_mujoco.studies.compare import compare
    from afl_mujoco.studies.shared.run import Run, run_all

    __version__: str

_HOMES = {
    "control.law": ("control_force", "sliding_variable"),
    "control.catalogue": ("CONTROLLERS", "AFLController", "find_controller"),
    "control.gains": ("FIXED_GAINS", "GainFunction", "Gains"),
    "control.controller": ("Controller",),
    "errors": ("AflMujocoError",),
    "plants.cartpole_equations": ("acceleration", "linear_momentum", "mass_matrix", "total_energy"),
    "plants.equations": ("from_sympy",),
    "plants.plant": ("Parameter", "Plant", "ball", "box", "rod"),
    "scenario.catalogue": ("SCENARIOS",),
    "scenario.files": ("find_scenario", "load_scenario", "save_scenario"),
    "scenario.parameters": ("CartPoleParameters",),
    "scenario.imperfections": ("Imperfections",),
    "scenario.requirements": ("Requirements",),
    "scenario.scenario": ("Scenario",),
    "scenario.schedules": (
        "ForcePulse",
        "Impulse",
        "Schedule",
        "constant",
        "joined",
        "piecewise_linear",
        "staircase",
        "trapezoid",
    ),
    "scenario.time_steps": ("Deployed",),
    "simulation.mujoco_model": ("CartPoleModel",),
    "simulation.mujoco_rollout": ("simulate_mujoco",),
    "simulation.simulate": ("simulate_ode", "simulate_ode_held", "simulate_ode_rk4"),
    "simulation.task": ("load",),
    "simulation.trajectory": ("Outcome", "Trajectory"),
    "studies.check": ("check",),
    "studies.compare": ("compare",),
    "studies.shared.run": ("Run", "run_all"),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__all__ = [
    "CONTROLLERS",
    "FIXED_GAINS",
    "SCENARIOS",
    "AFLController",
    "AflMujocoError",
    "CartPoleModel",
    "CartPoleParameters",
    "Controller",
    "Deployed",
    "ForcePulse",
    "GainFunction",
    "Gains",
    "Imperfections",
    "Impulse",
    "Outcome",
    "Parameter",
    "Plant",
    "Requirements",
    "Run",
    "Scenario",
    "Schedule",
    "Trajectory",
    "__version__",
    "acceleration",
    "ball",
    "box",
    "check",
    "compare",
    "constant",
    "control_force",
    "find_controller",
    "find_scenario",
    "from_sympy",
    "joined",
    "linear_momentum",
    "load",
    "load_scenario",
    "mass_matrix",
    "piecewise_linear",
    "rod",
    "run_all",
    "save_scenario",
    "simulate_mujoco",
    "simulate_ode",
    "simulate_ode_held",
    "simulate_ode_rk4",
    "sliding_variable",
    "staircase",
    "total_energy",
    "trapezoid",
]


def __getattr__(name: str) -> object:
    """Import a public name from its home on first use."""
    if name == "__version__":
        return import_module("importlib.metadata").version(__name__)
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOME_OF[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """List the public names."""
    return sorted(__all__)


import_module(f"{__name__}.simulation.gym_env.registration").register_with_gymnasium()
