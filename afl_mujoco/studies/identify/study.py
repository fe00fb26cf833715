"""The configuration of an identification, and its run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import tyro

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.studies.contract import Progress, Study, silent

if TYPE_CHECKING:
    from afl_mujoco.identification.description import Description
    from afl_mujoco.identification.log import Log
    from afl_mujoco.studies.identify.result import Result


@dataclass(frozen=True, kw_only=True)
class Identify:
    """Identify a cart-pole from its logs: the pole alone, then the whole in MuJoCo.

    Example: afl-mujoco identify logs/*.csv --description my-rig.toml --out renders/my-rig

    Writes identify.json, estimates.json for `afl-mujoco hardware`, and identified.toml, the
    cart-pole as a scenario for every other command. Takes a minute or two for 40 logs of 5 s.
    """

    logs: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[LOG ...]")] = ()
    """Logs, CSV files or folders of them; by default the recordings that come with the package."""
    description: str | None = None
    """TOML file that says what their columns mean and what is known about the cart-pole; required
    for your own logs."""


def check(configuration: Identify) -> None:
    """Raise if the configuration breaks a rule."""
    _asked(configuration)


def run(configuration: Identify, *, progress: Progress = silent, workers: int = 1) -> Result:
    """Identify the cart-pole."""
    from afl_mujoco.identification.identify import identify
    from afl_mujoco.studies.identify.result import result_of

    logs, description = _asked(configuration)
    identified = identify(
        logs,
        description,
        workers=workers,
        progress=lambda done, total: progress("identifying", done, total),
    )
    return result_of(identified, logs)


def _asked(configuration: Identify) -> tuple[list[Log], Description]:
    """Return the logs and what they mean, or raise."""
    from afl_mujoco.identification.description import load_description
    from afl_mujoco.identification.log import read_logs
    from afl_mujoco.identification.prediction import DESCRIPTION, FIT

    c = configuration
    if c.logs and c.description is None:
        raise InvalidValueError("description", "must be given with logs: --description RIG.toml")
    if c.description is not None and not c.logs:
        raise InvalidValueError("logs", "must be given with a description")
    description = load_description(DESCRIPTION if c.description is None else c.description)
    return read_logs(c.logs or [FIT], description), description


STUDY = Study(
    name="identify",
    title="A cart-pole identified",
    order=80,
    schema=1,
    configuration=Identify,
    check=check,
    run=run,
)
