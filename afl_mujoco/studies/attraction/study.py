"""The configuration of the study of attraction, and its run."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

from afl_mujoco.control.names import REFERENCE, SUBJECT
from afl_mujoco.studies.contract import Progress, ScenarioIfAny, Study, silent

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from afl_mujoco.control.controller import Controller
    from afl_mujoco.scenario.scenario import Scenario
    from afl_mujoco.simulation.attraction.grid import Grid, Settling
    from afl_mujoco.studies.attraction.result import Result

GRID, QUICK_GRID = 101, 21
STARTS, QUICK_STARTS = 41, 11
"""Number of grid points along each axis of the map of a scenario, one run each."""

TIMESTEP = 2e-3
"""Default step of MuJoCo without a scenario [s]."""


@dataclass(frozen=True, kw_only=True)
class Attraction:
    """Map where each controller settles by the equations and in MuJoCo, and where they disagree.

    Example: afl-mujoco attraction my-rig.toml --controllers adaptive lqr --quick

    With a scenario: one map over (phi0, phi0') as deployed in MuJoCo, with its schedules,
    disturbances and imperfections. A start counts if the requirements are met from it or, if there
    are none, the run settles. Without a scenario: one map over (phi0, phi0') on one plant, and one
    over (M, l) from one start, both with the ideal loop. Writes attraction.json, an npz of the
    maps, and a figure for each plane. A full run takes about ten minutes on two cores.
    """

    scenario: ScenarioIfAny = None
    """Scenario by name, or TOML file, to map over its start within --max-angle and --max-rate. The
    options for planes, plants, start and horizon are then not allowed."""
    controllers: tuple[str, ...] = (SUBJECT, REFERENCE)
    """Controllers by name; without a scenario neither a Python controller nor one with the
    estimator."""
    planes: tuple[str, ...] = ("states", "plants")
    """Maps to draw: states, plants."""
    grid: int | None = None
    """Grid points along each axis; 101 by default, 41 with a scenario."""
    quick: bool = False
    """21 grid points along each axis, 11 with a scenario, unless a number is given."""
    cart_mass: float = 1.0
    """Cart mass M of the map over states [kg]."""
    half_length: float = 0.5
    """Half-length l of the map over states [m]."""
    pole_mass: float = 0.05
    """m of every map [kg]."""
    gravity: float = 9.81
    """g of every map [m/s^2]."""
    max_angle: float = 1.55
    """Largest |phi0| of the map over states, or over starts of a scenario [rad]."""
    max_rate: float = 10.0
    """Largest |phi0'| of the map over states, or over starts of a scenario [rad/s]."""
    cart_masses: tuple[float, float] = (0.1, 2.0)
    """Edges of the map over plants: M [kg]."""
    half_lengths: tuple[float, float] = (0.05, 1.0)
    """Edges of the map over plants: l [m]."""
    start_angle: float = -math.pi / 3.0
    """phi0 of the map over plants [rad]."""
    horizon: float = 20.0
    """Time at which a rollout that has neither settled nor fallen ends as undecided [s]."""
    timestep: float | None = None
    """MuJoCo's physics step [s]; by default that of simulate for a scenario, else 0.002, over which
    the control is held."""
    integrator: str = "RK4"
    """MuJoCo's integrator: RK4, Euler, implicit, implicitfast."""


THE_SCENARIOS = (
    "planes", "cart_mass", "half_length", "pole_mass", "gravity", "cart_masses", "half_lengths",
    "start_angle", "horizon",
)  # fmt: skip
"""Options that are not allowed with a scenario."""


class Request(NamedTuple):
    """What is mapped: controllers, the grid of each map, when a rollout has settled, the step [s].

    A scenario replaces the grids.
    """

    controllers: list[Controller]
    maps: list[Grid]
    settling: Settling
    timestep: float | None
    scenario: Scenario | None


def request_of(configuration: Attraction) -> Request:
    """Return the request of a configuration, or raise."""
    from afl_mujoco.control.catalogue import find_controller, require_stateless
    from afl_mujoco.errors import InvalidValueError
    from afl_mujoco.scenario.parameters import require_distinct, require_positive
    from afl_mujoco.scenario.sampling import whole_steps
    from afl_mujoco.simulation.attraction.grid import Settling
    from afl_mujoco.simulation.mujoco_model import require_integrator

    c = configuration
    require_distinct("controller", c.controllers)
    if c.scenario is not None:
        return _scenario_request(c, c.scenario)
    require_distinct("plane", c.planes)
    controllers = [find_controller(name) for name in c.controllers]
    timestep = TIMESTEP if c.timestep is None else c.timestep
    m, g = require_positive("pole_mass", c.pole_mass), require_positive("gravity", c.gravity)
    maps = [replace(_grid(c, plane), pole_mass=m, gravity=g) for plane in c.planes]
    settling = Settling(horizon=c.horizon)
    for name, time in (("dwell", settling.dwell), ("horizon", settling.horizon)):
        whole_steps(name, time, "timestep", timestep)
    require_integrator(c.integrator)
    for controller in controllers:
        if controller.interpreted:
            rule = "is written in Python: give a scenario to map its starts"
            raise InvalidValueError(f"controller {controller.name!r}", rule)
        _ = controller.kind  # raises if it has no compiled form
        require_stateless(controller, "a map over plants")
        for grid in maps:  # raises if a gain is not positive
            masses, lengths = grid.plants.T
            controller.inputs_along_run(masses, lengths, grid.pole_mass, grid.gravity)
    return Request(controllers, maps, settling, timestep, None)


def _scenario_request(configuration: Attraction, name: str) -> Request:
    """Return the request of a scenario's map, or raise."""
    from dataclasses import fields

    from afl_mujoco.control.catalogue import find_controller
    from afl_mujoco.errors import InvalidValueError
    from afl_mujoco.scenario.files import find_scenario
    from afl_mujoco.simulation.attraction.grid import Settling
    from afl_mujoco.simulation.mujoco_model import require_integrator
    from afl_mujoco.simulation.sampled.runs import ticks_of

    c, scenario = configuration, find_scenario(name)
    defaults = {field.name: field.default for field in fields(c)}
    for option in THE_SCENARIOS:
        if (value := getattr(c, option)) != defaults[option]:
            rule = f"is that of scenario {scenario.name!r}: leave it out"
            raise InvalidValueError(option, rule, value)
    ticks_of(scenario, c.timestep)
    require_integrator(c.integrator)
    starts_of(c)
    controllers = [find_controller(name) for name in c.controllers]
    return Request(controllers, [], Settling(), c.timestep, scenario)


def starts_of(configuration: Attraction) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the angles [rad] and rates [rad/s] of a scenario's map, or raise."""
    from afl_mujoco.errors import InvalidValueError
    from afl_mujoco.simulation.attraction.grid import axis
    from afl_mujoco.simulation.trajectory import FALL_ANGLE

    c = configuration
    count = c.grid if c.grid is not None else QUICK_STARTS if c.quick else STARTS
    if not c.max_angle < FALL_ANGLE:
        rule = f"must be below {FALL_ANGLE:.4f} rad, where a pole has fallen"
        raise InvalidValueError("max_angle", rule, c.max_angle)
    return (
        axis("max_angle", -c.max_angle, c.max_angle, count),
        axis("max_rate", -c.max_rate, c.max_rate, count),
    )


def _grid(configuration: Attraction, plane: str) -> Grid:
    """Return the grid of a plane."""
    from afl_mujoco.errors import UnknownNameError
    from afl_mujoco.scenario.parameters import require_start_angle
    from afl_mujoco.simulation.attraction.grid import (
        PLANES,
        STATES,
        axis,
        plant_grid,
        state_grid,
    )

    c = configuration
    if plane not in PLANES:
        raise UnknownNameError.among("plane", plane, PLANES)
    for option in ("max_angle", "start_angle"):
        require_start_angle(option, getattr(c, option))
    count = c.grid if c.grid is not None else QUICK_GRID if c.quick else GRID
    if plane == STATES:
        return state_grid(
            axis("max_angle", -c.max_angle, c.max_angle, count),
            axis("max_rate", -c.max_rate, c.max_rate, count),
            cart_mass=c.cart_mass,
            half_length=c.half_length,
        )
    return plant_grid(
        axis("cart_masses", *c.cart_masses, count),
        axis("half_lengths", *c.half_lengths, count),
        start=(0.0, c.start_angle, 0.0, 0.0),
    )


def check(configuration: Attraction) -> None:
    """Raise if the configuration breaks a rule."""
    request_of(configuration)


def run(configuration: Attraction, *, progress: Progress = silent, workers: int = 1) -> Result:
    """Make the maps with one thread per worker; the results do not depend on the threads."""
    from afl_mujoco.simulation.attraction.mujoco_map import map_in_mujoco
    from afl_mujoco.simulation.attraction.ode_map import map_by_ode
    from afl_mujoco.studies.attraction.comparison import Comparison
    from afl_mujoco.studies.attraction.deployed import map_starts
    from afl_mujoco.studies.attraction.result import Result, result_of

    c = configuration
    controllers, maps, settling, timestep, scenario = request_of(c)
    starts = None if scenario is None else starts_of(c)
    each = 2 * sum(len(grid.starts) for grid in maps)
    if starts is not None:
        each = len(starts[0]) * len(starts[1])
    done, total, doing = 0, len(controllers) * each, "mapping"
    progress("mapping", 0, total)

    def advance(points: int) -> None:
        nonlocal done
        done += points
        progress(doing, done, total)

    steps: Any = {"timestep": timestep, "integrator": c.integrator}
    if scenario is not None and starts is not None:
        how: Any = {**steps, "threads": workers, "progress": advance}
        found = []
        for one in controllers:
            doing = f"mapping: {one.name}"
            found.append(map_starts(scenario, one, *starts, **how))
        return Result(maps=(), starts=tuple(found))
    shared: Any = {"settling": settling, "threads": workers, "progress": advance}
    return result_of(
        [
            Comparison(
                map_by_ode(grid, controller, **shared),
                map_in_mujoco(grid, controller, **shared, **steps),
            )
            for grid in maps
            for controller in controllers
        ]
    )


STUDY = Study(
    name="attraction",
    title="Regions of attraction",
    order=30,
    schema=4,
    configuration=Attraction,
    check=check,
    run=run,
)
