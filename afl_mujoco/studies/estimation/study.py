"""The configuration of the study of estimation, and its run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from afl_mujoco.control.names import SUBJECT
from afl_mujoco.studies.contract import Progress, ScenarioNames, Study, counted, silent

if TYPE_CHECKING:
    from afl_mujoco.studies.estimation.loops import Unit
    from afl_mujoco.studies.estimation.result import Result

SEEDS, QUICK_SEEDS = 8, 2


@dataclass(frozen=True, kw_only=True)
class Estimation:
    """Find how well M and l are estimated online, and what this costs the closed loop.

    Example: afl-mujoco estimation step-step --seeds 2

    The controller takes M, l and the state from an extended Kalman filter, which uses the measured
    z and phi and the commanded force. Writes estimation.json, an npz of curves and a figure.
    """

    scenarios: ScenarioNames = ()
    """Scenarios of the paper by name; its four schedules by default."""
    controller: str = SUBJECT
    """Controller by name, without -estimated."""
    seeds: int | None = None
    """Number of runs with noise, each with its own seed; 8 by default."""
    timestep: float | None = None
    """Physics step of MuJoCo, and control period [s]; 0.001 by default."""
    quick: bool = False
    """2 seeds, unless a number is given."""


def units_of(configuration: Estimation) -> list[Unit]:
    """Return the units of a configuration, one for each schedule, or raise."""
    from afl_mujoco.scenario.catalogue import SCENARIOS
    from afl_mujoco.simulation.sampled.runs import ticks_of
    from afl_mujoco.studies.estimation.loops import CASES, Unit, require_study

    c = configuration
    default = QUICK_SEEDS if c.quick else SEEDS
    seeds = default if c.seeds is None else c.seeds
    names = c.scenarios or CASES
    require_study(c.controller, names, seeds)
    for name in names:
        ticks_of(SCENARIOS[name], c.timestep)
    return [Unit(name, c.controller, seeds, timestep=c.timestep) for name in names]


def check(configuration: Estimation) -> None:
    """Raise if the configuration breaks a rule."""
    units_of(configuration)


def run(configuration: Estimation, *, progress: Progress = silent, workers: int = 1) -> Result:
    """Run every schedule; the result does not depend on the workers."""
    from afl_mujoco.pool import compute_all, open_executor
    from afl_mujoco.studies.estimation.result import result_of, study_case

    units = units_of(configuration)
    progress("estimating", 0, len(units))
    advance = counted(progress, "estimating", len(units))
    with open_executor(min(workers, len(units))) as executor:
        found = compute_all(study_case, units, executor, advance)
    return result_of(configuration.controller, units[0].noise, found)


STUDY = Study(
    name="estimation",
    title="M and l estimated online",
    order=50,
    schema=3,
    configuration=Estimation,
    check=check,
    run=run,
)
