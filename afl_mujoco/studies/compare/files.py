"""The films of a comparison: its controllers side by side."""

from __future__ import annotations

import shlex
from pathlib import Path

from afl_mujoco.films.listing import load_listing
from afl_mujoco.studies.compare.result import Result

REMOVE = "remove it"


def require(folder: Path) -> None:
    """Raise if what the folder lists as films cannot be read."""
    load_listing(folder, REMOVE)


def write(result: Result, folder: Path) -> list[Path]:
    """Film the controllers side by side, an MP4 for each scenario, if that was asked for."""
    asked = result.film
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
    films = [
        side_by_side(
            scenario,
            controllers,
            deployment=deployment,
            command=shlex.join(
                ("afl-mujoco", "compare", name, "--controllers", *asked.controllers, "--film")
            ),
        )
        for scenario, name in zip(result.scenarios, asked.scenarios, strict=True)
    ]
    return make_films(films, folder)
