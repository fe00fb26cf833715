"""The scenario files of the fitted readings, one for each case."""

from __future__ import annotations

from pathlib import Path

from afl_mujoco.files import remove_file, require_no_folder
from afl_mujoco.scenario.files import save_scenario
from afl_mujoco.studies.paper_readings import CASES
from afl_mujoco.studies.readings.result import Result
from afl_mujoco.studies.readings.search import GOALS

NAMES = tuple(
    f"{kind}-{goal}-{case}.toml"
    for kind in ("nearest", "round")
    for goal in GOALS
    for case in CASES
)
"""Every file that a run may write."""


def require(folder: Path) -> None:
    """Raise if a folder has the name of a scenario file."""
    require_no_folder(folder, NAMES)


def write(result: Result, folder: Path) -> list[Path]:
    """Write the scenario files in place of older ones."""
    for name in NAMES:
        remove_file(folder / name)
    written = []
    for reading in result.readings:
        for scenario in reading.scenarios:
            written.append(folder / f"{scenario.name}.toml")
            save_scenario(scenario, written[-1])
    return written
