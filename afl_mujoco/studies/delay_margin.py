"""The delay margin of a linearised loop with a held force, and the least over some scenarios."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from afl_mujoco.control.controller import Controller
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.belief import TRUTH, Belief
from afl_mujoco.scenario.imperfections import IDEAL, Imperfections
from afl_mujoco.scenario.parameters import CartPoleParameters
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.studies.linearization import linearize
from afl_mujoco.studies.loop_margins import loop_margins

PERIOD = 1e-3
"""Default control period [s]."""

EVERY = 0.1
"""Interval at which a schedule is sampled [s]."""


def delay_margin(
    controller: Controller,
    plant: CartPoleParameters,
    period: float = PERIOD,
    imperfections: Imperfections = IDEAL,
    belief: Belief = TRUTH,
) -> float | None:
    """Return the delay margin [s] of a linearised loop with a held force; None if it has none.

    Parameters
    ----------
    period
        How long the force is held [s].
    imperfections
        Only those in `LINEAR` count; the margin is the additional delay that the loop tolerates
        besides theirs.
    belief
        As in `linearize`.
    """
    loop = linearize(controller, plant, imperfections, belief)
    margins = loop_margins(loop, period, imperfections)
    return None if margins is None or not math.isfinite(margins.delay) else margins.delay


@dataclass(frozen=True, slots=True, kw_only=True)
class LeastMargin:
    """The least delay margin of one controller over the plants that some scenarios go through.

    Attributes
    ----------
    controller
        Its name.
    margin
        The margin [s]; 0 where the loop is not even stable without delay.
    cart_mass, half_length
        The plant, M [kg] and l [m].
    """

    controller: str
    margin: float
    cart_mass: float
    half_length: float


def least_margin(unit: tuple[Controller, tuple[Scenario, ...]]) -> LeastMargin | None:
    """Return the least delay margin over the plants of some scenarios, sampled every `EVERY`."""
    controller, scenarios = unit
    plants = {plant for scenario in scenarios for plant in _plants_of(scenario)}
    try:
        margins = [(delay_margin(controller, p) or 0.0, p.cart_mass, p.half_length) for p in plants]
    except InvalidValueError:  # the controller has no linearisation at upright
        return None
    margin, mass, length = min(margins)
    return LeastMargin(
        controller=controller.name, margin=margin, cart_mass=mass, half_length=length
    )


def _plants_of(scenario: Scenario) -> set[CartPoleParameters]:
    """Return the plants that a scenario goes through."""
    times = np.arange(0.0, scenario.duration, EVERY)
    return {scenario.parameters_at(time) for time in times.tolist()}
