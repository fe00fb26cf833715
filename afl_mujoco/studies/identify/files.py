"""The files of an identification that other commands read."""

from __future__ import annotations

from pathlib import Path

from afl_mujoco.files import remove_file, require_no_folder, write_json
from afl_mujoco.scenario.files import save_scenario
from afl_mujoco.studies.identify.result import Result

ESTIMATES, SCENARIO = "estimates.json", "identified.toml"


def require(folder: Path) -> None:
    """Raise if a folder is in the way of the files."""
    require_no_folder(folder, (ESTIMATES, SCENARIO))


def write(result: Result, folder: Path) -> list[Path]:
    """Write the estimates, and the scenario if a drive was identified."""
    from afl_mujoco.identification.export import scenario_of

    write_json(folder / ESTIMATES, result.identified)
    remove_file(folder / SCENARIO)
    if result.identified.drive is None:
        return [folder / ESTIMATES]
    save_scenario(scenario_of(result.identified), folder / SCENARIO)
    return [folder / ESTIMATES, folder / SCENARIO]
