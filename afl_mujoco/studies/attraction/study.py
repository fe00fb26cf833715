"""The configuration of the study of attraction, and its run."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

from afl_mujoco.control.names import REFERENCE, SUBJECT
from afl_mujoco.studies.contract import Progress, Study, silent

if TYPE_CHECKING:
    from afl_mujoco.control.controller import Controller
    from afl_mujoco.simulation.attraction.grid import Grid, Settling
    from afl_mujoco.studies.attraction.result import Result

GRID, QUICK_GRID = 101, 21


@dataclass(frozen=True, kw_only=True)
class Attraction:
    """Map from where each controller settles: by the equations, in MuJoCo, where they disagree.

    Example: afl-mujoco attraction --controllers adaptive lqr --quick

    One map over (phi0, phi0') on one plant, one over (M, l) from one start. Writes
    attraction.json, an npz of the maps, and a figure for each plane. The whole takes some ten
    minutes on two cores.
    """

    controllers: tuple[str, ...] = (SUBJECT, REFERENCE)
    """Controllers by name; neither a Python controller nor one with the estimator."""
    planes: tuple[str, ...] = ("states", "plants")
    """Maps to draw: states, plants."""
    grid: int | None = None
    """Grid points along each axis; 101 by default."""
    quick: bool = False
    """21 grid points along each axis, unless a number is given."""
    cart_mass: float = 1.0
    """Cart mass M of the map over states [kg]."""
    half_length: float = 0.5
    """Half-length l of the map over states [m]."""
    pole_mass: float = 0.05
    """m of every map [kg]."""
    gravity: float = 9.81
    """g of every map [m/s^2]."""
    max_angle: float = 1.55
    """The map over states reaches from minus this to this phi0 [rad]."""
    max_rate: float = 10.0
    """The map over states reaches from minus this to this phi0' [rad/s]."""
    cart_masses: tuple[float, float] = (0.1, 2.0)
    """Edges of the map over plants: M [kg]."""
    half_lengths: tuple[float, float] = (0.05, 1.0)
    """Edges of the map over plants: l [m]."""
    start_angle: float = -math.pi / 3.0
    """phi0 of the map over plants [rad]."""
    horizon: float = 20.0
    """When a rollout that has neither settled nor fallen ends as undecided [s]."""
    timestep: float = 2e-3
    """MuJoCo's physics step, over which the control is held [s]."""
    integrator: str = "RK4"
    """MuJoCo's integrator: RK4, Euler, implicit, implicitfast."""
    gain_labels: str = "table2"
    """Reading of the paper's gain columns K and Phi: table2 or table1 (decision D2)."""


class Request(NamedTuple):
    """What is mapped: controllers, the grid of each map, and when a rollout has settled."""

    controllers: list[Controller]
    maps: list[Grid]
    settling: Settling


def request_of(configuration: Attraction) -> Request:
    """Return the request of a configuration, or raise."""
    from afl_mujoco.control.catalogue import find_controller
    from afl_mujoco.scenario.parameters import require_distinct, require_positive
    from afl_mujoco.scenario.sampling import whole_steps
    from afl_mujoco.simulation.attraction.grid import Settling
    from afl_mujoco.simulation.mujoco_model import require_integrator

    c = configuration
    require_distinct("controller", c.controllers)
    require_distinct("plane", c.planes)
    controllers = [find_controller(name, c.gain_labels) for name in c.controllers]
    m, g = require_positive("pole_mass", c.pole_mass), require_positive("gravity", c.gravity)
    maps = [replace(_grid(c, plane), pole_mass=m, gravity=g) for plane in c.planes]
    settling = Settling(horizon=c.horizon)
    for name, time in (("dwell", settling.dwell), ("horizon", settling.horizon)):
        whole_steps(name, time, "timestep", c.timestep)
    require_integrator(c.integrator)
    for controller in controllers:
        _ = controller.kind  # raises if it has no compiled form
        for grid in maps:  # raises if a gain is not positive
            masses, lengths = grid.plants.T
            controller.inputs_along_run(masses, lengths, grid.pole_mass, grid.gravity)
    return Request(controllers, maps, settling)


def _grid(configuration: Attraction, plane: str) -> Grid:
    """Return the grid of a plane."""
    from afl_mujoco.errors import UnknownNameError
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
    """Raise at what breaks a rule."""
    request_of(configuration)


def run(configuration: Attraction, *, progress: Progress = silent, workers: int = 1) -> Result:
    """Make the maps; the numbers do not depend on the threads, one for each of the workers."""
    from afl_mujoco.simulation.attraction.mujoco_map import map_in_mujoco
    from afl_mujoco.simulation.attraction.ode_map import map_by_ode
    from afl_mujoco.studies.attraction.comparison import Comparison
    from afl_mujoco.studies.attraction.result import result_of

    controllers, maps, settling = request_of(configuration)
    done, total = 0, 2 * len(controllers) * sum(len(grid.starts) for grid in maps)
    progress("mapping", 0, total)

    def advance(points: int) -> None:
        nonlocal done
        done += points
        progress("mapping", done, total)

    shared: Any = {"settling": settling, "threads": workers, "progress": advance}
    steps: Any = {"timestep": configuration.timestep, "integrator": configuration.integrator}
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
    schema=3,
    configuration=Attraction,
    check=check,
    run=run,
)
