"""Its configuration, and its run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from afl_mujoco.studies.contract import Progress, ScenarioNames, Study, silent

if TYPE_CHECKING:
    from afl_mujoco.studies.dice.result import Result


@dataclass(frozen=True, kw_only=True)
class Dice:
    """Throw dice and count the eyes.

    Example: afl-mujoco dice --throws 10
    """

    scenarios: ScenarioNames = ()
    """Scenarios by name; they only give their names."""
    throws: int = 20
    """How many throws."""
    quick: bool = False
    """Two throws."""


def check(configuration: Dice) -> None:
    """Raise at what breaks a rule."""
    from afl_mujoco.errors import InvalidValueError
    from afl_mujoco.scenario.files import find_scenario

    for name in configuration.scenarios:
        find_scenario(name)
    if configuration.throws < 1:
        raise InvalidValueError("throws", "must be at least 1", configuration.throws)


def run(configuration: Dice, *, progress: Progress = silent, workers: int = 1) -> Result:
    """Throw them."""
    import numpy as np
    from afl_mujoco.studies.dice.result import Result, Throw

    check(configuration)
    count = 2 if configuration.quick else configuration.throws
    eyes = np.random.default_rng(1).integers(1, 7, count)
    progress("throwing", count, count)
    throws = tuple(Throw(number=i, eyes=int(x)) for i, x in enumerate(eyes))
    return Result(scenarios=configuration.scenarios, throws=throws, all_eyes=eyes)


STUDY = Study(
    name="dice", title="Dice", order=99, schema=1, configuration=Dice, check=check, run=run
)
