"""Margins of some controllers over a grid of plants."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.catalogue import find_controller
from afl_mujoco.control.controller import Controller
from afl_mujoco.control.estimation.estimated_controller import require_no_estimator
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.execution.executors import compute_all, open_executor
from afl_mujoco.scenario.parameters import (
    CART_MASSES,
    HALF_LENGTHS,
    NOMINAL,
    CartPoleParameters,
    require_positive,
)
from afl_mujoco.studies.contract import Progress, counted, silent
from afl_mujoco.studies.linearization import STEP, linearize
from afl_mujoco.studies.loop_margins import loop_margins
from afl_mujoco.studies.margins.result import METRICS, ControllerMargins, LoopGrid, Result
from afl_mujoco.studies.margins.study import MarginsConfiguration

QUICK = 4
"""Of how many M and l one is studied in a quick run."""

Unit = tuple[Controller, tuple[CartPoleParameters, ...], float]


class Request(NamedTuple):
    """What is surveyed: controllers, M [kg] and l [m], control period [s], m [kg], g [m/s^2]."""

    controllers: tuple[Controller, ...]
    cart_masses: tuple[float, ...]
    half_lengths: tuple[float, ...]
    control_period: float
    pole_mass: float
    gravity: float

    def plant(self, cart_mass: float, half_length: float) -> CartPoleParameters:
        """Return the plant at a place of the grid."""
        return CartPoleParameters(
            cart_mass=cart_mass,
            half_length=half_length,
            pole_mass=self.pole_mass,
            gravity=self.gravity,
        )


def request_of(configuration: MarginsConfiguration) -> Request:
    """Return the request of a configuration, or raise."""
    c = configuration
    every = QUICK if c.quick else 1
    return require(
        [find_controller(name) for name in c.controllers],
        c.cart_masses or CART_MASSES[::every],
        c.half_lengths or HALF_LENGTHS[::every],
        c.control_period,
        c.pole_mass,
        c.gravity,
    )


def require(
    controllers: Sequence[Controller],
    cart_masses: Sequence[float],
    half_lengths: Sequence[float],
    control_period: float,
    pole_mass: float,
    gravity: float,
) -> Request:
    """Return what is surveyed, or raise before it is.

    Each controller is linearised once: one that is not smooth is found here.
    """
    require_no_estimator(controllers)
    period = require_positive("control_period", control_period)
    masses = tuple(require_positive("cart_masses", x) for x in cart_masses)
    lengths = tuple(require_positive("half_lengths", x) for x in half_lengths)
    names = tuple(controller.name for controller in controllers)
    for thing, items in (
        ("controllers", names),
        ("cart_masses", masses),
        ("half_lengths", lengths),
    ):
        if not items or len(set(items)) < len(items):
            raise InvalidValueError(thing, "must hold at least one, each once", list(items))
    m, g = require_positive("pole_mass", pole_mass), require_positive("gravity", gravity)
    request = Request(tuple(controllers), masses, lengths, period, m, g)
    for controller in controllers:
        linearize(controller, request.plant(masses[0], lengths[0]))
    return request


def survey_margins(
    controllers: Sequence[Controller],
    cart_masses: Sequence[float] = CART_MASSES,
    half_lengths: Sequence[float] = HALF_LENGTHS,
    control_period: float = 1e-3,
    pole_mass: float = NOMINAL.pole_mass,
    gravity: float = NOMINAL.gravity,
    *,
    workers: int = 1,
    progress: Progress = silent,
) -> Result:
    """Return the margins of controllers at every plant of a grid.

    Parameters
    ----------
    cart_masses, half_lengths
        The grid, M [kg] and l [m].
    control_period
        Over which the sampled loop holds its force [s].
    pole_mass, gravity
        m [kg] and g [m/s^2] of every plant.
    workers
        Processes to share the work among; the result does not depend on it.
    """
    request = require(controllers, cart_masses, half_lengths, control_period, pole_mass, gravity)
    controllers, masses, lengths, period = request[:4]
    units: list[Unit] = [
        (controller, tuple(request.plant(mass, length) for length in lengths), period)
        for controller in controllers
        for mass in masses
    ]
    progress("linearising", 0, len(units))
    advance = counted(progress, "linearising", len(units))
    with open_executor(min(workers, len(units))) as executor:
        rows = compute_all(margins_of_row, units, executor, advance)
    shape = (len(controllers), len(masses), len(lengths), 2, len(METRICS))
    tables = {
        controller.name: table
        for controller, table in zip(controllers, np.reshape(rows, shape), strict=True)
    }
    return Result(
        control_period=period,
        cart_masses=masses,
        half_lengths=lengths,
        pole_mass=request.pole_mass,
        gravity=request.gravity,
        linearisation_step=STEP,
        margins={
            name: ControllerMargins(continuous=_grid(table[:, :, 0]), sampled=_grid(table[:, :, 1]))
            for name, table in tables.items()
        },
    )


def _grid(table: NDArray[np.float64]) -> LoopGrid:
    """Return margins of shape (masses, lengths, margins), NaN where unstable, as plain data."""
    plain = {
        name: tuple(
            tuple(x if math.isfinite(x) else None for x in row) for row in table[..., k].tolist()
        )
        for k, name in enumerate(METRICS)
    }
    stable = ~np.isnan(table[..., METRICS.index("disk")])
    return LoopGrid(stable=tuple(tuple(row) for row in stable.tolist()), **plain)


def margins_of_row(unit: Unit) -> NDArray[np.float64]:
    """Return the margins of a controller for one cart mass, shape (lengths, 2, margins).

    Parameters
    ----------
    unit
        Controller, the plants and the period of the sampled loop [s].
    """
    controller, plants, period = unit
    row = np.full((len(plants), 2, len(METRICS)), np.nan)
    for place, plant in enumerate(plants):
        loop = linearize(controller, plant)
        for kind, held in enumerate((None, period)):
            found = loop_margins(loop, held)
            if found is not None:
                row[place, kind] = list(asdict(found).values())
    return row
