"""The configuration of a validation against recordings, and its run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from afl_mujoco.errors import InvalidValueError, UnknownNameError, require_count
from afl_mujoco.studies.contract import Progress, Study, silent

if TYPE_CHECKING:
    from pathlib import Path

    from afl_mujoco.identification.identify import Identified
    from afl_mujoco.identification.log import Log
    from afl_mujoco.studies.hardware.result import Result


@dataclass(frozen=True, kw_only=True)
class Hardware:
    """Judge the identified model on recordings of a real cart-pole that it was not fitted to.

    Example: afl-mujoco hardware --logs my-logs --estimates renders/my-rig/estimates.json

    Reports the errors by horizon, each term of the equations, verdicts by a protocol that was fixed
    beforehand, and what controllers would do on that cart-pole. The exit code is 1 if one
    statement does not hold, or the recordings can decide none, else 0.
    """

    logs: str | None = None
    """Folder of recordings; by default those that come with the package and were not fitted."""
    estimates: str | None = None
    """Estimates that `afl-mujoco identify` wrote; by default those that come with the package."""
    draws: int = 200
    """Cart-poles drawn from the distribution of the estimates, on which controllers run."""
    seed: int = 1
    """Seed of the draws."""


def check(configuration: Hardware) -> None:
    """Raise if the configuration breaks a rule."""
    c = configuration
    require_count("draws", c.draws, 0, MOST_DRAWS)
    if not 0 <= c.seed < 2**63:
        raise InvalidValueError("seed", "must lie in 0 to 2**63 - 1", c.seed)
    _asked(c)


def run(configuration: Hardware, *, progress: Progress = silent, workers: int = 1) -> Result:
    """Judge the model on the recordings."""
    from afl_mujoco.studies.hardware.validation import validate

    c = configuration
    logs, identified, source = _asked(c)
    return validate(
        logs, identified, source, draws=c.draws, seed=c.seed, workers=workers, progress=progress
    )


def _asked(configuration: Hardware) -> tuple[list[Log], Identified, str]:
    """Return the recordings, the estimates and where the recordings are, or raise."""
    from pathlib import Path

    from afl_mujoco.identification.log import read_logs
    from afl_mujoco.identification.prediction import CHOOSE, ESTIMATES, load_estimates
    from afl_mujoco.studies.hardware.protocol import load_protocol

    c = configuration
    identified = load_estimates(ESTIMATES if c.estimates is None else Path(c.estimates))
    if c.estimates is not None and c.logs is None:
        raise InvalidValueError("logs", "must be given with estimates of another cart-pole")
    if identified.drive is None:
        raise InvalidValueError("estimates", "must include cart and drive: vary the command")
    known = [one.id for one in load_protocol().statements]
    for name in identified.description.limits:
        if name not in known:
            raise UnknownNameError.among("limits", name, known)
    folder = CHOOSE if c.logs is None else Path(c.logs)
    logs = read_logs([folder], identified.description)
    return logs, identified, _name(folder) if c.logs is None else c.logs


def _name(folder: Path) -> str:
    """Return the name of a folder that comes with the package."""
    return f"{folder.name}/, which comes with the package"


MOST_DRAWS = 100_000

STUDY = Study(
    name="hardware",
    title="Measured hardware",
    order=81,
    schema=1,
    configuration=Hardware,
    check=check,
    run=run,
)
