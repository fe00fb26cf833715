"""The scenario files of a campaign: one folder, replaced as a whole, so that runs never mix."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from afl_mujoco.errors import FileError
from afl_mujoco.files import hidden_folder
from afl_mujoco.scenario.files import Replay, save_scenario
from afl_mujoco.scenario.sample_space import sample_scenario
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.studies.monte_carlo.result import FOLDER, NAMES, Result

_OURS = re.compile(r"failure-\d{4,}\.toml|" + "|".join(map(re.escape, NAMES.values())))


def require(folder: Path) -> None:
    """Raise if the folder of the scenario files holds anything that a campaign did not write."""
    held = folder / FOLDER
    if not held.exists():
        return
    if not held.is_dir() or held.is_symlink():
        raise FileError(str(held), "must be a folder that this study wrote: it is replaced")
    for path in sorted(held.rglob("*")):
        level = len(path.relative_to(held).parts)
        ours = path.is_dir() if level == 1 else level == 2 and _OURS.fullmatch(path.name)
        if path.is_symlink() or not ours:
            rule = "was not written by this study, which replaces its folder: move it away"
            raise FileError(str(path), rule)


def write(result: Result, folder: Path) -> list[Path]:
    """Write a scenario file of each failure kept and of each worst case, in place of older ones."""
    require(folder)
    space, seed = result.space, result.seed
    scenarios: dict[str, Scenario] = {
        failure.file: sample_scenario(space, failure.index, seed)
        for rates in result.controllers
        for failure in rates.failures
        if failure.file
    }
    scenarios |= {one.file: result.scenario_of(one) for one in result.worst_cases}
    replays = {
        rates.controller: Replay(
            controller=rates.asked, integrator=result.integrator, timestep=result.timestep
        )
        for rates in result.controllers
    }
    _replace(folder, replays, scenarios)
    return [folder / FOLDER]


def _replace(
    folder: Path, replays: Mapping[str, Replay], scenarios: Mapping[str, Scenario]
) -> None:
    """Write the files into a staging folder, then put them in place of those that are there."""
    with hidden_folder(folder, FOLDER) as staging:
        try:
            for name in replays:
                (staging / FOLDER / name).mkdir(parents=True)
            for file, scenario in scenarios.items():
                save_scenario(scenario, staging / file, replay=replays[Path(file).parent.name])
            if (folder / FOLDER).exists():
                (folder / FOLDER).rename(staging / "before")
            (staging / FOLDER).rename(folder / FOLDER)
        except OSError as error:
            raise FileError.cannot_be("written", folder / FOLDER, error) from None
        finally:
            before = staging / "before"
            if not (folder / FOLDER).exists() and before.exists():  # a Ctrl-C in between
                before.rename(folder / FOLDER)
