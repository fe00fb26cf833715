"""The films of a comparison: its controllers side by side."""

from __future__ import annotations

from pathlib import Path

from afl_mujoco.films.listing import REMOVE, load_listing, unlist_films
from afl_mujoco.studies.compare.result import Result
from afl_mujoco.studies.compare.study import STUDY


def require(folder: Path) -> None:
    """Raise if what the folder lists as films cannot be read."""
    load_listing(folder, REMOVE)


def write(result: Result, folder: Path, command: str) -> list[Path]:
    """Film the controllers side by side, an MP4 for each scenario, if that was asked for.

    Films of an earlier comparison go: they would stand beside numbers that are not theirs.
    """
    asked = result.film
    unlist_films(folder, lambda entry: entry.command.startswith(STUDY.command))
    if asked is None:
        return []
    from afl_mujoco.control.catalogue import find_controller
    from afl_mujoco.films.plan import side_by_side
    from afl_mujoco.films.renderer import make_films
    from afl_mujoco.films.replay import Deployment

    controllers = [find_controller(name, asked.gain_labels) for name in asked.controllers]
    deployment = Deployment(
        timestep=result.timestep,
        control_period=result.control_period,
        integrator=result.integrator,
    )
    films = []
    for scenario in result.scenarios:
        runs = zip(controllers, result.runs_on(scenario), strict=True)
        shown = [controller for controller, run in runs if run.metrics]  # the others failed
        if shown:
            films.append(side_by_side(scenario, shown, deployment, command=command))
    return make_films(films, folder) if films else []
