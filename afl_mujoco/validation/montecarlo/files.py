"""The scenario files of a campaign: one folder, replaced as a whole, so that runs never mix."""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from afl_mujoco.errors import FileError
from afl_mujoco.scenario.files import Replay, save_scenario
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.validation.montecarlo.campaign import Campaign
from afl_mujoco.validation.montecarlo.space import sample_scenario
from afl_mujoco.validation.montecarlo.worst_case import HARDEST, NEAREST, Found

FOLDER = "montecarlo"
"""Holds a folder for each controller."""

NAMES = {HARDEST: "hardest.toml", NEAREST: "nearest-failure.toml"}
"""Of the files of what a search found."""

_OURS = re.compile(r"failure-\d{4,}\.toml|" + "|".join(map(re.escape, NAMES.values())))


def failure_file(name: str, index: int) -> str:
    """Return where the file of a failure lies, seen from the folder of the study.

    Parameters
    ----------
    name
        Of the controller.
    index
        Of the sample.
    """
    return f"{FOLDER}/{name}/failure-{index:04d}.toml"


def kept_failures(campaign: Campaign, name: str, keep: int | None) -> list[int]:
    """Return the samples whose files are kept, the first that a controller did not survive.

    Parameters
    ----------
    campaign
        The campaign.
    name
        Of the controller.
    keep
        How many at most; ``None`` for all.
    """
    return campaign.failures(name)[:keep]


def require_ours(folder: Path) -> None:
    """Raise if the folder of the scenario files holds anything that a campaign did not write.

    Parameters
    ----------
    folder
        Of the study.

    Raises
    ------
    FileError
        If it does: it would be lost.
    """
    held = folder / FOLDER
    if not held.exists():
        return
    if not held.is_dir() or held.is_symlink():
        raise FileError(str(held), "must be a folder of this study, which replaces it")
    for path in sorted(held.rglob("*")):
        level = len(path.relative_to(held).parts)
        ours = path.is_dir() if level == 1 else level == 2 and _OURS.fullmatch(path.name)
        if path.is_symlink() or not ours:
            rule = "is not of this study, which replaces its folder: move it away"
            raise FileError(str(path), rule)


def write_scenarios(
    campaign: Campaign,
    found: Sequence[Found],
    folder: Path,
    *,
    keep: int | None = None,
    asked: Mapping[str, str] | None = None,
) -> Path:
    """Write the failures and what the searches found, in place of an earlier campaign's.

    Parameters
    ----------
    campaign, found
        What to write.
    folder
        Of the study; it must exist.
    keep
        How many failures of each controller at most; ``None`` for all.
    asked
        What each controller was asked for by, where that is not its name.

    Returns
    -------
    Path
        The folder of the scenario files.

    Raises
    ------
    FileError
        If it cannot be written, or holds anything else.
    """
    require_ours(folder)
    scenarios: dict[str, Scenario] = {
        failure_file(name, i): sample_scenario(campaign.space, i, campaign.seed)
        for name in campaign.trials
        for i in kept_failures(campaign, name, keep)
    }
    scenarios |= {found_file(one): one.scenario for one in found}
    names = {name: name for name in campaign.trials} | dict(asked or {})
    integrator = campaign.settings.integrator
    replays = {name: Replay(controller=names[name], integrator=integrator) for name in names}
    _replace(folder, replays, scenarios)
    return folder / FOLDER


def found_file(found: Found) -> str:
    """Return where the file of what a search found lies, seen from the folder of the study.

    Parameters
    ----------
    found
        What it found.
    """
    return f"{FOLDER}/{found.controller}/{NAMES[found.question]}"


def _replace(
    folder: Path, replays: Mapping[str, Replay], scenarios: Mapping[str, Scenario]
) -> None:
    """Write the files aside, then put them in place of those that are there."""
    try:
        aside = Path(tempfile.mkdtemp(dir=folder, prefix=f".{FOLDER}-"))
    except OSError as error:
        raise FileError.cannot_be("written", folder, error) from None
    try:
        for name in replays:
            (aside / FOLDER / name).mkdir(parents=True)
        for file, scenario in scenarios.items():
            save_scenario(scenario, aside / file, replay=replays[Path(file).parent.name])
        if (folder / FOLDER).exists():
            (folder / FOLDER).rename(aside / "before")
        (aside / FOLDER).rename(folder / FOLDER)
    except OSError as error:
        raise FileError.cannot_be("written", folder / FOLDER, error) from None
    finally:
        if not (folder / FOLDER).exists() and (aside / "before").exists():  # a Ctrl-C in between
            (aside / "before").rename(folder / FOLDER)
        shutil.rmtree(aside, ignore_errors=True)
