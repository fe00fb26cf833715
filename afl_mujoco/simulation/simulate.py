"""The simulator of equations for callers who give a controller by its name."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

from afl_mujoco.control.catalogue import as_controller
from afl_mujoco.scenario.files import as_scenario
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation import ode
from afl_mujoco.simulation.linear import bound
from afl_mujoco.simulation.trajectory import Trajectory


@functools.wraps(ode.simulate_ode)
def simulate_ode(scenario: Scenario | str | Path, controller: Any, **settings: Any) -> Trajectory:
    """Bind the controller to the plant, which the equations' side cannot: it knows no engine."""
    known = as_scenario(scenario)
    return ode.simulate_ode(known, bound(as_controller(controller), known), **settings)
