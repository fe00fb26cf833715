"""The slope's gain function fitted to closed loops on random schedules, and not to the table.

The table's optima are those of a start from -60 degrees on a plant that stays as it is. What counts
is the objective on plants that change on the way, so the coefficients of (G1) are moved, from the
damped fit on, until fixed gains win on as few schedules as possible.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from afl_mujoco.control.controllers import Controller
from afl_mujoco.control.gain_function import GainFunction
from afl_mujoco.control.gain_table import GainTable
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.parameters import NOMINAL
from afl_mujoco.scenario.randomised import random_scenario
from afl_mujoco.simulation.ensemble import ObjectiveScales, objective
from afl_mujoco.simulation.ode_fixed_step import simulate_ode_rk4
from afl_mujoco.simulation.trajectory import COMPLETED
from afl_mujoco.sweep.executors import Executor
from afl_mujoco.sweep.sweep import compute_all
from afl_mujoco.tuning.fit import Fit, rmse
from afl_mujoco.tuning.gain_cost import paper_scales

FloatArray = NDArray[np.float64]

TRAINING_SEED = 1
"""Seed of the schedules; those that judge the result (C9) have another."""

TIMESTEP = 2e-3
"""Step of RK4, the law in every stage [s]."""

CHUNK = 25
"""Schedules of one unit of work."""

MARGIN = 1e-3
"""Improvement over which a win counts as half a win more, relative: smooths the count."""

LOSS_LIMIT, GAIN_LIMIT = -0.1, 0.3
"""Where improvements are cut before their mean is taken: no single schedule may decide."""

METHOD = "closed loops"
_SPREAD = 0.02
"""Relative size of the first simplex."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Unit:
    """Some schedules with one controller.

    Attributes
    ----------
    controller
        What is commanded.
    indices
        Of the schedules.
    scales
        Of the objective.
    """

    controller: Controller
    indices: tuple[int, ...]
    scales: ObjectiveScales


def objectives(unit: Unit) -> list[float]:
    """Return the objective on each schedule, infinite where the pole fell.

    Parameters
    ----------
    unit
        What to simulate.
    """
    found = []
    for index in unit.indices:
        scenario = random_scenario(TRAINING_SEED, index)
        try:
            run = simulate_ode_rk4(scenario, unit.controller, timestep=TIMESTEP)
        except InvalidValueError:  # a gain that is not positive
            found.append(np.inf)
            continue
        iae_z, iae_phi = (float(np.trapezoid(np.abs(run.state[:, i]), run.time)) for i in (0, 1))
        peak = float(np.abs(run.force).max())
        ended = run.outcome.kind == COMPLETED
        found.append(objective(iae_z, iae_phi, peak, unit.scales) if ended else np.inf)
    return found


def loss(improvement: FloatArray) -> float:
    """Return what the search minimises: the share of schedules lost, less the mean improvement.

    Parameters
    ----------
    improvement
        Of the objective over that of fixed gains, relative, shape (N,); -inf where the pole fell.
    """
    lost = 1.0 / (1.0 + np.exp(np.clip(improvement / MARGIN, -50.0, 50.0)))
    return float(np.mean(lost) - np.mean(np.clip(improvement, LOSS_LIMIT, GAIN_LIMIT)))


def fit_on_schedules(
    start: Fit,
    table: GainTable,
    executor: Executor,
    *,
    schedules: int,
    evaluations: int,
    progress: Callable[[int], None] = lambda done: None,
) -> Fit:
    """Return the slope's coefficients that win on the most schedules, by Nelder and Mead.

    Parameters
    ----------
    start
        The fit to begin with.
    table
        Holds the fixed gains to beat, those of the nominal plant; K and Phi stay theirs.
    executor
        What computes the closed loops; the result does not depend on it.
    schedules, evaluations
        How many schedules, and how often all of them are simulated at most.
    progress
        Told how many evaluations are done.
    """
    constant = GainFunction.constant(table.gains(NOMINAL.cart_mass, NOMINAL.half_length))
    base = _all(Controller(name="fixed", gain_function=constant), schedules, executor)
    done = 0

    def cost(w: FloatArray) -> float:
        nonlocal done
        slope = tuple(w.tolist())
        function = GainFunction(
            switching=constant.switching, slope=slope, boundary_layer=constant.boundary_layer
        )
        found = _all(Controller(name="adaptive", gain_function=function), schedules, executor)
        done += 1
        progress(min(done, evaluations))
        return loss(1.0 - found / base)

    first = np.array(start.coefficients)
    simplex = first + _SPREAD * np.vstack([np.zeros(5), np.diag(1.0 + np.abs(first))])
    options: Any = {"maxfev": evaluations, "initial_simplex": simplex, "xatol": 1e-6, "fatol": 1e-6}
    found = minimize(cost, first, method="Nelder-Mead", options=options)
    error = rmse(found.x[None], *(table.column(x) for x in ("cart_mass", "half_length", "slope")))
    return Fit(
        gain=start.gain,
        method=METHOD,
        coefficients=tuple(found.x.tolist()),
        rmse=float(error[0]),
    )


def _all(controller: Controller, schedules: int, executor: Executor) -> FloatArray:
    """Return the objective of a controller on every training schedule, shape (schedules,)."""
    chunks = [
        tuple(range(first, min(first + CHUNK, schedules))) for first in range(0, schedules, CHUNK)
    ]
    units = [Unit(controller=controller, indices=c, scales=paper_scales()) for c in chunks]
    return np.array([x for chunk in compute_all(objectives, units, executor) for x in chunk])
