"""Margins measured in MuJoCo, for controllers that have no linearisation."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from afl_mujoco.errors import AflMujocoError, InvalidValueError
from afl_mujoco.pool import compute_all, open_executor
from afl_mujoco.simulation.trajectory import DIVERGED
from afl_mujoco.studies.bisection import LOWER, UPPER, find_threshold, scan_levels
from afl_mujoco.studies.linearization import REST
from afl_mujoco.studies.margins.measured_delay import START, Unit, motion_decays, small_motion

GAINS = scan_levels(1.0, 100.0, 13)
"""Factors on the force that are tried, and their inverses, before the bisection [1]."""

DELAYS = scan_levels(1e-4, 1.0, 13)
"""Delays that are tried before the bisection [s]."""

TOLERANCE = 1e-2
"""Relative tolerance of what is measured [1]."""

AT_REST = 1.0
"""Length of the run that shows whether upright is an equilibrium [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SmallMotions:
    """What a loop in MuJoCo tolerates, one controller on one plant, before small motions grow.

    Attributes
    ----------
    controller
        Its name.
    cart_mass, half_length
        M [kg] and l [m].
    decays
        Whether a small motion decays as the loop is.
    gain_decrease, gain_increase
        Factors on the force [1]; None beyond the last of `GAINS`, or if none decays.
    delay
        Additional delay [s]; 0 below the first of `DELAYS`, None beyond the last, or if none
        decays.
    """

    controller: str
    cart_mass: float
    half_length: float
    decays: bool
    gain_decrease: float | None = None
    gain_increase: float | None = None
    delay: float | None = None


def require_equilibrium(unit: Unit) -> None:
    """Raise if a controller does not keep a pole that stands upright at rest.

    What small motions do says nothing of a loop that has its equilibrium elsewhere.
    """
    controller, plant, deployed = unit
    thing = f"small motions of {controller.name!r} at M = {plant.cart_mass:g} kg"
    thing += f", l = {plant.half_length:g} m"
    run = small_motion(controller, plant, deployed, 0.0, AT_REST)
    moved = np.flatnonzero(~(np.abs(run.force) <= REST))
    if moved.size:
        rule = "must be about an equilibrium: no force at upright"
        raise InvalidValueError(thing, rule, f"{run.force[moved[0]]:g} N")
    run = small_motion(controller, plant, deployed, START, AT_REST)
    if run.outcome.kind == DIVERGED:
        raise InvalidValueError(thing, "must have finite forces", f"diverged {run.outcome.time} s")


def measure_small_motions(
    units: Sequence[Unit], *, workers: int = 1, progress: Callable[[int], None] = lambda index: None
) -> list[SmallMotions | AflMujocoError]:
    """Return what each loop tolerates, or why that could not be measured.

    Parameters
    ----------
    workers
        Number of processes that share the work; the result does not depend on it.
    """
    with open_executor(min(workers, max(1, len(units)))) as executor:
        return compute_all(measure, units, executor, progress)


def measure(unit: Unit) -> SmallMotions | AflMujocoError:
    """Return what one loop tolerates, or why that could not be measured."""
    controller, plant, deployed = unit
    pair = {"cart_mass": plant.cart_mass, "half_length": plant.half_length}
    decays = partial(motion_decays, controller, plant, deployed=deployed)
    try:
        require_equilibrium(unit)
        if not decays(0.0):
            return SmallMotions(controller=controller.name, **pair, decays=False)
        return SmallMotions(
            controller=controller.name,
            **pair,
            decays=True,
            gain_decrease=_least(lambda x: decays(0.0, gain=x), [1.0 / x for x in GAINS]),
            gain_increase=_least(lambda x: decays(0.0, gain=x), GAINS),
            delay=_least(decays, DELAYS),
        )
    except AflMujocoError as error:
        return error


def _least(holds: Callable[[float], bool], scan: list[float]) -> float | None:
    """Return where a motion no longer decays; 0 before the first level, None beyond the last."""
    found = find_threshold(holds, scan, TOLERANCE)
    if found.bound == LOWER:
        return None
    if found.bound == UPPER or found.holds_at is None or found.fails_at is None:
        return 0.0
    return math.sqrt(found.holds_at * found.fails_at)
