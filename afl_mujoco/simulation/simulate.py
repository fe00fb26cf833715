"""The simulators of equations for callers whose controller is not bound to the plant yet."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.polynomial.chebyshev import chebval

from afl_mujoco.control.catalogue import as_controller
from afl_mujoco.plants.plant import Floats, Plant
from afl_mujoco.plants.tree import Tree
from afl_mujoco.scenario.files import as_scenario
from afl_mujoco.scenario.scenario import Scenario, Segment
from afl_mujoco.simulation import ode, ode_fixed_step
from afl_mujoco.simulation.bound_controllers import bound, plant_model
from afl_mujoco.simulation.mujoco_model import SimulatedModel
from afl_mujoco.simulation.mujoco_rollout import Line, line_of
from afl_mujoco.simulation.trajectory import Trajectory


def _binding(simulate: Callable[..., Trajectory]) -> Callable[..., Trajectory]:
    """Bind the controller to the plant, which the equations' side cannot: it knows no engine."""

    @functools.wraps(simulate)
    def simulated(scenario: Scenario | str | Path, controller: Any, **settings: Any) -> Trajectory:
        known = as_scenario(scenario)
        return simulate(known, bound(as_controller(controller), known), **settings)

    return simulated


@functools.wraps(ode.simulate_ode)
def _simulate_ode(scenario: Scenario, controller: Any, **settings: Any) -> Trajectory:
    return ode.simulate_ode(scenario, controller, trees=MovingTrees(scenario.plant), **settings)


simulate_ode = _binding(_simulate_ode)
simulate_ode_held = _binding(ode_fixed_step.simulate_ode_held)
simulate_ode_rk4 = _binding(ode_fixed_step.simulate_ode_rk4)


class MovingTrees:
    """The tree of a plant at rest, and as it moves under rates of parameters."""

    def __init__(self, plant: Plant) -> None:
        self.plant = plant
        self._lines: dict[Segment, Line] = {}
        self._model: SimulatedModel | None = None

    def at(self, values: Floats, rates: Floats) -> tuple[Tree, Tree]:
        """Return both with some parameters and rates."""
        model = plant_model(self.plant)
        return self._trees(model.rows(values)[0], model.drift(values[None], rates[None])[0])

    def along(self, segment: Segment, time: float) -> tuple[Tree, Tree]:
        """Return both at a time of a segment, from what is written along it."""
        if (line := self._lines.get(segment)) is None:
            self._model = self._model or SimulatedModel(self.plant)
            self._lines = {segment: (line := line_of(self._model, segment))}
        x = 2.0 * (time - line.start) / line.length - 1.0
        row, drift = (np.asarray(chebval(x, one.T)) for one in (line.course, line.drift))
        return self._trees(row, drift.reshape(-1, 5, 3))

    def _trees(self, row: Floats, drift: Floats) -> tuple[Tree, Tree]:
        still = Tree(**plant_model(self.plant).tree(row))
        return still, still._replace(drift=drift)
