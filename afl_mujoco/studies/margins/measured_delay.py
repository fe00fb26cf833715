"""The delay margin of the linearised loop against the delay that the loop in MuJoCo tolerates."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import mujoco
import numpy as np

from afl_mujoco.control.controller import Controller
from afl_mujoco.pool import compute_all, open_executor
from afl_mujoco.scenario.belief import TRUTH, Belief
from afl_mujoco.scenario.imperfections import IDEAL, Imperfections
from afl_mujoco.scenario.parameters import CartPoleParameters
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.schedules import constant
from afl_mujoco.simulation.mujoco_model import CartPoleModel
from afl_mujoco.simulation.sampled.runs import simulate_sampled
from afl_mujoco.simulation.trajectory import COMPLETED, Trajectory
from afl_mujoco.studies.bisection import BRACKETED, find_threshold, scan_levels
from afl_mujoco.studies.delay_margin import PERIOD, delay_margin

START = 1e-3
"""Pole angle at the start of a measurement [rad], small enough for the linearisation."""

DURATION, PARTS = 20.0, 5
"""Length of a run [s], and the number of parts into which it is cut. A motion decays if it is no
larger in the last part than in the first and in the one before the last."""

SMALL = 10.0 * START
"""Largest pole angle in the last part [rad]: the motion may have grown into a limit cycle, which
no longer grows."""

TOLERANCE = 1e-3
"""Relative tolerance of the measured delay [1]."""

DELAY = 0.05
"""Delay around which a threshold is sought if there is no margin [s]."""

REACH = 0.05
"""Relative difference up to which margin and measurement agree [1]."""


class Deployment(NamedTuple):
    """How a controller acts in MuJoCo.

    Attributes
    ----------
    period
        How long the force is held [s].
    imperfections
        As from `linear_part`.
    belief
        As in `linearize`.
    timestep
        Physics step [s]; None for the longest up to 1 ms that divides the period.
    """

    period: float = PERIOD
    imperfections: Imperfections = IDEAL
    belief: Belief = TRUTH
    timestep: float | None = None


USUAL = Deployment()
"""Perfect hardware and the default control period."""

Unit = tuple[Controller, CartPoleParameters, Deployment]


@dataclass(frozen=True, slots=True, kw_only=True)
class DelayComparison:
    """One controller on one plant.

    Attributes
    ----------
    controller
        Its name.
    cart_mass, half_length
        M [kg] and l [m].
    margin
        Delay margin of the linearised loop with the force held over a control period [s]; None if
        it is not stable without delay.
    measured
        Delay at which a small motion in MuJoCo no longer decays [s]; None if none was found.
    """

    controller: str
    cart_mass: float
    half_length: float
    margin: float | None
    measured: float | None

    @property
    def difference(self) -> float | None:
        """Relative difference of the measurement from the margin [1]; None without both."""
        if self.margin is None or self.measured is None:
            return None
        return self.measured / self.margin - 1.0

    @property
    def agrees(self) -> bool:
        """Whether they differ by no more than `REACH`, or are both missing."""
        if self.margin is None or self.measured is None:
            return self.margin is self.measured
        return abs(self.measured / self.margin - 1.0) <= REACH


def measured_plants(
    masses: Sequence[float], lengths: Sequence[float], *, few: bool = False
) -> list[tuple[float, float]]:
    """Return the plants of a grid on which delays are measured, M [kg] and l [m].

    They are the lightest and the heaviest cart, each with the shortest pole, the longest, and the
    one nearest to their geometric mean; only the two ends of the grid if ``few``.
    """
    ends = (min(masses), max(masses)), (min(lengths), max(lengths))
    if few:
        return list(dict.fromkeys(zip(*ends, strict=True)))
    mean = math.sqrt(ends[1][0] * ends[1][1])
    middle = min(lengths, key=lambda length: abs(math.log(length / mean)))
    return list(dict.fromkeys(product(ends[0], (ends[1][0], middle, ends[1][1]))))


def compare_delays(
    units: Sequence[Unit],
    *,
    workers: int = 1,
    progress: Callable[[int], None] = lambda index: None,
) -> list[DelayComparison]:
    """Compare margin and measurement for controllers on some plants.

    Parameters
    ----------
    units
        Controllers, plants, and how they act.
    workers
        Number of processes that share the work; the result does not depend on it.
    """
    with open_executor(min(workers, max(1, len(units)))) as executor:
        return compute_all(compare_delay, units, executor, progress)


def compare_delay(unit: Unit) -> DelayComparison:
    """Compare margin and measurement for one controller on one plant."""
    controller, plant, deployed = unit
    margin = delay_margin(controller, plant, *deployed[:3])
    about = DELAY if margin is None else margin
    return DelayComparison(
        controller=controller.name,
        cart_mass=plant.cart_mass,
        half_length=plant.half_length,
        margin=margin,
        measured=measured_delay(controller, plant, about, deployed),
    )


def measured_delay(
    controller: Controller,
    plant: CartPoleParameters,
    about: float,
    deployed: Deployment = USUAL,
) -> float | None:
    """Return the delay [s] from which a small motion in MuJoCo grows; None if there is none.

    Parameters
    ----------
    about
        Delay around which to search, from a fifth of it to five times it [s].
    deployed
        How the controller acts; the delay is added to that of its imperfections.
    """
    scan = scan_levels(about / 5.0, about * 5.0, 7)

    def holds(delay: float) -> bool:
        return motion_decays(controller, plant, delay, deployed)

    found = find_threshold(holds, scan, TOLERANCE)
    if found.bound != BRACKETED or found.holds_at is None or found.fails_at is None:
        return None
    return math.sqrt(found.holds_at * found.fails_at)


def motion_decays(
    controller: Controller,
    plant: CartPoleParameters,
    delay: float,
    deployed: Deployment = USUAL,
    gain: float = 1.0,
) -> bool:
    """Return whether a small motion about upright decays in MuJoCo.

    Parameters
    ----------
    delay
        Transport delay [s], on top of that of the imperfections.
    gain
        Factor on the force that the actuator exerts [1].
    """
    hardware = replace(
        deployed.imperfections, delay=deployed.imperfections.delay + delay, control_period=None
    )
    deployed = deployed._replace(imperfections=hardware)
    run = small_motion(controller, plant, deployed, START, DURATION, gain)
    if run.outcome.kind != COMPLETED:
        return False
    peaks = np.array([part.max(axis=0) for part in np.array_split(np.abs(run.state), PARTS)])
    decayed = (peaks[-1] <= np.minimum(peaks[0], peaks[-2])).all()
    return bool(decayed and peaks[-1, 1] <= SMALL)


def small_motion(
    controller: Controller,
    plant: CartPoleParameters,
    deployed: Deployment,
    start: float,
    duration: float,
    gain: float = 1.0,
) -> Trajectory:
    """Return a run near upright in sampled mode.

    Parameters
    ----------
    start
        Pole angle at the start [rad].
    duration
        Length of the run [s], rounded to whole control periods.
    gain
        Factor on the force that the actuator exerts [1].
    """
    period, imperfections, belief, timestep = deployed
    scenario = Scenario(
        name="small motion",
        duration=max(1, round(duration / period)) * period,
        cart_mass=constant(plant.cart_mass),
        half_length=constant(plant.half_length),
        pole_mass=plant.pole_mass,
        gravity=plant.gravity,
        initial_state=(0.0, start, 0.0, 0.0),
        imperfections=replace(imperfections, control_period=None),
        belief=belief,
    )

    def amplify(spec: mujoco.MjSpec) -> None:
        motor = spec.actuator("force")
        motor.gear = gain * motor.gear

    hardware = scenario.imperfections
    model = CartPoleModel(plant, edit=amplify, imperfections=hardware)
    model.compute_only(hardware)
    return simulate_sampled(
        scenario, controller, timestep=timestep, control_period=period, model=model
    )
