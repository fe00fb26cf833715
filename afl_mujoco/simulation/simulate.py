"""The simulator of equations for callers who give a controller by its name."""

from __future__ import annotations

import functools
import threading
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.catalogue import as_controller
from afl_mujoco.plants.plant import Plant
from afl_mujoco.plants.tree import Tree
from afl_mujoco.scenario.files import as_scenario
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation import ode
from afl_mujoco.simulation.linear import bound, plant_model
from afl_mujoco.simulation.trajectory import Trajectory


@functools.wraps(ode.simulate_ode)
def simulate_ode(scenario: Scenario | str | Path, controller: Any, **settings: Any) -> Trajectory:
    """Bind the controller to the plant, which the equations' side cannot: it knows no engine."""
    known = as_scenario(scenario)
    own = bound(as_controller(controller), known)
    return ode.simulate_ode(known, own, trees=trees_of(known.plant), **settings)


def trees_of(plant: Plant) -> ode.Trees:
    """Return what gives the tree of a plant at rest, and as it moves under rates of parameters."""

    def trees(values: NDArray[np.float64], rates: NDArray[np.float64]) -> tuple[Tree, Tree]:
        model = plant_model(plant, threading.get_ident())
        still = Tree(**model.tree(model.rows(values)[0]))
        return still, still._replace(drift=model.drift(values[None], rates[None])[0])

    return trees
