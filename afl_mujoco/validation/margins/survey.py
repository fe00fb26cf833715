"""Margins of some laws over a grid of plants."""

from __future__ import annotations

import math
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from importlib.metadata import version
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.baselines.design import CART_MASSES, HALF_LENGTHS
from afl_mujoco.control.estimation.estimated_law import refuse_estimated
from afl_mujoco.control.law import Law
from afl_mujoco.errors import InvalidValueError, UnknownNameError
from afl_mujoco.execution.executors import compute_all, open_executor
from afl_mujoco.scenario.parameters import NOMINAL, CartPoleParameters, require_positive
from afl_mujoco.validation.margins.linearization import STEP, linearize
from afl_mujoco.validation.margins.loop_margins import Margins, loop_margins

METRICS = tuple(field.name for field in fields(Margins))
"""The margins, in the order in which a survey holds them."""

UNITS: Mapping[str, str] = MappingProxyType(
    {
        "gain_decrease": "1",
        "gain_increase": "1",
        "phase": "deg",
        "delay": "s",
        "crossover": "rad/s",
        "disk": "1",
        "disk_gain": "1",
        "disk_phase": "deg",
    }
)
"""Unit of every margin."""

GROWS_WORSE = ("gain_decrease", "crossover")
"""The margins of which the largest value is the worst."""

_PACKAGES = ("afl_mujoco", "control", "mujoco", "numpy", "scipy", "numba")

Array = NDArray[np.float64]
Unit = tuple[Law, float, tuple[float, ...], float]


@dataclass(frozen=True, slots=True)
class Worst:
    """The worst value of a margin on the grid, and where it stands.

    Attributes
    ----------
    value
        The margin.
    cart_mass, half_length
        The plant, M [kg] and l [m].
    """

    value: float
    cart_mass: float
    half_length: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Survey:
    """Margins by law and plant.

    Attributes
    ----------
    controllers
        Names of the laws.
    cart_masses, half_lengths
        The grid, M [kg] and l [m]; m and g are nominal.
    control_period
        Over which the sampled loop holds its force [s].
    continuous, sampled
        Margins of the law that acts continuously and of the one that is held, shape
        (laws, masses, lengths, margins); NaN where the loop is not stable.
    """

    controllers: tuple[str, ...]
    cart_masses: tuple[float, ...]
    half_lengths: tuple[float, ...]
    control_period: float
    continuous: Array
    sampled: Array

    def values(self, controller: str, metric: str, *, sampled: bool = False) -> Array:
        """Return one margin of one law on the grid, shape (masses, lengths).

        Parameters
        ----------
        controller
            Its name.
        metric
            One of `METRICS`.
        sampled
            Whether of the loop that holds its force.

        Raises
        ------
        UnknownNameError
            If the survey has no such law or margin.
        """
        if controller not in self.controllers:
            raise UnknownNameError.among("controller", controller, self.controllers)
        if metric not in METRICS:
            raise UnknownNameError.among("margin", metric, METRICS)
        data = self.sampled if sampled else self.continuous
        place = self.controllers.index(controller)
        values: Array = data[place, :, :, METRICS.index(metric)]
        return values

    def worst(self, controller: str, metric: str, *, sampled: bool = False) -> Worst | None:
        """Return the worst of a margin over the plants whose loop is stable; None if none is.

        Parameters
        ----------
        controller, metric, sampled
            As of `values`.
        """
        values = self.values(controller, metric, sampled=sampled)
        if np.isnan(values).all():
            return None
        pick = np.nanargmax if metric in GROWS_WORSE else np.nanargmin
        row, column = np.unravel_index(int(pick(values)), values.shape)
        plant = self.cart_masses[row], self.half_lengths[column]
        return Worst(float(values[row, column]), *plant)

    def to_dict(self) -> dict[str, Any]:
        """Return the survey as plain data; what is null is infinite if the loop is stable."""
        versions = {name: version(name) for name in _PACKAGES}
        kinds = {"continuous": False, "sampled": True}
        return {
            "schema": 1,
            "provenance": {
                "linearisation_step": STEP,
                "pole_mass": NOMINAL.pole_mass,
                "gravity": NOMINAL.gravity,
                "versions": {**versions, "python": platform.python_version()},
            },
            "units": dict(UNITS),
            "control_period": self.control_period,
            "cart_masses": list(self.cart_masses),
            "half_lengths": list(self.half_lengths),
            "margins": {
                name: {kind: self._plain(name, sampled) for kind, sampled in kinds.items()}
                for name in self.controllers
            },
        }

    def _plain(self, controller: str, sampled: bool) -> dict[str, Any]:
        """Return the margins of one law as lists by cart mass and half-length."""
        tables = {m: self.values(controller, m, sampled=sampled) for m in METRICS}
        plain: dict[str, Any] = {
            name: [[x if math.isfinite(x) else None for x in row] for row in table.tolist()]
            for name, table in tables.items()
        }
        return {"stable": (~np.isnan(tables["disk"])).tolist(), **plain}


def survey_margins(
    controllers: Sequence[Law],
    *,
    cart_masses: Sequence[float] = CART_MASSES,
    half_lengths: Sequence[float] = HALF_LENGTHS,
    control_period: float = 1e-3,
    workers: int = 1,
    progress: Callable[[int], None] = lambda finished: None,
) -> Survey:
    """Return the margins of laws at every plant of a grid.

    Parameters
    ----------
    controllers
        The laws.
    cart_masses, half_lengths
        The grid, M [kg] and l [m].
    control_period
        Over which the sampled loop holds its force [s].
    workers
        Processes to share the work among; the result does not depend on it.
    progress
        Called with the number of rows done, of ``len(controllers) * len(cart_masses)``.

    Raises
    ------
    AflMujocoError
        If a setting breaks its rule.
    """
    refuse_estimated(controllers)
    names, masses, lengths, period = require_survey(
        controllers, cart_masses, half_lengths, control_period, workers
    )
    units: list[Unit] = [(c, mass, lengths, period) for c in controllers for mass in masses]
    done = iter(range(1, len(units) + 1))
    with open_executor(min(workers, len(units))) as executor:
        rows = compute_all(margins_of_row, units, executor, lambda index: progress(next(done)))
    shape = (len(names), len(masses), len(lengths), 2, len(METRICS))
    data = np.reshape(rows, shape)
    return Survey(
        controllers=names,
        cart_masses=masses,
        half_lengths=lengths,
        control_period=period,
        continuous=data[..., 0, :],
        sampled=data[..., 1, :],
    )


def require_survey(
    controllers: Sequence[Law],
    cart_masses: Sequence[float],
    half_lengths: Sequence[float],
    control_period: float,
    workers: int,
) -> tuple[tuple[str, ...], tuple[float, ...], tuple[float, ...], float]:
    """Return the names, masses, lengths and period of a survey, or raise before it is made.

    Parameters
    ----------
    controllers, cart_masses, half_lengths, control_period, workers
        As of `survey_margins`. Each law is linearised once: one that is not smooth is found here.

    Raises
    ------
    AflMujocoError
        If a setting breaks its rule.
    """
    period = require_positive("control_period", control_period)
    if workers < 1:
        raise InvalidValueError("workers", "must be at least 1", workers)
    masses = tuple(require_positive("cart_masses", x) for x in cart_masses)
    lengths = tuple(require_positive("half_lengths", x) for x in half_lengths)
    names = tuple(controller.name for controller in controllers)
    for thing, items in (("controllers", names), ("cart_masses", masses), ("lengths", lengths)):
        if not items or len(set(items)) < len(items):
            raise InvalidValueError(thing, "must hold at least one, each once", list(items))
    for controller in controllers:
        linearize(controller, CartPoleParameters(cart_mass=masses[0], half_length=lengths[0]))
    return names, masses, lengths, period


def margins_of_row(unit: Unit) -> Array:
    """Return the margins of a law for one cart mass, shape (lengths, 2, margins).

    Parameters
    ----------
    unit
        Law, M [kg], the half-lengths [m] and the period of the sampled loop [s].
    """
    controller, mass, lengths, period = unit
    row = np.full((len(lengths), 2, len(METRICS)), np.nan)
    for place, length in enumerate(lengths):
        loop = linearize(controller, CartPoleParameters(cart_mass=mass, half_length=length))
        for kind, held in enumerate((None, period)):
            found = loop_margins(loop, held)
            if found is not None:
                row[place, kind] = list(asdict(found).values())
    return row
