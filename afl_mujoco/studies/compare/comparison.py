"""Runs of some controllers on some scenarios, as deployed."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from afl_mujoco.control.catalogue import as_controller
from afl_mujoco.control.controller import Controller
from afl_mujoco.control.own.python_controller import calls_limited_to
from afl_mujoco.errors import AflMujocoError, require_count
from afl_mujoco.scenario.files import as_scenarios
from afl_mujoco.scenario.parameters import require_distinct
from afl_mujoco.scenario.sample_space import draws_of
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.judgement import (
    CONTROLLER_FAILED,
    judge_failure,
    judged,
    remarks_on,
)
from afl_mujoco.simulation.metrics import metrics
from afl_mujoco.simulation.mujoco_model import require_integrator
from afl_mujoco.simulation.mujoco_rollout import simulate_mujoco
from afl_mujoco.simulation.sampled.runs import ticks_of
from afl_mujoco.simulation.trajectory import Trajectory, controller_inputs
from afl_mujoco.studies.compare.result import ComparedRun, Curves, Result

MOST_DRAWS = 1000


def compare(
    scenarios: Scenario | str | Path | Sequence[Scenario | str | Path],
    controllers: Any,
    *,
    timestep: float | None = None,
    control_period: float | None = None,
    integrator: str = "RK4",
    draws: int | None = None,
    call_limit: float | None = None,
    advance: Callable[[object], None] | None = None,
) -> Result:
    """Run controllers on scenarios as deployed in MuJoCo; one that fails does not stop the others.

    Parameters
    ----------
    scenarios
        One or several: scenarios, names or TOML files.
    controllers
        One or several, each as for `simulate_mujoco`.
    timestep, control_period, integrator
        As for `simulate_mujoco`.
    draws
        Number of draws of noise and of the start within an encoder's step, the first the scenario
        itself; by default ten where noise or encoders act, else one.
    call_limit
        How long one call of a controller in Python may take [s]; 1 by default. Its first in a run
        may take 60, for a library to compile.
    advance
        Called after the runs of each controller on each scenario.

    Returns
    -------
    Result
        Every run with its metrics and requirements: `table`, `requirements`, `plot`. Printed, or
        shown by a notebook, it says who meets which requirement, and how much of it is left.

    Raises
    ------
    AflMujocoError
        If an argument breaks a rule, before the first run.
    """
    asked = as_scenarios(scenarios)
    several = isinstance(controllers, Sequence) and not isinstance(controllers, str)
    with calls_limited_to(call_limit):
        used = [as_controller(x) for x in (controllers if several else (controllers,))]
    deployed: Any = {
        "timestep": timestep,
        "control_period": control_period,
        "integrator": integrator,
    }
    require_comparable(asked, used, **deployed)
    require_draws(draws)
    runs: list[ComparedRun] = []
    curves: dict[str, Curves] = {}
    drawn = {scenario.name: draws_of(scenario, draws) for scenario in asked}
    for scenario, controller in itertools.product(asked, used):
        for number, draw in enumerate(drawn[scenario.name]):
            found = _run(draw, controller, deployed)
            if isinstance(found, Trajectory):
                run = _compared(draw, controller, found)
                if number == 0:
                    curves[f"{scenario.name}/{controller.name}"] = Curves(
                        **{one.name: getattr(found, one.name) for one in fields(Curves)}
                    )
            else:
                run = _failed(draw, controller, found)
            runs.append(replace(run, draw=number))
        if advance is not None:
            advance(controller.name)
    return Result(scenarios=tuple(asked), runs=tuple(runs), curves=curves, **deployed)


def require_draws(draws: int | None) -> None:
    """Raise unless a number of draws is allowed."""
    if draws is not None:
        require_count("draws", draws, 1, MOST_DRAWS)


def require_comparable(
    scenarios: Sequence[Scenario],
    controllers: Sequence[Controller],
    *,
    timestep: float | None,
    control_period: float | None,
    integrator: str,
) -> None:
    """Raise if anything would break a comparison, before it begins."""
    require_distinct("scenario", [scenario.name for scenario in scenarios])
    given = any(c.interpreted and getattr(c, "spec", None) is None for c in controllers)
    hint = "; set __name__ on one of them" if given else ""
    require_distinct("controller", [controller.name for controller in controllers], hint)
    require_integrator(integrator)
    for scenario in scenarios:
        ticks_of(scenario, timestep, control_period)
        for controller in controllers:  # raises if a gain is not positive
            controller_inputs(scenario, controller, np.array([0.0, *scenario.breakpoints]))


def _run(
    scenario: Scenario, controller: Controller, deployed: dict[str, Any]
) -> Trajectory | AflMujocoError:
    """Return a run, or how the controller failed; the settings have been checked before."""
    try:
        return simulate_mujoco(scenario, controller, "sampled", **deployed)
    except AflMujocoError as error:
        return error


def _compared(scenario: Scenario, controller: Controller, run: Trajectory) -> ComparedRun:
    """Return what is kept of a run."""
    found = judged(scenario, controller.name, run)
    return ComparedRun(
        **{one.name: getattr(found, one.name) for one in fields(found)},
        metrics=metrics(scenario, controller, run),
        remarks=tuple(remarks_on(run, scenario, controller)),
    )


def _failed(scenario: Scenario, controller: Controller, error: AflMujocoError) -> ComparedRun:
    """Return what is kept of a run whose controller failed."""
    reason = str(error).removeprefix(f"controller {controller.name!r}").strip()
    return ComparedRun(
        scenario=scenario.name,
        controller=controller.name,
        outcome=f"failed: {reason.removeprefix(': ')}",
        metrics={},
        requirements=judge_failure(scenario),
        failure=CONTROLLER_FAILED,
        settled=False,
    )
