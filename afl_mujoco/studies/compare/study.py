"""The configuration of a comparison, and its run."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from afl_mujoco.control.names import REFERENCE, SUBJECT
from afl_mujoco.studies.contract import (
    ControllerNames,
    Progress,
    ScenarioNames,
    Study,
    counted,
    silent,
)

if TYPE_CHECKING:
    from afl_mujoco.control.controller import Controller
    from afl_mujoco.scenario.scenario import Scenario
    from afl_mujoco.studies.compare.result import Result


@dataclass(frozen=True, kw_only=True)
class Compare:
    """Compare controllers as deployed in MuJoCo, on any plant, by the requirements of a scenario.

    Example: afl-mujoco compare my-scenario.toml --controllers lqr adaptive my_module:MyController

    Writes compare.json, curves over time, and the page. The exit code is 0 if every controller
    meets every requirement of its scenario, and 1 if one does not.
    """

    scenarios: ScenarioNames = ("step-step",)
    """Scenarios by name, or TOML files, with their imperfections and requirements."""
    controllers: ControllerNames = (SUBJECT, REFERENCE)
    timestep: float | None = None
    """Physics step of MuJoCo [s]; by default the longest up to 0.001 that divides the control
    period."""
    control_period: float | None = None
    """How long the force is held [s], a multiple of the timestep; by default that of the
    scenario's imperfections, else one step."""
    integrator: str = "RK4"
    """MuJoCo's integrator: RK4, Euler, implicit, implicitfast."""
    draws: int | None = None
    """Number of draws of noise, and of the start within an encoder's step; by default 10 where
    noise or encoders act, else 1."""
    film: bool = False
    """Film the first four controllers side by side, one MP4 for each scenario."""


def check(configuration: Compare) -> None:
    """Raise if the configuration breaks a rule."""
    c = configuration
    scenarios, controllers = _asked(c)

    from afl_mujoco.studies.compare.comparison import require_comparable, require_draws

    require_comparable(
        scenarios,
        controllers,
        timestep=c.timestep,
        control_period=c.control_period,
        integrator=c.integrator,
    )
    require_draws(c.draws)
    if c.film:
        from afl_mujoco.films.plan import AS_IS, side_by_side

        for scenario in scenarios:  # raises if it does not last a frame
            side_by_side(scenario, controllers, AS_IS)


def run(configuration: Compare, *, progress: Progress = silent) -> Result:
    """Run every controller on every scenario."""
    from afl_mujoco.studies.compare.comparison import compare
    from afl_mujoco.studies.compare.result import FilmRequest

    c = configuration
    scenarios, controllers = _asked(c)
    result = compare(
        scenarios,
        controllers,
        timestep=c.timestep,
        control_period=c.control_period,
        integrator=c.integrator,
        draws=c.draws,
        advance=counted(progress, "simulating", len(scenarios) * len(controllers)),
    )
    if not c.film:
        return result
    return replace(result, film=FilmRequest(controllers=c.controllers))


def _asked(configuration: Compare) -> tuple[list[Scenario], list[Controller]]:
    """Return what a configuration asks for, or raise."""
    from afl_mujoco.scenario.files import find_scenario

    c = configuration
    scenarios = [find_scenario(name) for name in c.scenarios]  # before what is slow to import
    if c.film:
        from afl_mujoco.graphics import require_backend

        require_backend()  # before MuJoCo

    from afl_mujoco.control.catalogue import find_controller

    return scenarios, [find_controller(name) for name in c.controllers]


STUDY = Study(
    name="compare",
    title="Controllers compared",
    order=5,
    schema=2,
    configuration=Compare,
    check=check,
    run=run,
)
