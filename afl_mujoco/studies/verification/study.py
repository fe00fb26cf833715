"""The configuration of the verification, and its run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from afl_mujoco.control.names import PAPER
from afl_mujoco.studies.contract import Progress, ScenarioNames, Study, silent

if TYPE_CHECKING:
    from afl_mujoco.control.controller import Controller
    from afl_mujoco.scenario.scenario import Scenario
    from afl_mujoco.studies.cases import Settings
    from afl_mujoco.studies.verification.result import Result


@dataclass(frozen=True, kw_only=True)
class Validate:
    """Compare MuJoCo with the analytic model and give a verdict.

    Example: afl-mujoco validate step-step my-scenario.toml --controllers fixed adaptive

    Writes report.html, which needs no other file, report.json, report.md, report.npz, junit.xml
    and figures. The exit code is 0 if every check holds and every requirement is met, else 1.
    """

    scenarios: ScenarioNames = ()
    """Scenarios by name, or TOML files; all nine of the paper by default."""
    controllers: tuple[str, ...] = PAPER
    """Controllers by name, as in `afl-mujoco simulate --help` except -estimated ones; or your own,
    module:attribute."""
    full: bool = False
    """Add refinement studies, ledgers, a second method, and the effect of what the paper omits."""
    timestep: float = 1e-3
    """Physics step of MuJoCo [s]."""
    control_period: float | None = None
    """How long sampled mode holds the force [s], a multiple of the timestep; by default one
    step."""


def check(configuration: Validate) -> None:
    """Raise if the configuration breaks a rule."""
    asked = _asked(configuration)  # unknown names first: what follows is slow to import

    from afl_mujoco.studies.cases import require_runnable

    require_runnable(*asked)


def run(configuration: Validate, *, workers: int = 1, progress: Progress = silent) -> Result:
    """Judge every scenario with every controller.

    Parameters
    ----------
    workers
        Number of processes that share the work; the result does not depend on it.
    progress
        Called with what is being done, how many parts of it are done, and how many there are.
    """
    from afl_mujoco.studies.verification.campaign import verify

    return verify(*_asked(configuration), workers=workers, progress=progress)


def _asked(configuration: Validate) -> tuple[list[Scenario], list[Controller], Settings]:
    """Return what a configuration asks for."""
    from afl_mujoco.scenario.catalogue import SCENARIOS
    from afl_mujoco.scenario.files import find_scenario

    asked = configuration
    scenarios = [find_scenario(name) for name in asked.scenarios or SCENARIOS]

    from afl_mujoco.control.catalogue import find_controller

    controllers = [find_controller(name) for name in asked.controllers]

    from afl_mujoco.studies.cases import Settings

    period = asked.timestep if asked.control_period is None else asked.control_period
    settings = Settings(timestep=asked.timestep, control_period=period, full=asked.full)
    return scenarios, controllers, settings


STUDY = Study(
    name="validate",
    title="MuJoCo against the equations",
    order=0,
    schema=1,
    configuration=Validate,
    check=check,
    run=run,
    stem="report",
)
