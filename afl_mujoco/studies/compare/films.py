"""The films of a comparison: its controllers side by side."""

from __future__ import annotations

from typing import TYPE_CHECKING

from afl_mujoco.studies.compare.result import Result

if TYPE_CHECKING:
    from afl_mujoco.films.plan import Film


def films(result: Result, command: str) -> list[Film]:
    """Return a film of the controllers side by side for each scenario, if asked for."""
    asked = result.film
    if asked is None:
        return []
    from afl_mujoco.control.catalogue import find_controller
    from afl_mujoco.films.plan import side_by_side
    from afl_mujoco.films.replay import Deployment

    controllers = [find_controller(name) for name in asked.controllers]
    deployment = Deployment(
        timestep=result.timestep,
        control_period=result.control_period,
        integrator=result.integrator,
    )
    found = []
    for scenario in result.scenarios:
        runs = zip(controllers, result.runs_on(scenario, draw=0), strict=True)
        shown = [controller for controller, run in runs if run.metrics]  # the others failed
        if shown:
            found.append(side_by_side(scenario, shown, deployment, command=command))
    return found
