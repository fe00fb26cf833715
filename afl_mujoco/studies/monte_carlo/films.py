"""The films of a campaign: the hardest sample found for each controller."""

from __future__ import annotations

from pathlib import Path

from afl_mujoco.films.listing import REMOVE, load_listing, unlist_films
from afl_mujoco.studies.monte_carlo.result import Result
from afl_mujoco.studies.monte_carlo.study import STUDY
from afl_mujoco.studies.monte_carlo.worst_case import HARDEST


def require(folder: Path) -> None:
    """Raise if what the folder lists as films cannot be read."""
    load_listing(folder, REMOVE)


def write(result: Result, folder: Path, command: str) -> list[Path]:
    """Film the hardest sample of each controller, if that was asked for; older films go."""
    unlist_films(folder, lambda entry: entry.command.startswith(STUDY.command))
    if not result.film:
        return []
    from afl_mujoco.control.catalogue import find_controller
    from afl_mujoco.films.plan import side_by_side
    from afl_mujoco.films.renderer import make_films
    from afl_mujoco.films.replay import Deployment

    asked = {rates.controller: rates.asked for rates in result.controllers}
    deployment = Deployment(timestep=result.timestep, integrator=result.integrator)
    films = [
        side_by_side(
            result.scenario_of(one),
            [find_controller(asked[one.controller])],
            deployment,
            command=command,
        )
        for one in result.worst_cases
        if one.question == HARDEST and one.message is None
    ]
    return make_films(films, folder) if films else []
