"""Controllers bound to the plant of a scenario, and the plant's linear model at rest."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from afl_mujoco.control import angle
from afl_mujoco.control.controller import Controller
from afl_mujoco.control.own import PythonController
from afl_mujoco.control.plant_feedback import NODES, LinearFeedback, Rest, holding_input, largest_of
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.plants.cartpole import has_its_names
from afl_mujoco.plants.features import without_limits_of_inputs
from afl_mujoco.plants.plant import Floats, Plant
from afl_mujoco.plants.writer import PlantModel
from afl_mujoco.scenario.scenario import Scenario

STEP = 1e-6  # step of the central differences [rad, m, rad/s, m/s]


def bound(controller: Controller, scenario: Scenario) -> Controller:
    """Return a controller for the plant of a scenario, or raise if it is of another."""
    plant = scenario.plant
    if scenario.is_cart_pole:
        return _about_target(controller, scenario)
    if controller.plant is plant:
        return controller
    if isinstance(controller, PythonController):
        return replace(controller, plant=plant)
    if controller.name == "lqr":
        return lqr_of(scenario)
    if has_its_names(plant):  # it assumes the paper's equations of what has other ones
        return _about_target(controller, scenario)
    rule = f"is of the cart-pole; plant {plant.name!r} takes lqr, or a controller of your own"
    raise InvalidValueError(f"controller {controller.name!r}", rule)


def _about_target(controller: Controller, scenario: Scenario) -> Controller:
    """Return a controller of the cart-pole about the target of a scenario, one's own as it is."""
    if isinstance(controller, PythonController) and controller.function is not angle.force:
        return controller
    home, upright = scenario.target
    if upright:
        rule = "balances upright: its target of phi must be 0"
        raise InvalidValueError(f"controller {controller.name!r}", rule, f"{upright:g} rad")
    return controller.about(home)


def lqr_of(scenario: Scenario) -> LinearFeedback:
    """Return the LQR of the plant of a scenario, about its target, weighted by its requirements.

    By nothing of the hardware: a study that varies this would vary the law with it.
    """
    plant, asked = scenario.plant, scenario.requirements.max
    if plant.upright is None and not scenario.requirements.target:
        rule = "needs a plant that says where it is upright, or a target in [requirements]"
        raise InvalidValueError("controller 'lqr'", rule)
    ends = np.abs(plant.limits).max(axis=1)
    ends[np.isinf(ends)] = 0.0
    most = [
        asked.get(name, asked.get(f"{name}_command", end))
        for name, end in zip(plant.inputs, ends.tolist(), strict=True)
    ]
    model = plant_model(plant, without_limits_of_inputs)  # which would cut off their effect

    def rest(values: Floats) -> Rest:
        return rest_of(model, np.array(scenario.target), values)

    grids = {}
    for i, (name, one) in enumerate(plant.parameters.items()):
        low, high = scenario.spans[name]
        first, last = min(low, one.low or low), max(high, one.high or high)
        if any(segment.lines[i][1] for segment in scenario.segments):
            grids[i] = first, (last - first) / NODES
    bands = {name: scenario.band(name) for name in plant.coordinates}
    target, largest = scenario.target, largest_of(asked, bands)
    return LinearFeedback(
        name="lqr",
        plant=plant,
        rest=rest,
        target=target,
        largest=largest,
        most=tuple(most),
        grids=grids,
        known=_known(plant, target, largest, tuple(most)),
    )


@lru_cache(maxsize=32)
def _known(plant: Plant, *weights: tuple[float, ...]) -> dict[bytes, Floats]:
    """Return where the designs of a plant with some target and weights are kept."""
    return {}


def plant_model(plant: Plant, alter: Callable[[Any], None] | None = None) -> PlantModel:
    """Return a model of a plant that this thread has for itself."""
    return _model(plant, alter, threading.get_ident())


@lru_cache(maxsize=64)
def _model(plant: Plant, alter: Callable[[Any], None] | None, thread: int) -> PlantModel:
    return PlantModel(plant, alter=alter)


def rest_of(model: PlantModel, q: Floats, values: Floats) -> Rest:
    """Return a plant at rest at some coordinates, by MuJoCo's own terms."""
    row = model.rows(values)
    model.require(row, np.atleast_2d(values))
    model.write(row[0])
    n, k = len(q), len(model.plant.inputs)
    still, none = np.zeros(n), np.zeros(k)
    mass, bias, inputs, _ = model.at(q, still, none)
    held, _ = holding_input(bias, inputs, model.plant.limits)
    stiffness, damping = np.empty((n, n)), np.empty((n, n))
    for i in range(n):
        step = STEP * np.eye(n)[i]
        sides = []
        for x in (q + step, q - step):
            _, h, b, _ = model.at(x, still, none)
            sides.append(h - b @ held)
        stiffness[:, i] = (sides[0] - sides[1]) / (2.0 * STEP)
        forward, back = (model.at(q, x, none)[1] for x in (step, -step))
        damping[:, i] = (forward - back) / (2.0 * STEP)
    return Rest(mass, bias, inputs, stiffness, damping)
