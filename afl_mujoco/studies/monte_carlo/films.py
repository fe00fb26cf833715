"""The films of a campaign: the hardest sample found for each controller."""

from __future__ import annotations

from typing import TYPE_CHECKING

from afl_mujoco.studies.monte_carlo.result import Result
from afl_mujoco.studies.monte_carlo.worst_case import HARDEST

if TYPE_CHECKING:
    from afl_mujoco.films.video import Film


def films(result: Result, command: str) -> list[Film]:
    """Return a film of the hardest sample of each controller, if films were asked for."""
    if not result.film:
        return []
    from afl_mujoco.control.catalogue import find_controller
    from afl_mujoco.films.replay import Deployment
    from afl_mujoco.films.video import side_by_side

    asked = {rates.controller: rates.asked for rates in result.controllers}
    deployment = Deployment(timestep=result.timestep, integrator=result.integrator)
    return [
        side_by_side(
            result.scenario_of(one),
            [find_controller(asked[one.controller])],
            deployment,
            command=command,
        )
        for one in result.worst_cases
        if one.question == HARDEST and one.message is None
    ]
