"""Margins of some controllers over a grid of plants."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.catalogue import find_controller
from afl_mujoco.control.controller import Controller
from afl_mujoco.errors import AflMujocoError, InvalidValueError
from afl_mujoco.pool import compute_all, open_executor
from afl_mujoco.scenario.belief import TRUTH, Belief
from afl_mujoco.scenario.files import find_scenario
from afl_mujoco.scenario.imperfections import IDEAL, Imperfections
from afl_mujoco.scenario.parameters import (
    CART_MASSES,
    HALF_LENGTHS,
    NOMINAL,
    CartPoleParameters,
    departures,
    require_positive,
)
from afl_mujoco.scenario.sampling import whole_steps
from afl_mujoco.scenario.words import departures_text
from afl_mujoco.studies.contract import Progress, counted, silent
from afl_mujoco.studies.delay_margin import PERIOD
from afl_mujoco.studies.linearization import (
    LINEAR,
    STEP,
    NotSmoothError,
    linear_part,
    linearize,
)
from afl_mujoco.studies.loop_margins import loop_margins
from afl_mujoco.studies.margins.measured_delay import Deployment, Unit
from afl_mujoco.studies.margins.result import METRICS, ControllerMargins, LoopGrid, Result
from afl_mujoco.studies.margins.small_motions import require_equilibrium
from afl_mujoco.studies.margins.study import MarginsConfiguration

LONGEST_PERIOD = 10.0
"""Longest control period [s], longer than any pole of a laboratory takes to fall."""

QUICK = 4
"""A quick run studies one in so many M and l."""

LEVELS = 5
"""Number of M and l of a scenario that are studied if they change."""

Row = tuple[Controller, tuple[CartPoleParameters, ...], float, Imperfections, Belief]


class Request(NamedTuple):
    """What is surveyed: controllers, M [kg] and l [m], control period [s], m [kg], g [m/s^2].

    It also holds the imperfections, as from `linear_part`.
    """

    controllers: tuple[Controller, ...]
    cart_masses: tuple[float, ...]
    half_lengths: tuple[float, ...]
    control_period: float
    pole_mass: float
    gravity: float
    imperfections: Imperfections
    belief: Belief = TRUTH

    def plant(self, cart_mass: float, half_length: float) -> CartPoleParameters:
        """Return the plant at a point of the grid."""
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
    masses, lengths = CART_MASSES[::every], HALF_LENGTHS[::every]
    pole_mass, gravity, period, imperfections = NOMINAL.pole_mass, NOMINAL.gravity, None, IDEAL
    belief = TRUTH
    if c.scenario is not None:
        scenario = find_scenario(c.scenario)
        (mass, length, pole_mass, gravity), varied = scenario.plants, scenario.ranges.varied
        masses = _levels(varied.get("cart_mass", mass))
        lengths = _levels(varied.get("half_length", length))
        imperfections = linear_part(scenario.imperfections)
        period, start = imperfections.control_period, scenario.parameters_at(0.0)
        belief = scenario.belief.known(start)
    asked = c.control_period
    found = require(
        [find_controller(name) for name in c.controllers],
        masses if c.cart_masses is None else c.cart_masses,
        lengths if c.half_lengths is None else c.half_lengths,
        (period or PERIOD) if asked is None else asked,
        pole_mass if c.pole_mass is None else c.pole_mass,
        gravity if c.gravity is None else c.gravity,
        imperfections,
        belief,
    )
    if c.timestep is not None:
        whole_steps("control_period", found.control_period, "timestep", c.timestep)
    return found


def described(configuration: MarginsConfiguration) -> dict[str, Any]:
    """Return what a result says about its scenario: its name, and what is left out."""
    if configuration.scenario is None:
        return {}
    scenario = find_scenario(configuration.scenario)
    found = departures(scenario.imperfections)
    left_out = tuple(name for name in found if name not in (*LINEAR, "seed"))
    return {"scenario": scenario.name, "left_out": left_out}


def _levels(bounds: tuple[float, float]) -> tuple[float, ...]:
    """Return levels of a scenario's M or l, from the least to the largest."""
    low, high = bounds
    return (low,) if low == high else tuple(np.linspace(low, high, LEVELS).tolist())


def require(
    controllers: Sequence[Controller],
    cart_masses: Sequence[float],
    half_lengths: Sequence[float],
    control_period: float,
    pole_mass: float,
    gravity: float,
    imperfections: Imperfections = IDEAL,
    belief: Belief = TRUTH,
) -> Request:
    """Return what is surveyed, or raise before anything slow.

    One controller at least must be linearised, or have small motions, on the first plant.
    """
    period = require_positive("control_period", control_period)
    if period > LONGEST_PERIOD:
        rule = f"must be at most {LONGEST_PERIOD:g} s"
        raise InvalidValueError("control_period", rule, f"{period:g}")
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
    request = Request(tuple(controllers), masses, lengths, period, m, g, imperfections, belief)
    first, deployed = (
        request.plant(masses[0], lengths[0]),
        Deployment(period, imperfections, belief),
    )
    units = [(one, first, deployed) for one in controllers]
    refused = [error for error in map(refusal, units) if error is not None]
    if len(refused) == len(units):
        raise refused[0]
    return request


def why_not_linear(controller: Controller) -> str | None:
    """Return what a linearisation of a controller would leave out; None if nothing."""
    if controller.estimates:
        return "has an estimator, which a linearisation leaves out"
    if controller.interpreted and controller.stateful:
        return "has a memory, which a linearisation leaves out"
    return None


def refusal(unit: Unit) -> AflMujocoError | None:
    """Return why a controller has neither linear margins nor small motions; None if it has."""
    controller, plant, deployed = unit
    try:
        if why_not_linear(controller) is None:
            try:
                linearize(controller, plant, deployed.imperfections, deployed.belief)
            except NotSmoothError:
                require_equilibrium(unit)
        else:
            require_equilibrium(unit)
    except AflMujocoError as error:
        return error
    return None


def survey_margins(
    controllers: Sequence[Controller],
    cart_masses: Sequence[float] = CART_MASSES,
    half_lengths: Sequence[float] = HALF_LENGTHS,
    control_period: float = PERIOD,
    pole_mass: float = NOMINAL.pole_mass,
    gravity: float = NOMINAL.gravity,
    imperfections: Imperfections = IDEAL,
    belief: Belief = TRUTH,
    *,
    workers: int = 1,
    progress: Progress = silent,
) -> Result:
    """Return the margins of controllers at every plant of a grid.

    Those that cannot be linearised everywhere are in `Result.not_linear`, with the reason.

    Parameters
    ----------
    cart_masses, half_lengths
        The grid, M [kg] and l [m].
    control_period
        How long the sampled loop holds its force [s].
    pole_mass, gravity
        m [kg] and g [m/s^2] of every plant.
    imperfections
        As from `linear_part`.
    belief
        As in `linearize`.
    workers
        Number of processes that share the work; the result does not depend on it.
    """
    request = require(
        controllers,
        cart_masses,
        half_lengths,
        control_period,
        pole_mass,
        gravity,
        imperfections,
        belief,
    )
    controllers, masses, lengths, period = request[:4]
    reasons = {controller.name: why_not_linear(controller) for controller in controllers}
    not_linear = {name: reason for name, reason in reasons.items() if reason is not None}
    units: list[Row] = [
        (
            controller,
            tuple(request.plant(mass, length) for length in lengths),
            period,
            request.imperfections,
            request.belief,
        )
        for controller in controllers
        if controller.name not in not_linear
        for mass in masses
    ]
    progress("linearising", 0, len(units))
    advance = counted(progress, "linearising", len(units))
    with open_executor(min(workers, max(1, len(units)))) as executor:
        rows = compute_all(margins_of_row, units, executor, advance)
    tables: dict[str, list[NDArray[np.float64]]] = {}
    for unit, row in zip(units, rows, strict=True):
        if isinstance(row, AflMujocoError):
            not_linear.setdefault(unit[0].name, str(row))
        else:
            tables.setdefault(unit[0].name, []).append(row)
    return Result(
        control_period=period,
        cart_masses=masses,
        half_lengths=lengths,
        pole_mass=request.pole_mass,
        gravity=request.gravity,
        imperfections=departures_text(replace(request.imperfections, control_period=None)),
        linearisation_step=STEP,
        margins={
            name: ControllerMargins(
                continuous=_grid(np.stack(table)[:, :, 0]), sampled=_grid(np.stack(table)[:, :, 1])
            )
            for name, table in tables.items()
            if name not in not_linear
        },
        not_linear=not_linear,
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


def margins_of_row(unit: Row) -> NDArray[np.float64] | AflMujocoError:
    """Return the margins of a controller for one cart mass, shape (lengths, 2, margins).

    Or, where it has no linearisation, why.

    Parameters
    ----------
    unit
        Controller, the plants, the period of the sampled loop [s], imperfections and belief.
    """
    controller, plants, period, imperfections, belief = unit
    row = np.full((len(plants), 2, len(METRICS)), np.nan)
    for place, plant in enumerate(plants):
        try:
            loop = linearize(controller, plant, imperfections, belief)
        except AflMujocoError as error:
            return error
        for kind, held in enumerate((None, period)):
            found = loop_margins(loop, held, imperfections)
            if found is not None:
                row[place, kind] = list(asdict(found).values())
    return row
